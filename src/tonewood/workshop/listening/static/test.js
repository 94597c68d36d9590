"use strict";
// One page at a time: ask for the step, show it, send the answer. All texts are set as text, never as HTML.

const main = document.getElementById("page"), message = document.getElementById("message");
const query = new URLSearchParams(location.search);
let about = {}, texts = {}, token = null, step = null, sounds = null, shownAt = 0, audio = null;

function make(tag, fields = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(fields)) {
    if (name === "class") made.className = value;
    else if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (name in made) made[name] = value;
    else made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

const wait = ms => new Promise(done => setTimeout(done, ms));

function tell(text, kind = "") { message.textContent = text; message.className = kind; }

// The place of a session in this browser: of one test, and of the listener whom the address names.
const place = listener => `session:${about.test}:${listener}`;
let named = (query.get("listener") || "").trim();
// Where a browser keeps nothing (site data are blocked), the session lasts as long as its page.
const store = {
  get(key) { try { return JSON.parse(localStorage.getItem(key)); } catch (fault) { return null; } },
  set(key, value) { try { localStorage.setItem(key, JSON.stringify(value)); } catch (fault) { /* blocked or full */ } },
  remove(key) { try { localStorage.removeItem(key); } catch (fault) { /* blocked */ } },
};

// A request, made again until the server answers: it may be down for a while, and nothing is lost.
async function ask(address, body) {
  for (let pause = 500; ; pause = Math.min(2 * pause, 8000)) {
    try {
      const options = body === undefined ? {} : {
        method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
      const reply = await fetch(address, options);
      if (reply.status < 500) return { status: reply.status, data: await reply.json() };
    } catch (fault) { /* no connection */ }
    tell(texts.lost || "...");
    await wait(pause);
  }
}

async function begin() {
  const wished = query.get("language") || (navigator.languages || []).join(",");
  const reply = await ask("/api/test?language=" + encodeURIComponent(wished));
  if (reply.status !== 200) return tell(reply.data.error);
  about = reply.data;
  texts = about.texts;
  tell("");
  document.documentElement.lang = about.language;
  document.title = about.title;
  document.getElementById("name").textContent = about.title;
  document.getElementById("progress").setAttribute("aria-label", texts.progress);
  const kept = store.get(place(named));
  if (kept && kept.token) {
    const found = await ask("/api/session/" + kept.token);
    token = kept.token;
    if (found.status === 200) return found.data.type === "done" ? show(found.data) : welcome(found.data, kept.listener);
    store.remove(place(named));
    if (found.status === 410) return stopped(texts.broken);
  }
  welcome(null, named);
}

// Another listener begins. A session that the address named is kept for that address.
function other() {
  named = "";
  store.remove(place(named));
  query.delete("listener");
  history.replaceState(null, "", location.pathname + (query.size ? "?" + query : ""));
  begin();
}

const otherButton = () => make("button", { class: "other", onclick: other }, texts.new_listener);

// The test cannot go on; why, in words, and what can be done.
function stopped(reason, retry = null) {
  if (sounds) sounds.halt();
  sounds = null;
  delete main.dataset.index;
  tell("");
  const again = retry ? [make("button", { class: "main", id: "again", onclick: retry }, texts.again)] : [];
  main.replaceChildren(make("h2", { id: "stopped" }, texts.stopped_title), make("p", {}, reason),
    make("p", {}, texts.stopped), make("div", { class: "row" }, ...again, otherButton()));
}

// The first page: browsers play nothing before the first click.
function welcome(kept, name) {
  const fixed = Boolean(named || kept);         // the address, or the session, says who listens
  const listener = make("input", { type: "text", value: name || "", id: "listener", maxLength: 60, readOnly: fixed });
  const start = make("button", { class: "main", id: "next", onclick: async () => {
    start.disabled = true;
    if (!kept) {
      const made = await ask("/api/session", { listener: listener.value, language: about.language });
      if (made.status !== 201) return stopped(made.data.error);
      token = made.data.token;
      store.set(place(named), { token, listener: listener.value });
      kept = (await ask("/api/session/" + token)).data;
    }
    show(kept);
  } }, kept ? texts.go_on : texts.start);
  const field = make("label", { class: "field" }, make("span", {}, texts.listener), listener);
  const parts = [make("h2", {}, about.title), make("p", {}, texts.begin_text)];
  if (kept) parts.push(make("p", { id: "kept" }, texts.unfinished));
  main.replaceChildren(...parts, ...(kept && !name ? [] : [field]),
    make("div", { class: "row" }, start, ...(kept ? [otherButton()] : [])));
}

async function show(next) {
  if (sounds) sounds.halt();
  sounds = null;
  step = next;
  document.getElementById("progress").value = step.progress;
  if (step.type === "done") {
    delete main.dataset.index;
    if (!named) store.remove(place(named));     // a named listener has taken the test, and does so once
    main.replaceChildren(make("h2", { id: "done" }, texts.finish_title), make("p", {}, texts.done), otherButton());
    return;
  }
  const parts = [make("h2", {}, step.title)];
  if (step.training) parts.push(make("p", { class: "training" }, texts.training));
  for (const text of [...step.content, ...(step.notes || [])]) {
    parts.push(...text.split(/\n\s*\n/).map(part => make("p", {}, part)));
  }
  if (step.question) parts.push(make("p", { class: "question" }, make("strong", {}, step.question)));
  main.replaceChildren(...parts);
  const slots = step.type === "level" ? ["tone"] : step.slots;
  if (slots.length) {
    main.append(make("p", { class: "hint", id: "loading" }, texts.loading));
    const buffers = await load(slots);
    if (!buffers || step !== next) return;
    document.getElementById("loading").remove();
    sounds = new Sounds(audio, buffers);
    sounds.onchange = mark;
  }
  const answer = (BUILD[step.type] || BUILD.read)();
  const button = make("button", { class: "main", id: "next" }, step.last ? texts.send : texts.next);
  button.addEventListener("click", () => send(answer, button));
  main.append(button);
  shownAt = performance.now();
  main.dataset.index = step.index;       // the page is complete
  main.dataset.type = step.type;
}

// The sounds of a step; null where the page stops instead, or goes to the step where the session is.
async function load(slots) {
  const asked = step;
  let fault = null;
  const raw = await Promise.all(slots.map(async slot => {
    for (let pause = 500; !fault; pause = Math.min(2 * pause, 8000)) {
      try {
        const reply = await fetch(`/api/session/${token}/sound/${asked.index}/${slot}`);
        if (reply.ok) return await reply.arrayBuffer();   // or the connection breaks half-way
        if (reply.status < 500) { fault = reply.status; return null; }
      } catch (broken) { /* no connection */ }
      tell(texts.lost_sound);
      await wait(pause);
    }
    return null;
  }));
  if (step !== asked) return null;
  tell("");
  if (fault === 422) { stopped(texts.no_sound, () => show(asked)); return null; }
  if (fault) { await current(); return null; }
  const rate = new DataView(raw[0]).getUint32(24, true);   // of the WAV file: decoding must not resample
  if (!audio || audio.sampleRate !== rate) audio = new AudioContext({ sampleRate: rate });
  try {
    const decoded = await Promise.all(raw.map(data => audio.decodeAudioData(data)));
    return Object.fromEntries(slots.map((slot, i) => [slot, decoded[i]]));
  } catch (broken) { stopped(texts.no_sound, () => show(asked)); return null; }
}

// Show the step where the session is: another window may have gone on.
async function current() {
  const found = await ask("/api/session/" + token);
  if (found.status !== 200) return stopped(found.status === 410 ? texts.broken : texts.gone);
  return show(found.data);
}

function mark() {
  for (const button of main.querySelectorAll("button.sound")) {
    button.classList.toggle("playing", sounds.playing === button.dataset.slot);
  }
}

function soundButton(slot) {
  const name = slot === step.open ? texts.reference : slot === "tone" ? texts.play : slot;
  return make("button", { class: "sound", "data-slot": slot, onclick: () => sounds.play(slot) }, name);
}

function controls(slots) {
  const stop = make("button", { onclick: () => sounds.stop() }, texts.stop);
  const loop = make("input", { type: "checkbox", onchange: () => { sounds.stop(); sounds.loop = loop.checked; } });
  const row = make("div", { class: "row" }, ...slots.map(soundButton), stop, make("label", {}, loop, " " + texts.loop));
  main.append(row, make("p", { class: "hint" }, texts.keys));
}

function slider(low, high, stepSize, fields = {}) {
  const input = make("input", { type: "range", min: low, max: high, step: stepSize, class: "unset", ...fields });
  input.value = (low + high) / 2;
  const seen = () => input.classList.remove("unset");
  for (const kind of ["input", "pointerdown", "keydown"]) input.addEventListener(kind, seen);
  return input;
}

// Sliders beside each other, one a sound, with the words of the scale.
function rated(low, high, stepSize, words, kind) {
  controls([step.open]);
  const names = words.split("|").reverse();
  const scale = make("div", { class: "scale " + kind, "aria-hidden": "true" }, ...names.map(name => make("span", {}, name)));
  const box = make("div", { class: "sliders" }, scale), inputs = {};
  for (const slot of step.slots.filter(s => s !== step.open)) {
    const shown = make("output", {}, "");
    const input = slider(low, high, stepSize, { "aria-label": slot, "data-slot": slot });
    input.addEventListener("input", () => { shown.textContent = input.value; });
    inputs[slot] = input;
    box.append(make("div", { class: "slider" }, soundButton(slot), input, shown));
  }
  main.append(box);
  const comment = make("textarea", { rows: 2 });
  main.append(make("label", { class: "field" }, make("span", {}, texts.comment), comment));
  return () => {
    if (Object.values(inputs).some(input => input.classList.contains("unset"))) return tell(texts.unanswered);
    const ratings = Object.fromEntries(Object.entries(inputs).map(([slot, input]) => [slot, Number(input.value)]));
    return { ratings, comment: comment.value };
  };
}

function chosen() {
  let choice = null;
  const buttons = step.choices.map(({ value, label }) => make("button", {
    class: "choice", "data-value": value,
    onclick: event => {
      choice = value;
      for (const button of main.querySelectorAll("button.choice")) button.classList.toggle("chosen", button === event.target);
    },
  }, label));
  if (step.sequence) {
    const play = make("button", { class: "sequence", onclick: () => sounds.sequence(step.slots) }, texts.play);
    const names = step.slots.map(slot => soundButton(slot));
    main.append(make("div", { class: "row" }, play, ...names));
    for (const button of names) button.disabled = true;     // they show which interval is heard
  } else {
    controls(step.slots);
  }
  main.append(make("div", { class: "row" }, ...buttons));
  return () => (choice === null ? tell(texts.unanswered) : { choice });
}

function fields(questions) {
  const readers = questions.map(question => {
    const label = make("span", {}, question.label + (question.optional ? ` (${texts.optional})` : ""));
    if (question.kind === "choice") {
      const box = make("div", { class: "field", role: "radiogroup", "aria-label": question.label }, label);
      for (const { value, label: text } of question.choices) {
        box.append(make("label", {}, make("input", { type: "radio", name: question.name, value }), " " + text, make("br")));
      }
      main.append(box);
      return () => (box.querySelector("input:checked") || { value: null }).value;
    }
    if (question.kind === "scale") {
      const input = slider(question.low, question.high, (question.high - question.low) / 100, { name: question.name });
      const ends = make("div", { class: "ends" }, make("span", {}, question.low_label || String(question.low)),
        make("span", {}, question.high_label || String(question.high)));
      main.append(make("label", { class: "field" }, label, input, ends));
      return () => (input.classList.contains("unset") ? null : Number(input.value));
    }
    const input = make("input", { type: question.kind === "number" ? "number" : "text", name: question.name, step: "any" });
    main.append(make("label", { class: "field" }, label, input));
    return () => (input.value === "" ? null : question.kind === "number" ? Number(input.value) : input.value);
  });
  return () => {
    const values = {};
    for (const [i, question] of questions.entries()) {
      const value = readers[i]();
      if (value === null && !question.optional) return tell(texts.unanswered);
      if (value !== null) values[question.name] = value;
    }
    return { values };
  };
}

const BUILD = {
  read: () => () => ({}),
  consent: () => {
    const box = make("input", { type: "checkbox", id: "agree" });
    main.append(make("label", { class: "field" }, box, " " + step.agree));
    return () => (box.checked ? { agreed: true } : tell(texts.unanswered));
  },
  level: () => {
    sounds.loop = true;
    main.append(make("div", { class: "row" }, soundButton("tone"),
      make("button", { onclick: () => sounds.stop() }, texts.stop)));
    if (!step.measured) return () => ({});
    const read = fields([{ name: "spl_db", label: texts.level_measured, kind: "number" }]);
    return () => { const found = read(); return found && { spl_db: found.values.spl_db }; };
  },
  mushra: () => rated(0, 100, 1, texts.mushra_scale, "intervals"),
  bs1116: () => rated(1, 5, 0.1, texts.bs1116_scale, "points"),
  abx: chosen, ab: chosen, paired_comparison: chosen, afc: chosen, staircase: chosen,
  rating: () => { controls(step.slots); return fields(step.scales.map(scale => ({ ...scale, kind: "scale" }))); },
  questionnaire: () => fields(step.questions),
};

async function send(answer, button) {
  tell("");
  const found = answer();
  if (!found) return;
  if (sounds && step.slots.some(slot => sounds.plays[slot] === 0)) return tell(texts.listen_first);
  button.disabled = true;
  if (sounds) sounds.stop();
  const seconds = (performance.now() - shownAt) / 1000;
  const body = { index: step.index, seconds, plays: sounds ? sounds.plays : {}, ...found };
  const reply = await ask("/api/session/" + token, body);
  if (reply.status === 409) {
    tell(texts.elsewhere);
    await wait(query.has("quick") ? 50 : 4000);
    tell("");
    return show(reply.data.step);
  }
  if (reply.status === 404 || reply.status === 410) return stopped(reply.status === 410 ? texts.broken : texts.gone);
  if (reply.status !== 200) { button.disabled = false; return tell(reply.data.error); }
  tell("");
  const { feedback } = reply.data;
  if (feedback) {
    const right = (step.choices.find(c => c.value === feedback.correct) || { label: feedback.correct }).label;
    tell(feedback.right ? texts.right : texts.wrong.replace("{correct}", right), feedback.right ? "right" : "");
    await wait(query.has("quick") ? 50 : 900);
    tell("");
  }
  show(reply.data.step);
}

document.addEventListener("keydown", event => {
  if (!sounds || /^(text|number|textarea)$/.test(event.target.type || "") || event.ctrlKey || event.metaKey) return;
  if (event.key === " " && event.target.tagName !== "BUTTON" && !/^(checkbox|radio)$/.test(event.target.type || "")) { event.preventDefault(); sounds.stop(); return; }
  const slot = event.key.toLowerCase() === "r" ? step.open : event.key.toUpperCase();
  if (!step.sequence && slot in sounds.buffers) sounds.play(slot);
});

begin();
