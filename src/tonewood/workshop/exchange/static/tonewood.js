"use strict";
// One plugin for all pages with sounds: buttons that play them, and sliders or answers.
const make = (tag, fields = {}, ...children) => {
  const made = Object.assign(document.createElement(tag), fields);
  made.append(...children);
  return made;
};
const say = TEST.texts;
const ANSWERS = { same: say.choice_same, different: say.choice_different, undecided: say.choice_undecided, tie: say.choice_tie };

class TonewoodTrial {
  static info = {
    name: "tonewood-trial",
    version: "1.0.0",
    parameters: { page: { type: jsPsychModule.ParameterType.OBJECT }, step: { type: jsPsychModule.ParameterType.OBJECT } },
    data: { rows: { type: jsPsychModule.ParameterType.OBJECT } },
  };

  constructor(jsPsych) { this.jsPsych = jsPsych; }

  trial(element, { page, step }) {
    const began = performance.now(), heard = new Set(), values = new Map();
    let playing = null;
    const base = { page: step.page, trial: step.trial, repetition: step.repetition };
    const stop = () => { if (playing) playing.pause(); playing = null; };
    const rated = page.scales.length > 0;
    const send = make("button", { id: "send", className: "jspsych-btn", disabled: true }, say.send);
    const wanted = Object.keys(step.slots).filter(slot => slot !== "reference").length * page.scales.length;
    const check = () => { send.disabled = heard.size < Object.keys(step.slots).length || values.size < wanted; };
    const finish = rows => {
      stop();
      const seconds = ((performance.now() - began) / 1000).toFixed(2);
      this.jsPsych.finishTrial({ rows: rows.map(row => ({ ...base, ...row, seconds })) });
    };
    const list = make("div", { className: "sounds" });
    for (const [slot, code] of Object.entries(step.slots)) {
      const name = slot === "reference" ? say.reference : slot;
      const sound = new Audio(`stimuli/${code}.wav`);
      const play = make("button", { className: "jspsych-btn play" }, `${say.play} ${name}`);
      play.dataset.slot = slot;
      play.onclick = () => { stop(); playing = sound; sound.currentTime = 0; sound.play(); };
      sound.onended = () => { heard.add(slot); play.classList.add("heard"); check(); };
      const row = make("div", { className: "row" }, play);
      for (const scale of slot === "reference" ? [] : page.scales) {
        // rounded: 100 steps that are too long by a rounding error would leave the right end out of reach
        const step_ = Number(((scale.high - scale.low) / 100).toPrecision(12));
        const slider = make("input", { type: "range", min: scale.low, max: scale.high, step: step_, value: (scale.low + scale.high) / 2 });
        slider.setAttribute("aria-label", `${name} ${scale.label}`);
        const output = make("output", {}, "–");
        slider.oninput = () => {
          output.textContent = slider.value;
          values.set(`${slot} ${scale.name}`, { stimulus: code, item: scale.name, value: Number(slider.value) });
          check();
        };
        row.append(make("label", {}, scale.label, " ", scale.low_label, " ", slider, " ", scale.high_label, " "), output);
      }
      list.append(row);
    }
    element.append(make("h1", {}, page.title), make("p", {}, page.content), make("p", {}, page.question || ""), list);
    if (rated) {
      send.onclick = () => finish([...values.values()]);
      element.append(send);
    } else {
      const answers = make("div", { id: "answers", role: "group" });
      answers.setAttribute("aria-label", say.answer);
      for (const choice of step.choices) {
        const button = make("button", { className: "jspsych-btn answer" }, ANSWERS[choice] || choice);
        button.dataset.choice = choice;
        button.onclick = () => { if (heard.size === Object.keys(step.slots).length) finish([{ ...step.slots, response: choice }]); };
        answers.append(button);
      }
      element.append(answers);
    }
  }
}

const clean = text => make("span", {}, text).innerHTML;

function questions(page) {
  return page.questions.map(({ name, label, kind, choices, low, high, optional }) => {
    const needed = optional ? "" : "required", id = `name="${clean(name)}" ${needed}`;
    const field = kind === "choice"
      ? `<select ${id}><option value=""></option>${Object.entries(choices).map(([k, v]) => `<option value="${clean(k)}">${clean(v)}</option>`).join("")}</select>`
      : kind === "text" ? `<input type="text" ${id}>`
      : kind === "number" ? `<input type="number" step="any" ${id}>`
      // the slider has a value before it is touched, the number beside it has none
      : `<input type="range" min="${low}" max="${high}" step="any" aria-label="${clean(label)}" oninput="this.nextElementSibling.value = this.value"><input type="number" min="${low}" max="${high}" step="any" ${id}>`;
    return `<p><label>${clean(label)} ${field}</label></p>`;
  }).join("");
}

function table(rows) {
  const columns = [...new Set(rows.flatMap(row => Object.keys(row)))];
  const cell = value => `"${String(value ?? "").replaceAll('"', '""')}"`;
  return [columns, ...rows.map(row => columns.map(name => row[name]))].map(row => row.map(cell).join(",")).join("\r\n") + "\r\n";
}

const asked = new URLSearchParams(location.search);
const listener = asked.get("listener") || `j${Date.now().toString(36)}${Math.random().toString(36).slice(2, 6)}`;
const number = asked.has("course") ? Number(asked.get("course")) : Math.floor(Math.random() * TEST.courses.length);
const steps = TEST.courses[number % TEST.courses.length];
const all = [];

const jsPsych = initJsPsych({
  on_trial_finish: data => {
    if (data.rows) all.push(...data.rows.map(row => ({ listener, ...row })));
    if (data.page && data.response && typeof data.response === "object") {
      for (const [item, value] of Object.entries(data.response)) all.push({ listener, page: data.page, item, value });
    }
  },
  on_finish: () => {
    const link = make("a", { id: "saved", href: URL.createObjectURL(new Blob([table(all)], { type: "text/csv" })), download: `${TEST.name}-${listener}.csv` }, `${TEST.name}-${listener}.csv`);
    document.body.replaceChildren(make("h1", {}, say.finish_title), link);
    window.answers = table(all);
    link.click();
  },
});

const timeline = [];
for (const page of TEST.pages) {
  const head = `<h1>${clean(page.title)}</h1>${page.content.split("\n\n").map(part => `<p>${clean(part)}</p>`).join("")}`;
  const tone = page.tone ? `<p><audio controls loop src="stimuli/${page.tone}"></audio></p>` : "";
  if (page.button) timeline.push({ type: jsPsychHtmlButtonResponse, stimulus: head + tone, choices: [clean(page.button)] });
  else if (page.questions) timeline.push({ type: jsPsychSurveyHtmlForm, preamble: head, html: questions(page), button_label: say.next, data: { page: page.page } });
  else for (const step of steps.filter(step => step.page === page.page)) timeline.push({ type: TonewoodTrial, page, step });
}
jsPsych.run(timeline);
