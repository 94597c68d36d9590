
// A script that opens the page for one listener after another, in one browser, and tells what it shows.
(async () => {
  const stages = [
    ["?listener=P01", "start"], ["?listener=P02", "look"], ["?listener=P01", "look"], ["", "look"],
    ["?listener=P01", "other"], ["?listener=P01", "look"], ["?listener=P03", "finish"], ["?listener=P03", "look"],
  ];
  const stage = Number(sessionStorage.getItem("stage") || 0);
  const tell = words => fetch("/static/said-" + encodeURIComponent(JSON.stringify(words)));
  if (stage === stages.length) return tell("end");
  const [address, act] = stages[stage];
  if (location.search !== address) return location.assign("/" + address);
  const until = async test => { while (!test()) await wait(20); };
  await until(() => document.getElementById("next") || document.getElementById("done"));
  const input = document.getElementById("listener");
  const kept = Boolean(document.getElementById("kept")), done = Boolean(document.getElementById("done"));
  const shown = { address, act, name: input && input.value, kept, done };
  if (act === "start" || act === "finish") {
    document.getElementById("next").click();
    await until(() => main.dataset.index !== undefined);
    while (act === "finish" && !document.getElementById("done")) {
      const next = document.getElementById("next");
      if (next && !next.disabled) next.click();
      await wait(20);
    }
    if (act === "finish") shown.offers = Boolean(document.querySelector("button.other"));
  }
  if (act === "other") {
    document.querySelector("button.other").click();
    await until(() => !document.getElementById("kept") && document.getElementById("listener"));
    shown.after = { address: location.search, name: document.getElementById("listener").value };
  }
  await tell(shown);
  sessionStorage.setItem("stage", stage + 1);
  const following = (stages[stage + 1] || ["?end"])[0];
  if (location.search === following) location.reload(); else location.assign("/" + following);
})();
