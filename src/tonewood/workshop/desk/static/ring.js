// Plays blocks in the order in which they came; silence while none is there, counted as one underrun each time.
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
      if (data.sound) {
        this.blocks.push({ ...data, at: 0 });
        this.waiting += data.sound.length / 2;
      } else if (data.clear) {
        this.blocks = [];
        this.waiting = 0;
        this.heard = 0;
        this.underruns = 0;
        this.dry = true;
      } else Object.assign(this, data);
    };
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
      const end = block.sound.length / 2;
      for (; n < left.length && block.at < end; n++, block.at++) {
        left[n] = block.sound[2 * block.at];
        right[n] = block.sound[2 * block.at + 1];
        this.waiting -= 1;
        this.heard += 1;
      }
      if (block.at === end) this.blocks.shift();
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
