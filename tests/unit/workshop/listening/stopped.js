
// A script that begins the test and tells the page's text when it stops.
(async () => {
  const until = async test => { while (!test()) await wait(20); };
  await until(() => document.getElementById("next"));
  document.getElementById("next").click();
  await until(() => document.getElementById("stopped"));
  await fetch("/static/said-" + encodeURIComponent(JSON.stringify(main.innerText)));
})();
