// The stream of the desk's sound: fetched, cut into blocks, played by the worklet; what arrives late is counted.
const HEAD = 20;

export class Sound {
  constructor(api, say) {
    this.api = api;
    this.say = say;
    this.context = null;
    this.meter = { heard: 0, waiting: 0, underruns: 0 };
    this.serial = 0;
    this.frame = 0;
    this.playing = false;
    this.ahead = 0.1;
    this.stream = 0;
    this.waits = new Map();
    this.recorded = null;
    this.toSound = null;
  }

  get on() {
    return this.reading === true;
  }

  // Must be called in the course of a click or a key.
  async start(fs) {
    if (!this.context) {
      this.context = new AudioContext({ sampleRate: fs, latencyHint: "interactive" });
      await this.context.audioWorklet.addModule("/static/ring.js");
      this.ring = new AudioWorkletNode(this.context, "ring", { numberOfInputs: 0, outputChannelCount: [2] });
      this.analyser = new AnalyserNode(this.context, { fftSize: 8192, smoothingTimeConstant: 0, minDecibels: -110 });
      this.ring.connect(this.analyser).connect(this.context.destination);
      this.ring.port.onmessage = ({ data }) => this.#told(data);
    }
    await this.context.resume();
    if (!this.reading) this.#read();
  }

  #told(data) {
    if (data.serial !== undefined) {
      this.serial = data.serial;
      this.when = performance.now();
      for (const [serial, began] of this.waits) {
        if (serial > data.serial) continue;
        this.#timed(began);
        this.waits.delete(serial);
      }
    } else if (data.recorded) this.recorded?.push(data.recorded);
    else this.meter = data;
  }

  // Begin the clock of a change: stopped when its serial is heard.
  changed(serial, began) {
    if (serial > this.serial) this.waits.set(serial, began);
    else if (serial === this.serial && this.when > began) this.#timed(began); // heard before the reply came
    if (this.waits.size > 50) this.waits.clear();
  }

  #timed(began) {
    this.toSound = this.when - began + 1000 * (this.context.outputLatency || 0);
  }

  get latency() {
    if (!this.context) return null;
    const card = (this.context.baseLatency || 0) + (this.context.outputLatency || 0);
    return this.meter.waiting / this.context.sampleRate + card;
  }

  record(on) {
    this.recorded = on ? [] : this.recorded;
    this.ring.port.postMessage({ record: on });
  }

  async #read() {
    let again = false;
    this.reading = true;
    this.ring.port.postMessage({ clear: true });
    const clock = setInterval(() => this.#report(), 200);
    try {
      const reply = await this.api.raw("/api/stream");
      this.stream = Number(reply.headers.get("X-Desk-Stream"));
      const reader = reply.body.getReader();
      let rest = new Uint8Array(0);
      for (;;) {
        const { value, done } = await reader.read();
        if (done) break;
        const bytes = new Uint8Array(rest.length + value.length);
        bytes.set(rest);
        bytes.set(value, rest.length);
        rest = this.#blocks(bytes);
      }
      await this.#report();
      if (this.taken) this.say("Another page has the sound now. Press Play to hear it here.");
      else again = true; // the machine was too busy to hear of this page
    } catch (fault) {
      this.say(`The sound broke off: ${fault.message}`);
    } finally {
      clearInterval(clock);
      this.reading = false;
      this.taken = false;
    }
    if (again) this.#read();
  }

  #blocks(bytes) {
    let at = 0;
    while (bytes.length - at >= HEAD) {
      const head = new DataView(bytes.buffer, bytes.byteOffset + at, HEAD);
      const size = HEAD + 8 * head.getUint32(0, true);
      if (bytes.length - at < size) break;
      const sound = new Float32Array(bytes.slice(at + HEAD, at + size).buffer);
      this.frame = head.getUint32(8, true);
      this.playing = head.getUint32(12, true) === 1;
      this.ring.port.postMessage({ sound, serial: head.getUint32(4, true), place: head.getUint32(16, true) }, [sound.buffer]);
      at += size;
    }
    return bytes.slice(at);
  }

  async #report() {
    // after an underrun further blocks are asked for ahead
    this.calm = this.meter.underruns > (this.before ?? 0) ? 0 : (this.calm ?? 0) + 1;
    this.before = this.meter.underruns;
    if (this.calm === 0) this.ahead = Math.min(this.ahead * 1.5, 0.6);
    else if (this.calm % 150 === 0) this.ahead = Math.max(this.ahead * 0.8, 0.1); // after 30 s without one
    const { heard, underruns } = this.meter;
    try {
      const reply = await this.api.post("/api/heard", { stream: this.stream, heard, underruns, ahead: this.ahead });
      if (reply.stream !== this.stream && this.stream) this.taken = true;
    } catch {
      // the page's own poll says that the desk is gone
    }
  }
}
