// Plays blocks at their places in the stream; silence while none is there, counted as one underrun each time.
class Ring extends AudioWorkletProcessor {
  constructor() {
    super();
    this.blocks = [];
    this.waiting = 0;
    this.heard = 0;
    this.underruns = 0;
    this.dry = true;
    this.serial = 0;
    this.enough = 1536;
    this.record = false;
    this.told = 0;
    this.port.onmessage = ({ data }) => {
      if (data.sound) this.#take(data);
      else if (data.clear) {
        this.blocks = [];
        this.waiting = 0;
        this.heard = 0;
        this.underruns = 0;
        this.dry = true;
      } else Object.assign(this, data);
    };
  }

  // A block drops all that waits from its place on; of one that comes late the rest is played.
  #take({ sound, serial, place }) {
    for (const old of this.blocks) old.end = Math.min(old.end, Math.max(old.at, place - old.place));
    this.blocks = this.blocks.filter((old) => old.at < old.end);
    const end = sound.length / 2, at = Math.min(Math.max(0, this.heard - place), end);
    if (at < end) this.blocks.push({ sound, serial, place, at, end });
    this.waiting = this.blocks.reduce((sum, block) => sum + block.end - block.at, 0);
  }

  process(_, [[left, right]]) {
    if (this.dry && this.waiting >= this.enough) this.dry = false;
    let n = 0;
    while (!this.dry && n < left.length) {
      const block = this.blocks[0];
      if (!block) {
        this.dry = true;
        this.underruns += 1;
        break;
      }
      if (block.serial !== this.serial) {
        this.serial = block.serial;
        this.port.postMessage({ serial: this.serial });
      }
      for (; n < left.length && block.at < block.end; n++, block.at++) {
        left[n] = block.sound[2 * block.at];
        right[n] = block.sound[2 * block.at + 1];
        this.waiting -= 1;
      }
      this.heard = block.place + block.at;
      if (block.at === block.end) this.blocks.shift();
    }
    if (this.record && n) this.port.postMessage({ recorded: [left.slice(0, n), right.slice(0, n)] });
    if ((this.told += left.length) >= 2048) {
      this.told = 0;
      this.port.postMessage({ heard: this.heard, waiting: this.waiting, underruns: this.underruns });
    }
    return true;
  }
}

registerProcessor("ring", Ring);
