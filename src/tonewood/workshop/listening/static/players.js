"use strict";
// Gapless players on the Web Audio API. All sounds of a page run together from one start; switching fades their gains in
// 5 ms, so that the place in the sound stays the same to the sample. A sound that is stopped fades out: a step would be
// heard as a click.

const SWITCH = 0.005, FADE = 0.02;
// Parts of a sound that are heard or not; a sound lasts to its last sample above -60 dB re its peak.
const PARTS = 200, FLOOR = 1e-3;

// A gain to a value in some seconds, from where it is now.
function ramp(context, gain, value, seconds) {
  const now = context.currentTime;
  gain.cancelScheduledValues(now);
  gain.setValueAtTime(gain.value, now);
  gain.linearRampToValueAtTime(value, now + seconds);
}

// Seconds until a sound has ended: files are as long as the longest of their page.
function lasting(buffer) {
  const channels = Array.from({ length: buffer.numberOfChannels }, (_, k) => buffer.getChannelData(k));
  let peak = 0;
  for (const samples of channels) for (const value of samples) peak = Math.max(peak, Math.abs(value));
  let last = 0;
  for (const samples of channels) last = Math.max(last, samples.findLastIndex(value => Math.abs(value) > FLOOR * peak));
  return (last + 1) / buffer.sampleRate;
}

class Sounds {
  // options: loop (off, whole, region), restart (a sound that is switched to begins anew), plays (most times, or null)
  constructor(context, buffers, options = {}) {
    this.context = context;
    this.buffers = buffers;            // slot -> AudioBuffer
    this.options = options;
    this.loop = false;
    this.region = [0, this.duration];  // s
    this.playing = null;               // slot that is heard
    this.plays = {};
    this.onchange = () => {};
    this.sources = null;
    this.lasts = {};
    this.parts = {};
    for (const [slot, buffer] of Object.entries(buffers)) {
      this.plays[slot] = 0;
      this.lasts[slot] = Math.max(lasting(buffer), 1e-3);
      this.parts[slot] = new Uint8Array(PARTS);
    }
  }

  get duration() { return Math.max(...Object.values(this.buffers).map(b => b.duration)); }

  get position() {
    if (!this.sources || this.order) return this.held || 0;
    const t = Math.max(this.context.currentTime - this.began, 0), [from, to] = this.region;
    return this.loop ? from + (t - from) % (to - from) : Math.min(t, to);
  }

  // Share of a sound that was heard, whichever parts.
  share(slot) { return this.parts[slot].reduce((sum, part) => sum + part, 0) / PARTS; }

  may(slot) { return !this.options.plays || this.plays[slot] < this.options.plays; }

  start(slot) {
    this.halt();
    const at = this.context.currentTime + 0.03, [from, to] = this.region;
    this.began = at - from;
    this.marked = this.context.currentTime;
    this.gains = {};
    this.sources = Object.entries(this.buffers).map(([name, buffer]) => {
      const source = new AudioBufferSourceNode(this.context, { buffer, loop: this.loop, loopStart: from, loopEnd: to });
      const gain = new GainNode(this.context, { gain: name === slot ? 1 : 0 });
      source.connect(gain).connect(this.context.destination);
      if (this.loop) source.start(at, from); else source.start(at, from, to - from);
      this.gains[name] = gain.gain;
      return source;
    });
    this.ends();
    this.heard(slot);
  }

  // Hear a slot: begin, or switch at the same place; nothing where it was played often enough.
  play(slot) {
    if (!this.may(slot)) return;
    this.context.resume();
    if (!this.sources || this.options.restart) return this.start(slot);
    this.mark();
    for (const [name, gain] of Object.entries(this.gains)) ramp(this.context, gain, name === slot ? 1 : 0, SWITCH);
    this.heard(slot);
  }

  heard(slot) {
    this.playing = slot;
    this.plays[slot] += 1;
    this.onchange();
  }

  // One slot after the other, with 0.5 s between: the intervals of a forced choice.
  sequence(slots, gap = 0.5) {
    if (slots.some(slot => !this.may(slot))) return;
    this.context.resume();
    this.halt();
    const sources = [], gain = new GainNode(this.context), order = [];
    gain.connect(this.context.destination);
    let at = this.context.currentTime + 0.05;
    slots.forEach(slot => {
      const source = new AudioBufferSourceNode(this.context, { buffer: this.buffers[slot] });
      source.connect(gain);
      source.start(at);
      order.push([slot, at]);
      const wait = (at - this.context.currentTime) * 1000;
      setTimeout(() => { if (this.sources === sources) this.heard(slot); }, wait);
      at += this.buffers[slot].duration + gap;
      sources.push(source);
    });
    this.sources = sources;
    this.order = order;
    this.gains = { sequence: gain.gain };
    this.marked = this.context.currentTime;
    this.ends();
  }

  // The last source ends by itself; until then the parts heard are marked.
  ends() {
    const sources = this.sources;
    sources[sources.length - 1].onended = () => { if (this.sources === sources) { this.halt(); this.onchange(); } };
    this.timer = setInterval(() => this.mark(), 30);
  }

  // Mark the parts that were heard since the last call.
  mark() {
    const now = this.context.currentTime, before = this.marked, [from, to] = this.region;
    this.marked = now;
    if (this.order) {
      for (const [slot, at] of this.order) this.markParts(slot, before - at, now - at);
    } else if (this.playing !== null) {
      let a = Math.max(before - this.began, from), b = now - this.began;
      if (!this.loop) return this.markParts(this.playing, a, Math.min(b, to));
      const length = to - from, whole = Math.floor((a - from) / length) * length;
      a -= whole; b -= whole;
      this.markParts(this.playing, a, Math.min(b, to));
      if (b > to) this.markParts(this.playing, from, Math.min(b - length, to));
    }
  }

  markParts(slot, from, to) {
    const size = this.lasts[slot] / PARTS, first = Math.max(Math.floor(from / size + 0.5), 0);
    for (let k = first; k < PARTS && (k + 1) * size <= to + size / 2; k++) this.parts[slot][k] = 1;
  }

  halt() {
    if (this.sources) this.mark();
    clearInterval(this.timer);
    for (const gain of Object.values(this.sources ? this.gains : {})) ramp(this.context, gain, 0, FADE);
    for (const source of this.sources || []) { source.onended = null; source.stop(this.context.currentTime + FADE); }
    this.sources = null;
    this.order = null;
    this.playing = null;
  }

  stop() { this.halt(); this.onchange(); }

  // Counts and parts heard, to be kept over a reload of the page.
  kept() { return { plays: this.plays, parts: Object.fromEntries(Object.entries(this.parts).map(([s, p]) => [s, p.join("")])) }; }

  restore(kept) {
    for (const slot of Object.keys(this.buffers)) {
      this.plays[slot] = (kept.plays || {})[slot] || 0;
      const parts = (kept.parts || {})[slot];
      if (parts && parts.length === PARTS) this.parts[slot] = Uint8Array.from(parts, Number);
    }
  }
}
