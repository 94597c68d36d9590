"use strict";
// Gapless players on the Web Audio API. All sounds of a page run together from one start; switching fades their gains in
// 5 ms, so that the place in the sound stays the same to the sample. A sound that is stopped fades out: a step would be
// heard as a click.

const SWITCH = 0.005, FADE = 0.02;

// A gain to a value in some seconds, from where it is now.
function ramp(context, gain, value, seconds) {
  const now = context.currentTime;
  gain.cancelScheduledValues(now);
  gain.setValueAtTime(gain.value, now);
  gain.linearRampToValueAtTime(value, now + seconds);
}

class Sounds {
  constructor(context, buffers) {
    this.context = context;
    this.buffers = buffers;            // slot -> AudioBuffer
    this.loop = false;
    this.playing = null;               // slot that is heard
    this.plays = {};
    this.onchange = () => {};
    this.sources = null;
    for (const slot of Object.keys(buffers)) this.plays[slot] = 0;
  }

  get duration() { return Math.max(...Object.values(this.buffers).map(b => b.duration)); }

  get position() {
    if (!this.sources) return this.held || 0;
    const t = this.context.currentTime - this.began;
    return this.loop ? t % this.duration : Math.min(t, this.duration);
  }

  start(slot, offset = 0) {
    this.halt();
    const at = this.context.currentTime + 0.03;
    this.began = at - offset;
    this.gains = {};
    this.sources = Object.entries(this.buffers).map(([name, buffer]) => {
      const source = new AudioBufferSourceNode(this.context, { buffer, loop: this.loop });
      const gain = new GainNode(this.context, { gain: name === slot ? 1 : 0 });
      source.connect(gain).connect(this.context.destination);
      source.start(at, offset);
      this.gains[name] = gain.gain;
      return source;
    });
    const sources = this.sources;
    sources[0].onended = () => { if (this.sources === sources) { this.halt(); this.onchange(); } };
    this.heard(slot);
  }

  // Hear a slot: begin, or switch at the same place.
  play(slot) {
    this.context.resume();
    if (!this.sources) return this.start(slot, 0);
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
    this.context.resume();
    this.halt();
    const sources = [], gain = new GainNode(this.context);
    gain.connect(this.context.destination);
    let at = this.context.currentTime + 0.05;
    slots.forEach(slot => {
      const source = new AudioBufferSourceNode(this.context, { buffer: this.buffers[slot] });
      source.connect(gain);
      source.start(at);
      const wait = (at - this.context.currentTime) * 1000;
      setTimeout(() => { if (this.sources === sources) this.heard(slot); }, wait);
      at += this.buffers[slot].duration + gap;
      sources.push(source);
    });
    this.sources = sources;
    this.gains = { sequence: gain.gain };
    this.began = this.context.currentTime;
    sources[sources.length - 1].onended = () => { if (this.sources === sources) { this.halt(); this.onchange(); } };
  }

  halt() {
    for (const gain of Object.values(this.sources ? this.gains : {})) ramp(this.context, gain, 0, FADE);
    for (const source of this.sources || []) { source.onended = null; source.stop(this.context.currentTime + FADE); }
    this.sources = null;
    this.playing = null;
  }

  stop() { this.halt(); this.onchange(); }
}
