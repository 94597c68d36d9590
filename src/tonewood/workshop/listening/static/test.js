"use strict";
// One page at a time: ask for the step, show it, send the answer. All texts are set as text, never as HTML.

const main = document.getElementById("page"), message = document.getElementById("message");
const query = new URLSearchParams(location.search);
const ownPlace = document.getElementById("own");
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

// Answers that are not sent yet survive a reload: the fields of the page, counts of plays and parts heard.
const draft = {
  get key() { return `draft:${token}`; },
  read() { const kept = store.get(this.key); return kept && step && kept.index === step.index ? kept : {}; },
  write(fields) { store.set(this.key, { ...this.read(), index: step.index, ...fields }); },
};

// A request, made again until the server answers: it may be down for a while, and nothing is lost.
async function ask(address, body, method = "POST") {
  for (let pause = 500; ; pause = Math.min(2 * pause, 8000)) {
    try {
      const options = body === undefined ? {} : {
        method, headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
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
    if (found.status === 200) return ENDS[found.data.type] ? show(found.data) : welcome(found.data, kept.listener);
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

// The rights over one's data, on every page of a session.
function ownData() {
  if (!token) return ownPlace.replaceChildren();
  const sure = make("div", { class: "row", hidden: true }, make("span", {}, texts.own_sure),
    make("button", { id: "withdraw", onclick: withdraw }, texts.own_yes),
    make("button", { onclick: () => { sure.hidden = true; remove.focus(); } }, texts.own_no));
  const remove = make("button", { id: "delete", onclick: () => { sure.hidden = false; sure.querySelector("button").focus(); } },
    texts.own_delete);
  const keys = make("input", { type: "checkbox", checked: keysOn(), onchange: () => store.set("keys", keys.checked) });
  ownPlace.replaceChildren(make("details", {}, make("summary", {}, texts.own_data), make("p", {}, texts.own_text),
    make("div", { class: "row" }, make("button", { id: "export", onclick: save }, texts.own_export), remove), sure,
    make("label", { class: "option" }, keys, " " + texts.keys_on)));
}

async function save() {
  const found = await ask(`/api/session/${token}/data`);
  if (found.status !== 200) return tell(found.data.error);
  const blob = new Blob([JSON.stringify(found.data, null, 1)], { type: "application/json" });
  const link = make("a", { href: URL.createObjectURL(blob), download: "answers.json" });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

async function withdraw() {
  const found = await ask("/api/session/" + token, {}, "DELETE");
  if (found.status !== 200 && found.status !== 404) return tell(found.data.error);
  if (sounds) sounds.halt();
  sounds = null; step = null;
  store.remove(draft.key);
  store.remove(place(named));
  token = null;
  ownData();
  delete main.dataset.index;
  page(heading(texts.withdrawn_title, "withdrawn"), make("p", {}, texts.withdrawn), otherButton());
}

const keysOn = () => store.get("keys") !== false;
const heading = (text, id = "heading") => make("h2", { id, tabIndex: -1 }, text);

// Another page: who listens to the screen hears its heading.
function page(...parts) {
  main.replaceChildren(...parts);
  const first = main.querySelector("h2");
  if (first) first.focus({ preventScroll: true });
  window.scrollTo(0, 0);
}

// The test cannot go on; why, in words, and what can be done.
function stopped(reason, retry = null) {
  if (sounds) sounds.halt();
  sounds = null;
  delete main.dataset.index;
  tell("");
  const again = retry ? [make("button", { class: "main", id: "again", onclick: retry }, texts.again)] : [];
  page(heading(texts.stopped_title, "stopped"), make("p", {}, reason),
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
  const parts = [heading(about.title), make("p", {}, texts.begin_text)];
  if (kept) parts.push(make("p", { id: "kept" }, texts.unfinished));
  page(...parts, ...(kept && !name ? [] : [field]),
    make("div", { class: "row" }, start, ...(kept ? [otherButton()] : [])));
  ownData();
}

async function show(next) {
  if (sounds) sounds.halt();
  sounds = null;
  step = next;
  document.getElementById("progress").value = step.progress;
  ownData();
  if (ENDS[step.type]) {
    delete main.dataset.index;
    store.remove(draft.key);
    if (!named) store.remove(place(named));     // a named listener has taken the test, and does so once
    const [title, text] = ENDS[step.type].map(key => texts[key]);
    const code = step.code ? [make("p", {}, texts.code + " ", make("span", { class: "code" }, step.code))] : [];
    const back = step.address ? [make("p", {}, make("a", { href: step.address, id: "return" }, texts.return))] : [];
    return page(heading(title, step.type), make("p", {}, text), ...code, ...back, otherButton());
  }
  const parts = [heading(step.title)];
  if (step.training) parts.push(make("p", { class: "training" }, texts.training));
  for (const text of [...step.content, ...(step.notes || [])]) {
    parts.push(...text.split(/\n\s*\n/).map(part => make("p", {}, part)));
  }
  if (step.plays) parts.push(make("p", { class: "hint" }, texts.plays_left.replace("{plays}", step.plays)));
  if (step.question) parts.push(make("p", { class: "question" }, make("strong", {}, step.question)));
  page(...parts);
  document.title = `${step.title} - ${about.title}`;
  const slots = step.type === "level" ? ["tone"] : step.slots;
  if (slots.length) {
    main.append(make("p", { class: "hint", id: "loading" }, texts.loading));
    const buffers = await load(slots);
    if (!buffers || step !== next) return;
    document.getElementById("loading").remove();
    sounds = new Sounds(audio, buffers, { loop: step.loop, restart: step.restart, plays: step.plays });
    if (step.type !== "level") sounds.restore(draft.read());
    sounds.onchange = mark;
  }
  const answer = (BUILD[step.type] || BUILD.read)();
  const button = make("button", { class: "main", id: "next" }, step.last ? texts.send : texts.next);
  button.addEventListener("click", () => send(answer, button));
  main.append(button);
  if (sounds) mark();
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

// Whether a sound can be played again; in a sequence none can when one of them cannot.
const playable = slot => (step.sequence ? step.slots : [slot]).every(each => sounds.may(each));

// The share of a sound that must be heard; a tenth of a percent less, as clocks are not exact.
const enough = slot => sounds.plays[slot] > 0 && sounds.share(slot) >= (step.listen || 0) - 0.001;

function mark() {
  for (const shown of main.querySelectorAll(".sound")) {
    const slot = shown.dataset.slot;
    shown.classList.toggle("playing", sounds.playing === slot);
    shown.classList.toggle("heard", step.type !== "level" && enough(slot));
    if (shown.tagName === "BUTTON") {
      shown.setAttribute("aria-pressed", sounds.playing === slot);
      shown.disabled = !sounds.may(slot) && sounds.playing !== slot;
    }
  }
  const play = main.querySelector("button.sequence");
  if (play) play.disabled = !playable(step.slots[0]);
  if (step.type !== "level") draft.write(sounds.kept());
}

const nameOf = slot => (slot === step.open ? texts.reference : slot === "tone" ? texts.play : slot);

function soundButton(slot) {
  const spoken = slot === "tone" ? texts.play : `${texts.play}: ${nameOf(slot)}`;
  return make("button", { class: "sound", "data-slot": slot, "aria-label": spoken, onclick: () => sounds.play(slot) }, nameOf(slot));
}

function controls(slots, hint = texts.keys) {
  const row = make("div", { class: "row" }, ...slots.map(soundButton),
    make("button", { onclick: () => sounds.stop() }, texts.stop));
  if (step.loop !== "off") {
    const loop = make("input", { type: "checkbox", id: "loop", onchange: () => { sounds.stop(); sounds.loop = loop.checked; } });
    row.append(make("label", {}, loop, " " + texts.loop));
  }
  main.append(row);
  if (step.waveform || step.loop === "region") main.append(timeline(slots[0]));
  main.append(make("p", { class: "hint" }, hint));
}

// Time from left to right: the waveform of an open sound, the region that loops, and the place that is heard.
function timeline(slot) {
  const box = make("div", {}), canvas = make("canvas", { role: "img", "aria-label": texts.waveform });
  box.append(canvas);
  if (step.loop === "region") {
    const ends = [texts.region_from, texts.region_to].map((label, k) => {
      const input = make("input", { type: "range", min: 0, max: sounds.duration, step: 0.01, "aria-label": label });
      input.value = sounds.region[k];
      input.addEventListener("input", () => {
        const other = sounds.region[1 - k], value = Number(input.value);
        const kept = k ? Math.max(value, other + 0.05) : Math.min(value, other - 0.05);
        input.value = kept;
        sounds.region[k] = Math.min(Math.max(kept, 0), sounds.duration);
        if (sounds.sources) sounds.stop();
      });
      const shown = make("span", {}, Number(sounds.region[k]).toFixed(2));
      input.addEventListener("input", () => { shown.textContent = sounds.region[k].toFixed(2); });
      return make("label", { class: "region" }, label + " ", shown, input);
    });
    box.append(...ends);
  }
  const draw = () => {
    if (!canvas.isConnected || !sounds) return;
    picture(canvas, step.waveform ? sounds.buffers[slot] : null);
    requestAnimationFrame(draw);
  };
  setTimeout(draw, 0);
  return box;
}

function picture(canvas, buffer) {
  const width = canvas.width = canvas.clientWidth, height = canvas.height = canvas.clientHeight, pen = canvas.getContext("2d");
  const x = seconds => seconds / sounds.duration * width;
  pen.fillStyle = "#dcebf5";
  if (sounds.loop) pen.fillRect(x(sounds.region[0]), 0, x(sounds.region[1]) - x(sounds.region[0]), height);
  if (buffer) {
    const samples = buffer.getChannelData(0), size = samples.length / width;
    if (!buffer.peaks || buffer.peaks.length !== width) {
      buffer.peaks = Array.from({ length: width }, (_, k) => {
        let peak = 0;
        for (let i = Math.floor(k * size); i < (k + 1) * size && i < samples.length; i++) peak = Math.max(peak, Math.abs(samples[i]));
        return peak;
      });
      buffer.largest = Math.max(...buffer.peaks, 1e-9);
    }
    pen.fillStyle = "#0067a3";
    buffer.peaks.forEach((peak, k) => { const h = Math.max(peak / buffer.largest * 0.9 * height, 1); pen.fillRect(k, (height - h) / 2, 1, h); });
  }
  pen.fillStyle = "#a32020";
  if (sounds.sources) pen.fillRect(x(sounds.position), 0, 2, height);
}

// A slider without a value until it is moved; `word` gives the value in words.
function slider(low, high, stepSize, fields = {}, word = String, kept = undefined) {
  const input = make("input", { type: "range", min: low, max: high, step: stepSize, class: "unset", ...fields });
  input.value = kept === undefined ? (low + high) / 2 : kept;
  const seen = () => { input.classList.remove("unset"); input.setAttribute("aria-valuetext", word(input.value)); };
  input.setAttribute("aria-valuetext", texts.not_rated);
  if (kept !== undefined) seen();
  input.addEventListener("input", seen);
  input.addEventListener("pointerdown", () => { seen(); input.dispatchEvent(new Event("input")); });
  input.addEventListener("keydown", event => {    // Enter takes the value that is shown
    if (event.key === "Enter" && input.classList.contains("unset")) { event.stopPropagation(); input.dispatchEvent(new Event("input")); }
  });
  return input;
}

// Sliders beside each other, one a sound, with the words of the scale.
function rated(low, high, stepSize, words, kind) {
  controls([step.open]);
  const names = words.split("|");
  const word = value => {
    const share = (value - low) / (high - low);
    const k = kind === "points" ? Math.round(share * (names.length - 1)) : Math.min(Math.floor(share * names.length), names.length - 1);
    return `${value}, ${names[k]}`;
  };
  const scale = make("div", { class: "scale " + kind, "aria-hidden": "true" }, ...[...names].reverse().map(name => make("span", {}, name)));
  const ends = make("div", { class: "ends narrow", "aria-hidden": "true" }, make("span", {}, names[0]), make("span", {}, names[names.length - 1]));
  const box = make("div", { class: "sliders" }, scale, ends), inputs = {}, kept = draft.read().ratings || {};
  for (const slot of step.slots.filter(s => s !== step.open)) {
    const shown = make("output", { "aria-hidden": "true" }, kept[slot] === undefined ? "" : String(kept[slot]));
    const input = slider(low, high, stepSize, { "aria-label": slot, "data-slot": slot }, word, kept[slot]);
    input.addEventListener("input", () => {
      shown.textContent = input.value;
      draft.write({ ratings: { ...draft.read().ratings, [slot]: Number(input.value) } });
    });
    inputs[slot] = input;
    box.append(make("div", { class: "slider" }, soundButton(slot), input, shown));
  }
  main.append(box);
  const comment = make("textarea", { rows: 2, maxLength: 2000, value: draft.read().comment || "" });
  comment.addEventListener("input", () => draft.write({ comment: comment.value }));
  main.append(make("label", { class: "field" }, make("span", {}, texts.comment), comment));
  return () => {
    const missing = Object.values(inputs).find(input => input.classList.contains("unset"));
    if (missing) return unanswered(missing);
    const ratings = Object.fromEntries(Object.entries(inputs).map(([slot, input]) => [slot, Number(input.value)]));
    return { ratings, comment: comment.value };
  };
}

// Nothing yet, or nothing that can be read: said, and the field is where the keys go.
function unanswered(field, reason = texts.unanswered) {
  tell(reason);
  if (field) field.focus();
}

function chosen() {
  if (step.sequence) {
    const play = make("button", { class: "sequence", onclick: () => sounds.sequence(step.slots) }, texts.play);
    const names = step.slots.map(slot => make("span", { class: "sound", "data-slot": slot }, nameOf(slot)));
    main.append(make("div", { class: "row" }, play, ...names), make("p", { class: "hint" }, texts.keys_sequence));
  } else {
    controls(step.slots, texts.keys_choice);
  }
  const group = make("fieldset", { class: "row" }, make("legend", {}, texts.answer));
  for (const { value, label } of step.choices) {
    const input = make("input", { type: "radio", name: "choice", value, checked: draft.read().choice === value,
      onchange: () => draft.write({ choice: value }) });
    group.append(make("label", { class: "choice", "data-value": value }, input, label));
  }
  main.append(group);
  return () => {
    const taken = group.querySelector("input:checked");
    return taken ? { choice: taken.value } : unanswered(group.querySelector("input"));
  };
}

function fields(questions) {
  const keep = (name, value) => draft.write({ values: { ...draft.read().values, [name]: value } });
  const readers = questions.map(question => {
    const kept = (draft.read().values || {})[question.name];
    const words = question.label + (question.optional ? ` (${texts.optional})` : "");
    if (question.kind === "choice") {
      const box = make("fieldset", { class: "field" }, make("legend", {}, words));
      for (const { value, label: text } of question.choices) {
        const input = make("input", { type: "radio", name: question.name, value, checked: kept === value,
          onchange: () => keep(question.name, value) });
        box.append(make("label", { class: "option" }, input, " " + text));
      }
      main.append(box);
      return [() => (box.querySelector("input:checked") || { value: null }).value, box.querySelector("input")];
    }
    const label = make("span", {}, words);
    if (question.kind === "scale") {
      const ends = [question.low_label || String(question.low), question.high_label || String(question.high)];
      // rounded: 100 steps that are too long by a rounding error would leave the right end out of reach
      const input = slider(question.low, question.high, Number(((question.high - question.low) / 100).toPrecision(12)),
        { name: question.name, "aria-label": `${words}, ${ends.join(" - ")}` }, String, kept);
      input.addEventListener("input", () => keep(question.name, Number(input.value)));
      main.append(make("div", { class: "field" }, label, input,
        make("div", { class: "ends", "aria-hidden": "true" }, ...ends.map(end => make("span", {}, end)))));
      return [() => (input.classList.contains("unset") ? null : Number(input.value)), input];
    }
    const input = make("input", { type: question.kind === "number" ? "number" : "text", name: question.name, step: "any",
      maxLength: 10000, value: kept === undefined ? "" : kept });
    const read = () => (input.value === "" ? null : question.kind === "number" ? Number(input.value) : input.value);
    input.addEventListener("input", () => keep(question.name, read() ?? ""));
    main.append(make("label", { class: "field" }, label, input));
    return [read, input];
  });
  return () => {
    const values = {};
    for (const [i, question] of questions.entries()) {
      const [read, input] = readers[i], value = read();
      if (input && input.validity.badInput) return unanswered(input, texts.no_number);   // its value is empty
      if (value === null && !question.optional) return unanswered(input);
      if (value !== null) values[question.name] = value;
    }
    return { values };
  };
}

const ENDS = { done: ["finish_title", "done"], failed: ["failed_title", "failed"] };

const BUILD = {
  read: () => () => ({}),
  consent: () => {
    const box = make("input", { type: "checkbox", id: "agree", checked: Boolean(draft.read().agreed),
      onchange: () => draft.write({ agreed: box.checked }) });
    main.append(make("label", { class: "field" }, box, " " + step.agree));
    return () => (box.checked ? { agreed: true } : unanswered(box));
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
  abx: chosen, ab: chosen, paired_comparison: chosen, afc: chosen, staircase: chosen, headphones: chosen,
  rating: () => { controls(step.slots); return fields(step.scales.map(scale => ({ ...scale, kind: "scale" }))); },
  questionnaire: () => fields(step.questions),
};

async function send(answer, button) {
  tell("");
  const found = answer();
  if (!found) return;
  if (sounds) sounds.mark();
  const missing = sounds ? step.slots.filter(slot => !enough(slot) && playable(slot)) : [];
  if (missing.length) {
    return tell(texts.listen_first.replace("{share}", Math.round(100 * step.listen)).replace("{slots}", missing.map(nameOf).join(", ")));
  }
  button.disabled = true;
  if (sounds) sounds.stop();
  const seconds = (performance.now() - shownAt) / 1000;
  const body = { index: step.index, seconds, plays: sounds ? sounds.plays : {}, ...found };
  if (sounds && step.slots.length) {
    body.heard = Object.fromEntries(step.slots.map(slot => [slot, Math.min(1, sounds.share(slot) + 0.001)]));
  }
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

// Single keys play, choose and go on, where no text is typed and no control uses the key itself.
document.addEventListener("keydown", event => {
  const { type = "", tagName } = event.target;
  if (!step || !keysOn() || event.ctrlKey || event.metaKey || event.altKey || /^(text|number|textarea)$/.test(type)) return;
  const next = document.getElementById("next"), pressed = event.key.toLowerCase();
  const taken = /^(BUTTON|SUMMARY|A)$/.test(tagName);
  if (event.key === "Enter" && !taken && next && !next.disabled) { event.preventDefault(); next.click(); return; }
  if (!sounds) return;
  if (event.key === " " && !taken && !/^(checkbox|radio)$/.test(type)) { event.preventDefault(); sounds.stop(); return; }
  const answers = main.querySelectorAll(".choice input"), answer = answers[Number(pressed) - 1];
  const slot = pressed === "r" ? step.open : event.key.toUpperCase();
  const loop = document.getElementById("loop");
  if (pressed === "l" && loop) loop.click();
  else if (pressed === "p" && step.sequence) sounds.sequence(step.slots);
  else if (answer) { answer.click(); answer.focus(); }
  else if (!step.sequence && slot in sounds.buffers) sounds.play(slot);
});

begin();
