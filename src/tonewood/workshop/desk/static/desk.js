// The page of the desk: knobs, designs and what is seen; all that counts is kept by the server.
import { Sound } from "./sound.js";
import * as views from "./views.js";

const $ = (id) => document.getElementById(id);
const token = location.hash.slice(1);
let state = null, acting = Promise.resolve(), gone = 0;

const api = {
  async raw(path, options = {}) {
    const reply = await fetch(path, { ...options, headers: { "X-Desk-Token": token, ...options.headers } });
    if (!reply.ok) {
      const fault = new Error((await reply.json().catch(() => ({}))).error ?? `the desk answered ${reply.status}`);
      fault.answered = true;
      throw fault;
    }
    return reply;
  },
  get: async (path) => (await api.raw(path)).json(),
  post: async (path, body) =>
    (await api.raw(path, { method: "POST", body: JSON.stringify(body), headers: { "Content-Type": "application/json" } })).json(),
};

const say = (text) => ($("said").textContent = text);
const sound = new Sound(api, say);
Object.assign(window, { desk: { sound, act, get state() { return state; } } });

function element(name, properties = {}, ...inside) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...inside);
  return made;
}

// One act after another; a refusal is shown and returned.
function act(name, values = {}) {
  const began = performance.now();
  acting = acting.then(async () => {
    try {
      const found = await api.post("/api/act", { act: name, ...values });
      sound.changed(found.serial, began);
      $("fault").textContent = "";
      if (found.said) say(found.said);
      show(found);
      return { ok: true };
    } catch (fault) {
      $("fault").textContent = fault.message;
      return { ok: false, reason: fault.message };
    }
  });
  return acting;
}

// -- knobs -------------------------------------------------------------------------------------------------------

const shownNumber = (v) => (typeof v === "number" ? String(Number(v.toPrecision(6))) : "");
const position = (k, v) => (k.log ? Math.log(v / k.start) / Math.log(k.stop / k.start) : (v - k.start) / (k.stop - k.start));
const valueAt = (k, p) => {
  const v = k.log ? k.start * (k.stop / k.start) ** p : k.start + p * (k.stop - k.start);
  return k.whole ? Math.round(v) : Number(v.toPrecision(4));
};
let newest = null, sending = false;

// While a knob is dragged the newest value is sent when the one before was answered.
async function dragged(knob, value, row) {
  newest = { knob, value, row };
  if (sending) return;
  sending = true;
  while (newest) {
    const { knob: k, value: v, row: r } = newest;
    newest = null;
    await turned(k, v, r, true);
  }
  sending = false;
}

async function turned(knob, value, row, dragging = false) {
  const sent = knob.kind === "factor" ? { scale: value } : value;
  const { ok, reason } = await act("set", { path: knob.path, value: sent, dragging });
  row.classList.toggle("wrong", !ok);
  for (const field of row.querySelectorAll("input, select")) {
    if (ok) field.removeAttribute("aria-invalid");
    else field.setAttribute("aria-invalid", "true");
  }
  if (!ok && !dragging) say(`Nothing has changed: ${reason}`);
}

function knobRow(knob) {
  const id = `k_${knob.path}`;
  const row = element("div", { className: "knob" });
  row.dataset.path = knob.path;
  const label = element("label", { htmlFor: id, textContent: knob.label });
  if (knob.unit) label.append(" ", element("span", { className: "unit", textContent: knob.unit }));
  let field;
  if (knob.kind === "switch") field = element("input", { type: "checkbox", checked: knob.value });
  else if (knob.kind === "choice") {
    field = element("select");
    for (const word of knob.choices) field.append(element("option", { value: JSON.stringify(word), textContent: word, selected: word === knob.value }));
  } else if (knob.kind === "value") field = element("input", { value: knob.value === null ? "" : JSON.stringify(knob.value), placeholder: "left out", spellcheck: false });
  else {
    field = element("input", { type: "number", step: knob.whole ? 1 : "any", value: shownNumber(knob.value) });
    if (knob.low !== null) field.min = knob.low;
    if (knob.high !== null) field.max = knob.high;
  }
  field.id = id;
  row.append(label, field);
  field.addEventListener("change", () => {
    let value;
    if (knob.kind === "switch") value = field.checked;
    else if (knob.kind === "choice") value = JSON.parse(field.value);
    else if (knob.kind === "value") {
      try {
        value = field.value.trim() ? JSON.parse(field.value) : null;
      } catch {
        value = field.value;
      }
    } else value = field.valueAsNumber;
    if (Number.isNaN(value)) say(`${knob.path}: a number is wanted`);
    else turned(knob, value, row).then(() => refresh(row, knob, value));
  });
  if (["number", "factor"].includes(knob.kind)) {
    const slider = element("input", { type: "range", min: 0, max: 1, step: 0.002, value: position(knob, knob.value) });
    slider.setAttribute("aria-label", `${knob.path}, knob`);
    const spoken = (v) => slider.setAttribute("aria-valuetext", `${shownNumber(v)} ${knob.unit}`);
    spoken(knob.value);
    slider.addEventListener("input", () => {
      const value = valueAt(knob, slider.valueAsNumber);
      field.value = shownNumber(value);
      spoken(value);
      dragged(knob, value, row);
    });
    row.append(slider);
  }
  const limits = knob.low !== null || knob.high !== null ? ` (${knob.low ?? "−∞"} to ${knob.high ?? "∞"})` : "";
  row.append(element("span", { className: "doc", textContent: `${knob.doc}${limits}${knob.at_once ? "; at once" : ""}` }));
  refresh(row, knob, knob.value);
  return row;
}

function refresh(row, knob, value) {
  const same = JSON.stringify(value) === JSON.stringify(knob.kind === "factor" ? 1 : knob.start_value);
  row.classList.toggle("changed", !same);
}

let groupNames = [];
async function showGroups() {
  const names = await api.get("/api/groups");
  if (JSON.stringify(names) === JSON.stringify(groupNames)) return fillOpen();
  groupNames = names;
  $("groups").replaceChildren(
    ...names.map((name) => {
      const box = element("details", {}, element("summary", { textContent: name }), element("div"));
      box.dataset.group = name;
      box.addEventListener("toggle", () => box.open && fill(box));
      return box;
    }),
  );
  const first = $("groups").querySelector("details");
  if (first) first.open = true;
}

async function fill(box) {
  const words = $("find").value.toLowerCase().split(/\s+/).filter(Boolean);
  const focus = document.activeElement?.id, slider = document.activeElement?.type === "range";
  const found = await api.get(`/api/knobs/${encodeURIComponent(box.dataset.group)}`);
  const fit = found.filter((k) => words.every((w) => `${k.path} ${k.doc}`.toLowerCase().includes(w)));
  if (box.contains(document.activeElement) && slider) return; // a knob under the hand stays
  box.lastChild.replaceChildren(...fit.map(knobRow));
  if (focus) document.getElementById(focus)?.focus();
  return fit.length;
}

const fillOpen = () => Promise.all([...$("groups").querySelectorAll("details[open]")].map(fill));

async function find() {
  const asked = $("find").value.trim();
  for (const box of $("groups").children) {
    if (!asked) {
      box.hidden = false;
      continue;
    }
    const n = groupNames.length > 60 && !box.dataset.group.includes(asked) ? 0 : await fill(box);
    if ($("find").value.trim() !== asked) return;
    box.hidden = !n;
    box.open = n > 0;
  }
  if (!asked) fillOpen();
}

// -- what to change ----------------------------------------------------------------------------------------------

function showAdvice({ seconds, lines, fault, found, offered }) {
  const free = $("free");
  if (!free.value && document.activeElement !== free && offered) free.value = offered;
  const searching = seconds !== null, any = Object.keys(found).length > 0;
  $("advise_stop").hidden = !searching;
  $("advise_take").hidden = searching || !any;
  $("advise").querySelector("button").disabled = searching;
  $("advice_words").textContent = searching ? `Looking, ${seconds.toFixed(0)} s: ${lines.at(-1) ?? ""}` : fault ? `No design: ${fault}` : "";
  const shown = searching ? [] : lines;
  if (shown.join() !== [...$("advice").children].map((li) => li.textContent).join())
    $("advice").replaceChildren(...shown.map((line) => element("li", { textContent: line.trim() })));
}

// -- the drawing -------------------------------------------------------------------------------------------------

const svg = (name, attributes) => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
};

async function showDrawing() {
  const data = await api.get("/api/view/drawing");
  $("drawing_panel").hidden = !data;
  if (!data || $("drawing").dataset.dragging) return;
  const xs = data.rings[0].map((p) => p[0]), ys = data.rings[0].map((p) => p[1]);
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const root = svg("svg", { viewBox: `${x0 - 0.01} ${y0 - 0.01} ${x1 - x0 + 0.02} ${y1 - y0 + 0.02}` });
  for (const ring of data.rings) root.append(svg("polygon", { class: "outline", points: ring.map((p) => p.join()).join(" "), "stroke-width": 0.002 }));
  const bar = (b, kind) => svg("line", { class: kind, x1: b.start[0], y1: b.start[1], x2: b.stop[0], y2: b.stop[1], "stroke-width": b.width });
  if (data.bridge) root.append(bar(data.bridge, "bridge"));
  const focus = document.activeElement?.dataset?.end;
  for (const brace of data.braces) {
    const line = bar(brace, "brace");
    root.append(line);
    for (const [end, i] of [["start", 1], ["stop", 2]]) root.append(handle(brace, end, i, line, root));
  }
  $("drawing").replaceChildren(root);
  if (focus) root.querySelector(`[data-end="${CSS.escape(focus)}"]`)?.focus();
}

function handle(brace, end, i, line, root) {
  const place = [...brace[end]], path = `body.braces.${brace.name}.${end}`;
  const dot = svg("circle", { cx: place[0], cy: place[1], r: 0.0065, "stroke-width": 0.002, tabindex: 0, role: "slider", "data-end": path });
  const move = (x, y) => {
    [place[0], place[1]] = [Number(x.toFixed(4)), Number(y.toFixed(4))];
    dot.setAttribute("cx", place[0]);
    dot.setAttribute("cy", place[1]);
    line.setAttribute(`x${i}`, place[0]);
    line.setAttribute(`y${i}`, place[1]);
    said();
  };
  const said = () => {
    dot.setAttribute("aria-label", `${brace.name}, ${end}`);
    dot.setAttribute("aria-valuenow", Math.round(1000 * place[0]));
    dot.setAttribute("aria-valuetext", `x ${(1000 * place[0]).toFixed(0)} mm, y ${(1000 * place[1]).toFixed(0)} mm`);
  };
  said();
  const send = (dragging) => act("set", { path, value: [...place], dragging });
  dot.addEventListener("pointerdown", (event) => {
    dot.setPointerCapture(event.pointerId);
    $("drawing").dataset.dragging = "1";
  });
  dot.addEventListener("pointermove", (event) => {
    if (!dot.hasPointerCapture(event.pointerId)) return;
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(root.getScreenCTM().inverse());
    move(at.x, at.y);
  });
  dot.addEventListener("pointerup", async () => {
    delete $("drawing").dataset.dragging;
    await send(false);
    showDrawing();
  });
  dot.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!step) return;
    event.preventDefault();
    move(place[0] + 0.001 * step[0], place[1] + 0.001 * step[1]);
    send(true);
  });
  return dot;
}

// -- what is seen of the model ------------------------------------------------------------------------------------

const seen = { mobility: null, start: null, strings: null, startStrings: null, shape: null, from: null, moments: [], since: 0, models: 0 };
const view = (kind, argument = "", of = "") => api.get(`/api/view/${kind}?argument=${encodeURIComponent(argument)}&of=${of}`);

function options(select, names) {
  if ([...select.options].map((o) => o.value).join() === names.join()) return;
  const before = select.value;
  select.replaceChildren(...names.map((n) => element("option", { value: n, textContent: n })));
  if (names.includes(before)) select.value = before;
}

async function look(kind, then) {
  try {
    await then();
  } catch (fault) {
    if (fault.answered) $("fault").textContent = `${kind}: ${fault.message}`;
  }
}

async function showModel() {
  showGroups();
  await look("drawing", showDrawing);
  await look("mobility", async () => {
    seen.mobility = await view("mobility");
    seen.start ??= await view("mobility", "", "start");
    options($("mobility_string"), Object.keys(seen.mobility.db));
    drawMobility();
    const strongest = seen.mobility.modes.filter((m) => m.mass && m.freq < seen.mobility.freq.at(-1)).sort((a, b) => (a.mass * a.freq) / a.q - (b.mass * b.freq) / b.q).slice(0, 10).sort((a, b) => a.freq - b.freq);
    $("peaks").replaceChildren(...strongest.map((m) => element("button", { textContent: `${m.freq.toFixed(0)} Hz`, onclick: () => showShape(m.freq) })));
    if (strongest.length) await showShape(seen.shape?.freq ?? strongest[0].freq);
  });
  await look("differences", async () => {
    const lines = state.changes.length ? await view("differences") : [];
    $("differences").replaceChildren(...(lines.length ? lines : ["nothing that is measured here"]).map((t) => element("li", { textContent: t })));
  });
  await look("partials", async () => {
    seen.strings = await view("strings");
    seen.startStrings ??= await view("strings", "", "start");
    const names = seen.strings.map((s) => s.string);
    for (const id of ["partials_string", "force_string"]) options($(id), names);
    $("open").replaceChildren(...seen.strings.map((s) => openString(s.note)));
    drawPartials();
  });
  await look("force", showForce);
}

function drawMobility() {
  if (seen.mobility) seen.from = views.mobility($("mobility"), seen.mobility, seen.start, $("mobility_string").value)?.from;
}

function drawPartials() {
  const row = seen.strings?.find((s) => s.string === $("partials_string").value);
  if (!row) return;
  views.partials($("partials"), row, seen.startStrings?.find((s) => s.string === row.string));
  const cells = (p) => [p.n, p.freq.toFixed(1), p.cents.toFixed(1), p.t60 ? `${p.t60.toFixed(2)} s` : "∞"].map((t) => element("td", { textContent: t }));
  $("partials_table").tBodies[0].replaceChildren(...row.partials.map((p) => element("tr", {}, ...cells(p))));
}

async function showShape(freq) {
  await look("mode shape", async () => {
    seen.shape = await view("shape", freq);
    drawShape(0);
  });
}

function drawShape(phase) {
  if (seen.shape) $("shape_h").textContent = `Mode shape: ${views.shape($("shape"), seen.shape, phase)}`;
}

async function showForce() {
  views.force($("force"), (seen.force = await view("force", $("force_string").value)));
}

async function showWolves() {
  const button = $("wolves_go");
  button.disabled = true;
  button.textContent = "Looking …";
  await look("wolf notes", async () => {
    const of = seen.models, found = await view("wolves");
    if (of !== seen.models) return forgetWolves();
    seen.wolves = found;
    $("wolves").hidden = false;
    views.wolves($("wolves"), seen.wolves);
    const line = (w) => `${w.string} at ${w.worst_freq.toFixed(1)} Hz (stops ${w.stops.join(", ") || "between"}): severity ${w.severity_cents.toFixed(1)} cents, by the mode at ${w.body_freq.toFixed(1)} Hz`;
    const lines = [...seen.wolves.words.map((t) => `Change: ${t}`), ...seen.wolves.wolves.slice(0, 8).map(line)];
    $("wolves_list").replaceChildren(...(lines.length ? lines : ["none"]).map((t) => element("li", { textContent: t })));
  });
  button.disabled = false;
  button.textContent = "Look again";
}

// Wolf notes take long: those of the design before are not left standing.
function forgetWolves() {
  seen.wolves = null;
  $("wolves").hidden = true;
  $("wolves_list").replaceChildren(element("li", { textContent: "another model is seen now: look again" }));
}

const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
function animate(time) {
  if (!still && sound.on) drawShape(time / 250);
  if (sound.on && sound.analyser) views.spectrogram($("spectrogram"), sound.analyser, state?.fs ?? 48000);
  requestAnimationFrame(animate);
}

// -- designs and sound --------------------------------------------------------------------------------------------

function show(next) {
  const before = state;
  state = next;
  document.title = `${next.name} · tonewood desk`;
  $("title").textContent = next.title;
  $("play").textContent = sound.on && next.playing ? "Stop" : "Play";
  $("undo").disabled = !next.undo;
  $("redo").disabled = !next.redo;
  $("loop").checked = next.loop;
  $("command").value = next.command;
  showAdvice(next.advice);
  for (const id of ["phrase", "notes", "velocity"]) {
    const value = next.phrase[id === "phrase" ? "kind" : id];
    if (document.activeElement !== $(id) && value !== "" && JSON.stringify(before?.phrase) !== JSON.stringify(next.phrase)) $(id).value = value;
  }
  $("notes_label").hidden = $("phrase").value !== "notes";
  $("phrase").querySelector("[value=file]").disabled = !next.has_file;
  if ($("sets").options.length === 1) for (const name of next.sets) $("sets").append(element("option", { value: name, textContent: name }));
  $("sets").value = next.changes.find((c) => c.path === "strings_from")?.value ?? "";
  if (JSON.stringify(before?.changes) !== JSON.stringify(next.changes)) {
    const row = (c) => element("li", { textContent: `${c.path} = ${JSON.stringify(c.value)}` }, element("button", { textContent: "Take back", onclick: () => act("reset", { path: c.path }), ariaLabel: `Take back ${c.path}` }));
    $("changes").replaceChildren(...(next.changes.length ? next.changes.map(row) : [element("li", { textContent: "no changes" })]));
  }
  if (JSON.stringify(before?.snapshots) !== JSON.stringify(next.snapshots)) {
    const row = (s) => element("li", { textContent: `${s.name}: ${s.changes.join("; ") || "the bundle"}` }, element("button", { textContent: "Go there", onclick: () => act("recall", { name: s.name }) }), element("button", { textContent: "Forget", onclick: () => act("forget", { name: s.name }) }));
    $("snapshots").replaceChildren(...next.snapshots.map(row));
    const chosen = $("other").value;
    $("other").replaceChildren(element("option", { value: "", textContent: "the start" }), ...next.snapshots.map((s) => element("option", { value: s.name, textContent: s.name })));
    $("other").value = chosen;
  }
  if (JSON.stringify(before?.pair) !== JSON.stringify(next.pair)) {
    const row = (name, i) => {
      const button = element("button", { textContent: name, onclick: () => act("pick", { which: i }) });
      button.setAttribute("aria-pressed", String(i === next.pair.which));
      return button;
    };
    const ends = next.pair ? [...(next.pair.blind ? [element("button", { textContent: "Reveal", onclick: () => act("reveal") })] : []), element("button", { textContent: "End", onclick: () => act("compare", { name: null }) })] : [];
    $("pair").replaceChildren(...(next.pair?.names.map(row) ?? []), ...ends);
  }
  const sees = (s) => JSON.stringify([s?.heard, s?.preview, s?.making === null, s?.modes]);
  if (next.modes !== null && (next.preview || next.making === null) && sees(before) !== sees(next)) later(!next.preview && before?.preview);
  status();
}

// Pictures follow when the hand has rested for a moment.
let resting = 0;
function later(exact) {
  clearTimeout(resting);
  seen.models += 1;
  if (seen.wolves) forgetWolves();
  if (exact && !state.changes.length) seen.start = seen.startStrings = null;
  resting = setTimeout(showModel, seen.mobility === null ? 0 : 250);
}

let load = null;
function status() {
  const s = state, parts = [];
  if (s.making !== null) parts.push(s.making < 1.5 ? "making the model of this design" : `making the model of this design: ${s.making.toFixed(0)} s so far; ${s.preview ? "the sound is a preview" : s.channels.length ? "the sound is that of the design before" : "there is no sound yet"}`);
  if (s.preview) parts.push(`you hear a ${s.preview}; the exact sound follows`);
  if (sound.on) {
    parts.push(`latency ${(1e3 * sound.latency).toFixed(0)} ms`);
    parts.push(`${sound.meter.underruns} underrun${sound.meter.underruns === 1 ? "" : "s"}`);
    if (load) parts.push(`load ${(100 * load.load).toFixed(0)} %`);
    if (load?.load > 1) parts.push("this model takes longer than its sound: a phrase has gaps the first time and none when it is repeated; keys have gaps");
    if (sound.toSound !== null) parts.push(`knob to sound ${sound.toSound.toFixed(0)} ms`);
  } else parts.push("not playing");
  if (s.modes !== null) parts.push(`${s.modes} modes`);
  if (s.channels.length > 2) parts.push(`of ${s.channels.length} channels ${s.channels[0]} and ${s.channels[1]} are heard`);
  if (s.compared) parts.push(s.compared);
  if (s.dropped.length) parts.push(`not played: ${s.dropped[0]}`);
  for (const line of s.warnings.slice(0, 2)) parts.push(line);
  $("status").textContent = parts.join(" · ");
  if (s.fault) $("fault").textContent = s.fault;
}

async function poll() {
  try {
    const next = await api.get("/api/state");
    if (gone) {
      $("fault").textContent = "";
      say("The desk answers again.");
    }
    gone = 0;
    show(next);
    if (sound.on) await ring();
  } catch (fault) {
    gone += 1;
    $("fault").textContent = fault.answered ? fault.message : "The desk does not answer. Is `tonewood desk` still running? The command below makes this design again; nothing else is kept.";
  }
  setTimeout(poll, gone ? 2000 : sound.on ? 300 : 700);
}

async function ring() {
  const found = await api.get(`/api/moments?since=${seen.since}`);
  load = found;
  if (found.frame < (seen.frame ?? 0)) seen.moments = [];
  seen.frame = found.frame;
  const known = seen.moments.at(-1)?.frame ?? 0;
  seen.moments.push(...found.moments.filter((m) => m.frame > known));
  seen.since = found.frame > 4096 ? (seen.moments.at(-1)?.frame ?? 0) : 0;
  $("energy_words").textContent = views.energy($("energy"), seen.moments, state.fs);
  const rows = found.effects.map((e) => {
    const ran = Object.values(e.active), longest = Math.max(0, ...ran);
    const on = e.on === null ? (longest > 0 ? "always" : "no") : e.on.join(", ") || "off";
    const cost = e.cost === null ? "" : `${(100 * e.cost).toFixed(2)} %`;
    const share = Math.min(1, longest / Math.max(found.seconds, 1e-9));
    const cells = [e.title, on, `${(100 * share).toFixed(0)} %`, cost].map((t) => element("td", { textContent: t }));
    [, , share, e.cost ?? 0].forEach((part, i) => cells[i].style.setProperty("--share", `${100 * Math.min(1, part)}%`));
    return element("tr", {}, ...cells);
  });
  $("effects").tBodies[0].replaceChildren(...rows);
  $("effects_words").textContent = `All steps take ${(100 * found.load).toFixed(0)} % of the time, a block at worst ${(100 * found.worst).toFixed(0)} %.`;
}

async function play() {
  const on = !(sound.on && state.playing);
  if (on) {
    try {
      await sound.start(state.fs);
    } catch (fault) {
      $("fault").textContent = `The browser gives no sound: ${fault.message}`;
      return;
    }
  }
  await act("play", { on, loop: $("loop").checked });
}

// -- keys ---------------------------------------------------------------------------------------------------------

async function key(note, on, velocity = 80) {
  if (on) await sound.start(state.fs);
  return act("key", { note, on, velocity });
}

function openString(note) {
  const button = element("button", { textContent: note });
  button.addEventListener("pointerdown", () => key(note, true));
  button.addEventListener("pointerup", () => key(note, false));
  button.addEventListener("keydown", (e) => !e.repeat && [" ", "Enter"].includes(e.key) && key(note, true));
  button.addEventListener("keyup", (e) => [" ", "Enter"].includes(e.key) && key(note, false));
  return button;
}

const rowOfKeys = "awsedftgyhujkolp";
let octave = 48;
const down = new Map();
$("keys").addEventListener("keydown", (event) => {
  const i = rowOfKeys.indexOf(event.key.toLowerCase());
  if (event.repeat || event.ctrlKey || event.metaKey || event.key.length > 1) return;
  if (event.key === "z" || event.key === "x") octave = Math.max(12, Math.min(96, octave + (event.key === "z" ? -12 : 12)));
  else if (i >= 0) {
    down.set(event.key, octave + i);
    key(octave + i, true);
  }
});
$("keys").addEventListener("keyup", (event) => {
  if (down.has(event.key)) key(down.get(event.key), false);
  down.delete(event.key);
});
$("keys").addEventListener("blur", () => {
  for (const note of down.values()) key(note, false);
  down.clear();
});
$("midi").addEventListener("click", async () => {
  try {
    const found = await navigator.requestMIDIAccess();
    for (const input of found.inputs.values()) {
      input.onmidimessage = ({ data: [kind, note, velocity] }) => {
        if ((kind & 0xf0) === 0x90) key(note, velocity > 0, velocity || 64);
        else if ((kind & 0xf0) === 0x80) key(note, false);
      };
    }
    say(found.inputs.size ? `MIDI: ${[...found.inputs.values()].map((i) => i.name).join(", ")}` : "No MIDI keyboard is connected.");
  } catch (fault) {
    say(`No MIDI: ${fault.message}`);
  }
});

// -- the rest of the page -----------------------------------------------------------------------------------------

$("play").addEventListener("click", play);
$("loop").addEventListener("change", () => act("loop", { on: $("loop").checked }));
const phrase = () => act("phrase", { kind: $("phrase").value, notes: $("notes").value, velocity: Number($("velocity").value) });
$("phrase").addEventListener("change", () => {
  $("notes_label").hidden = $("phrase").value !== "notes";
  phrase();
});
for (const id of ["notes", "velocity"]) $(id).addEventListener("change", phrase);
$("undo").addEventListener("click", () => act("undo").then(fillOpen));
$("redo").addEventListener("click", () => act("redo").then(fillOpen));
$("sets").addEventListener("change", () => act($("sets").value ? "strings" : "reset", { name: $("sets").value, path: "strings_from" }));
$("find").addEventListener("input", find);
const submitted = (id, then) => $(id).addEventListener("submit", (event) => {
  event.preventDefault();
  then();
});
submitted("keep", () => act("keep", { name: $("keep_name").value }));
submitted("save", () => act("save", { folder: $("save_folder").value }));
submitted("mass", () => {
  const kept = state.changes.find((c) => c.path === "body.added")?.value ?? state.added ?? [];
  const part = { at: $("mass_at").value, mass: Number($("mass_g").value) / 1000 }, damping = Number($("mass_damping").value);
  if ($("mass_frequency").value) Object.assign(part, { frequency: Number($("mass_frequency").value), q: Number($("mass_q").value) });
  if (damping) part.damping = damping;
  act("set", { path: "body.added", value: [...kept, part] }).then(fillOpen);
});
$("compare").addEventListener("click", () => act("compare", { name: $("other").value, blind: $("blind").checked }));
submitted("advise", () => act("advise", { targets: $("targets").value, free: $("free").value }));
$("advise_stop").addEventListener("click", () => act("advise_stop"));
$("advise_take").addEventListener("click", () => act("advise_take").then(fillOpen));
$("copy").addEventListener("click", async () => {
  $("command").select();
  await navigator.clipboard?.writeText($("command").value).catch(() => document.execCommand("copy"));
  say("The command is copied.");
});
$("wolves_go").addEventListener("click", showWolves);
$("mobility_string").addEventListener("change", drawMobility);
$("partials_string").addEventListener("change", drawPartials);
$("force_string").addEventListener("change", () => look("force", showForce));
$("mobility").addEventListener("click", (event) => {
  if (!seen.from) return;
  const near = seen.from(event.offsetX);
  const mode = seen.mobility.modes.reduce((a, b) => (Math.abs(Math.log(b.freq / near)) < Math.abs(Math.log(a.freq / near)) ? b : a));
  showShape(mode.freq);
});
function redraw() {
  drawMobility();
  drawPartials();
  drawShape(0);
  if (seen.force) views.force($("force"), seen.force);
  if (seen.wolves) views.wolves($("wolves"), seen.wolves);
}
addEventListener("resize", redraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey) || event.target.matches("input:not([type=range]), textarea")) return;
  if (event.key === "z") {
    event.preventDefault();
    act(event.shiftKey ? "redo" : "undo").then(fillOpen);
  }
});
api.get("/api/points").then((points) => options($("mass_at"), points), () => {});
requestAnimationFrame(animate);
poll();
