"use strict";
// All sounds of a player start together; choosing one crosses their gains over 20 ms, so that a switch leaves no gap.
(() => {
  const CROSSING = 0.02, AHEAD = 0.05;
  let context = null, current = null;

  const bytes = uri => Uint8Array.from(atob(uri.slice(uri.indexOf(",") + 1)), c => c.charCodeAt(0)).buffer;

  for (const player of document.querySelectorAll(".player")) {
    const sounds = [...player.parentElement.querySelectorAll("audio")];
    const play = player.querySelector("[data-play]");
    const choices = [...player.querySelectorAll("[data-sound]")];
    let buffers = null, running = null, chosen = 0;

    const show = () => {
      play.textContent = running ? "Stop" : "Play";
      choices.forEach((button, i) => button.setAttribute("aria-pressed", String(i === chosen)));
      player.dataset.state = running ? "playing" : "stopped";
      player.dataset.chosen = String(chosen);
    };

    const stop = () => {
      if (running) for (const { source } of running) { source.onended = null; source.stop(); }
      running = null;
      if (current === stop) current = null;
      show();
    };

    const start = async () => {
      context ??= new AudioContext();
      await context.resume();
      buffers ??= await Promise.all(sounds.map(sound => context.decodeAudioData(bytes(sound.src))));
      if (current) current();
      const when = context.currentTime + AHEAD;
      running = buffers.map((buffer, i) => {
        const source = context.createBufferSource(), gain = context.createGain();
        source.buffer = buffer;
        gain.gain.value = i === chosen ? 1 : 0;
        source.connect(gain).connect(context.destination);
        source.start(when);
        return { source, gain };
      });
      running[0].source.onended = stop;
      current = stop;
      show();
    };

    const choose = i => {
      chosen = i;
      if (running) {
        const now = context.currentTime;
        running.forEach(({ gain }, k) => {
          gain.gain.cancelScheduledValues(now);
          gain.gain.setValueAtTime(gain.gain.value, now);
          gain.gain.linearRampToValueAtTime(k === i ? 1 : 0, now + CROSSING);
        });
        show();
      } else {
        start();
      }
    };

    play.addEventListener("click", () => (running ? stop() : start()));
    choices.forEach((button, i) => button.addEventListener("click", () => choose(i)));
    player.hidden = false;
    show();
  }
})();
