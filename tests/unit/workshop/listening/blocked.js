
// A script that tells whether the browser lets the page keep anything, and takes a test without sounds.
(async () => {
  const tell = words => fetch("/static/said-" + encodeURIComponent(JSON.stringify(words)));
  const until = async test => { while (!test()) await wait(20); };
  let fault = "";
  try { localStorage.setItem("kept", "1"); } catch (error) { fault = error.name; }
  await until(() => document.getElementById("next"));
  await tell({ fault });
  while (!document.getElementById("done")) {
    const next = document.getElementById("next");
    if (next && !next.disabled) next.click();
    await wait(20);
  }
  await tell({ words: message.textContent, offers: Boolean(document.querySelector("button.other")) });
})();
