"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const place = document.getElementById("sets"), loop = document.getElementById("loop");
let audio = null, current = null, names = null, factors = [];

function make(tag, fields = {}, ...children) {
  const made = Object.assign(document.createElement(tag), fields);
  made.append(...children);
  return made;
}

function load(address) {
  return new Promise((done, fault) => document.body.append(make("script", { src: address, onload: done, onerror: fault })));
}

// called by audition/setN.js and audition/names.js
function soundsOf(index, sounds) { data.sets[index].raw = sounds; }
function namesAre(found) { names = found.names; factors = found.factors; }

async function buffersOf(set) {
  if (set.buffers) return set.buffers;
  if (!set.raw) await load(set.script);
  const decode = async text => {
    const raw = Uint8Array.from(atob(text), letter => letter.charCodeAt(0)).buffer;
    const rate = new DataView(raw).getUint32(24, true);
    if (!audio) audio = new AudioContext({ sampleRate: rate });
    return audio.decodeAudioData(raw);
  };
  set.buffers = {};
  for (const [code, text] of Object.entries(set.raw)) set.buffers[code] = await decode(text);
  set.raw = null;
  return set.buffers;
}

// All sounds of a set run together; gains choose which is heard, with 5 ms between.
async function play(set, code, share = null) {
  const buffers = await buffersOf(set);
  audio.resume();
  if (current && current.set === set && share === null) {
    const now = audio.currentTime;
    for (const [name, gain] of Object.entries(current.gains)) ramp(gain, name === code ? 1 : 0, now + 0.005);
    current.code = code;
  } else {
    stop();
    const duration = buffers[code].duration, offset = (share || 0) * duration, at = audio.currentTime + 0.02;
    const gains = {}, sources = Object.entries(buffers).map(([name, buffer]) => {
      const source = new AudioBufferSourceNode(audio, { buffer, loop: loop.checked });
      const gain = new GainNode(audio, { gain: name === code ? 1 : 0 });
      source.connect(gain).connect(audio.destination);
      source.start(at, offset);
      gains[name] = gain.gain;
      return source;
    });
    current = { set, code, gains, sources, began: at - offset, duration };
    const mine = current;
    sources[0].onended = () => { if (current === mine) stop(); };
  }
  mark();
}

function ramp(gain, value, until) {
  gain.cancelScheduledValues(audio.currentTime);
  gain.setValueAtTime(gain.value, audio.currentTime);
  gain.linearRampToValueAtTime(value, until);
}

// The sound fades: a step would be heard as a click.
function stop() {
  const until = audio ? audio.currentTime + 0.02 : 0;
  if (current) for (const gain of Object.values(current.gains)) ramp(gain, 0, until);
  if (current) for (const source of current.sources) { source.onended = null; source.stop(until); }
  current = null;
  mark();
}

// One cursor: at the same place in every picture of the set that plays.
function mark() {
  for (const figure of place.querySelectorAll("figure")) {
    figure.classList.toggle("playing", Boolean(current) && figure.dataset.code === current.code);
  }
  for (const cursor of place.querySelectorAll(".cursor")) cursor.style.display = "none";
}

function move() {
  if (current) {
    const t = audio.currentTime - current.began;
    const share = Math.max(0, Math.min(1, (loop.checked ? t % current.duration : t) / current.duration));
    for (const cursor of current.set.element.querySelectorAll(".cursor")) {
      cursor.style.display = "block";
      cursor.style.left = `${100 * share}%`;
    }
  }
  requestAnimationFrame(move);
}

function label(code) {
  if (!names) return code;
  const { name, role } = names[code];
  return role === "sound" ? name : `${name} (${role})`;
}

function draw() {
  const factor = document.getElementById("sort").value;
  place.replaceChildren(...data.sets.map(set => {
    const order = [...set.sounds];
    if (names && factor) {
      const level = sound => names[sound.code].levels[factor] || "";
      order.sort((a, b) => level(a).localeCompare(level(b), undefined, { numeric: true }) || label(a.code).localeCompare(label(b.code)));
    }
    set.order = order.map(sound => sound.code);
    const figures = order.map((sound, i) => {
      const key = i < 26 ? String.fromCharCode(65 + i) : "";
      const cursor = make("div", { className: "cursor" });
      const alt = `waveform and spectrogram of ${label(sound.code)}`;
      const image = data.pictures ? [make("img", { src: `${data.pictures}/${sound.code}.png`, loading: "lazy", alt })] : [];
      const picture = make("div", { className: data.pictures ? "picture" : "picture bar" }, ...image, cursor);
      picture.addEventListener("click", event => {
        const box = picture.getBoundingClientRect();
        play(set, sound.code, Math.max(0, (event.clientX - box.left) / box.width));
      });
      const button = make("button", { onclick: () => play(set, sound.code) }, key ? `${key} ▶` : "▶");
      const facts = make("span", { className: "facts" }, sound.facts);
      const figure = make("figure", {}, make("figcaption", {}, button, make("strong", {}, label(sound.code)), facts), picture);
      figure.dataset.code = sound.code;
      return figure;
    });
    const parts = [make("h2", {}, names ? names[set.title] : set.title)];
    if (set.question) parts.push(make("p", {}, set.question));
    if (names && data.pictures) parts.push(make("img", { className: "difference", loading: "lazy", src: set.figure, alt: "differences within this set", onerror: event => event.target.remove() }));
    set.element = make("section", {}, ...parts, make("div", { className: "grid" }, ...figures));
    return set.element;
  }));
  mark();
}

async function unblind(show) {
  const button = document.getElementById("unblind"), sort = document.getElementById("sort");
  if (show && !names) {
    await load("audition/names.js");
    for (const factor of factors) sort.append(make("option", { value: factor }, factor));
    unblind.kept = names;
  }
  names = show ? unblind.kept : null;
  sort.disabled = !show;
  button.textContent = show ? "Hide names" : "Show names";
  button.setAttribute("aria-pressed", String(show));
  draw();
}

document.getElementById("unblind").addEventListener("click", () => unblind(!names));
document.getElementById("sort").addEventListener("change", draw);
document.getElementById("stop").addEventListener("click", stop);
loop.addEventListener("change", stop);
document.addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
  if (event.key === " ") { event.preventDefault(); return stop(); }
  const set = current ? current.set : data.sets[0], code = set && set.order[event.key.toUpperCase().charCodeAt(0) - 65];
  if (event.key.length === 1 && code) play(set, code);
});
if (data.blind) draw(); else unblind(true);
move();
