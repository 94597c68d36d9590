// Pictures on canvases: each is drawn from plain data, in the colours of the page's style, with a text for readers.
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const log = Math.log10;

// A canvas of its shown size, cleared, and a frame of two axes; returns its pen and scales.
function framed(canvas, x, y, { xlog = false, ylog = false, xticks, yticks, xunit = "", yunit = "" }) {
  const ratio = devicePixelRatio || 1;
  const width = canvas.clientWidth, height = Number(canvas.getAttribute("data-height") ?? canvas.height);
  canvas.dataset.height = height;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  canvas.style.height = `${height}px`;
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  pen.clearRect(0, 0, width, height);
  pen.font = "12px system-ui, sans-serif";
  const box = { left: 46, right: width - 8, top: yunit ? 22 : 8, bottom: height - 22 };
  const scale = (lo, hi, a, b, isLog) => (v) => {
    const t = isLog ? (log(Math.max(v, 1e-30)) - log(lo)) / (log(hi) - log(lo)) : (v - lo) / (hi - lo);
    return a + t * (b - a);
  };
  const X = scale(...x, box.left, box.right, xlog), Y = scale(...y, box.bottom, box.top, ylog);
  pen.strokeStyle = colour("rule");
  pen.fillStyle = colour("soft");
  pen.lineWidth = 1;
  pen.beginPath();
  for (const v of xticks ?? []) {
    pen.moveTo(X(v), box.top);
    pen.lineTo(X(v), box.bottom);
    pen.fillText(v >= 1000 ? `${v / 1000}k` : `${v}`, X(v) - 8, box.bottom + 14);
  }
  for (const v of yticks ?? []) {
    pen.moveTo(box.left, Y(v));
    pen.lineTo(box.right, Y(v));
    pen.fillText(`${v}`, 4, Y(v) + 4);
  }
  pen.stroke();
  const shown = pen.measureText(xunit).width;
  pen.fillText(xunit, box.right - shown, box.bottom + 14);
  pen.fillText(yunit, 4, 14);
  return { pen, X, Y, box };
}

function curve(pen, xs, ys, X, Y, stroke, width = 1.5) {
  pen.strokeStyle = stroke;
  pen.lineWidth = width;
  pen.beginPath();
  xs.forEach((x, i) => (i ? pen.lineTo(X(x), Y(ys[i])) : pen.moveTo(X(x), Y(ys[i]))));
  pen.stroke();
}

const decades = [50, 100, 200, 500, 1000, 2000, 5000, 10000];

export function mobility(canvas, now, start, string) {
  const name = now.db[string] ? string : Object.keys(now.db)[0];
  if (!name) return null;
  const all = [...now.db[name], ...(start?.db[name] ?? [])];
  const top = 10 * Math.ceil((Math.max(...all) + 1) / 10);
  const range = [Math.max(top - 70, 10 * Math.floor(Math.min(...all) / 10)), top];
  const ticks = Array.from({ length: 9 }, (_, i) => top - 10 * i).filter((v) => v > range[0]);
  const ends = [now.freq[0], now.freq.at(-1)];
  const { pen, X, Y, box } = framed(canvas, ends, range, { xlog: true, xticks: decades.filter((f) => f > ends[0] && f < ends[1]), yticks: ticks, xunit: "Hz", yunit: "dB re 1 (m/s)/N" });
  pen.save();
  pen.beginPath();
  pen.rect(box.left, box.top, box.right - box.left, box.bottom - box.top);
  pen.clip();
  if (start?.db[name]) curve(pen, start.freq, start.db[name], X, Y, colour("line"), 1);
  curve(pen, now.freq, now.db[name], X, Y, colour("accent"), 2);
  pen.restore();
  canvas.setAttribute("aria-label", `Bridge mobility at ${name}, ${now.n_modes} modes of the body; the strongest are listed below`);
  const from = (px) => 10 ** (log(ends[0]) + ((px - box.left) / (box.right - box.left)) * (log(ends[1]) - log(ends[0])));
  return { from };
}

// The shape of a mode at a phase: squares of the plate in two colours, nodal lines where sand would lie.
export function shape(canvas, data, phase) {
  const swing = Math.cos(phase);
  const said = `${data.label ? `${data.label}, ` : ""}mode at ${data.freq.toFixed(1)} Hz, Q ${data.q?.toFixed(0) ?? "infinite"}`;
  canvas.setAttribute("aria-label", `${said}; at the strings' ends ${data.strings.map((s, i) => `${s} ${data.ends[i]}`).join(", ")}`);
  if (!data.points.length) {
    const { pen, X, Y, box } = framed(canvas, [-1, data.ends.length], [-1.1, 1.1], { yticks: [-1, 0, 1], yunit: "displacement at the strings' ends" });
    const wide = Math.min(28, (box.right - box.left) / (data.ends.length + 2) - 4);
    data.ends.forEach((v, i) => {
      pen.fillStyle = colour(v < 0 ? "a" : "accent");
      pen.fillRect(X(i) - wide / 2, Math.min(Y(0), Y(v * swing)), wide, Math.abs(Y(v * swing) - Y(0)));
      pen.fillStyle = colour("soft");
      if (data.ends.length < 20) pen.fillText(data.strings[i], X(i) - 9, box.bottom + 14);
    });
    return said;
  }
  const xs = data.rings[0].map((p) => p[0]), ys = data.rings[0].map((p) => p[1]);
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const { pen } = framed(canvas, [0, 1], [0, 1], {});
  const height = Number(canvas.dataset.height), width = canvas.clientWidth;
  const size = Math.min((width - 16) / (x1 - x0), (height - 16) / (y1 - y0));
  const X = (x) => width / 2 + (x - (x0 + x1) / 2) * size, Y = (y) => height / 2 + (y - (y0 + y1) / 2) * size;
  const side = 0.0101 * size;
  pen.clearRect(0, 0, width, height);
  const sand = colour("ink");
  const shade = (v) => `color-mix(in srgb, ${colour(v > 0 ? "accent" : "a")} ${Math.min(100, Math.abs(v) * 100)}%, ${colour("paper")})`;
  const shades = Array.from({ length: 41 }, (_, i) => shade((i - 20) / 20));
  data.points.forEach(([x, y], i) => {
    const h = data.heights[i];
    pen.fillStyle = shades[20 + Math.round(20 * Math.max(-1, Math.min(1, h * swing)))];
    pen.fillRect(X(x) - side / 2, Y(y) - side / 2, side, side);
    if (Math.abs(h) < 0.05) {
      pen.fillStyle = sand;
      pen.fillRect(X(x) - side / 4, Y(y) - side / 4, side / 2, side / 2);
    }
  });
  for (const ring of data.rings) curve(pen, [...ring, ring[0]].map((p) => p[0]), [...ring, ring[0]].map((p) => p[1]), X, Y, colour("line"));
  return said;
}

const shades = ["accent", "a", "b", "c", "line", "ink"];

export function energy(canvas, moments, fs) {
  if (!moments.length) return "";
  const names = Object.keys(moments[0].strings).slice(0, 12);
  const t = moments.map((m) => m.frame / fs);
  const top = Math.max(1e-12, ...moments.map((m) => Math.max(m.body, m.sound ?? 0, ...Object.values(m.strings))));
  const high = 10 ** Math.ceil(log(top)), low = high * 1e-6;
  const ticks = [0, 2, 4].map((k) => Number((high * 10 ** -k).toPrecision(1)));
  const { pen, X, Y, box } = framed(canvas, [0, Math.max(1, t.at(-1))], [low, high], { ylog: true, xticks: [0, 1, 2, 3, 4, 5, 10, 20, 30, 40, 50].filter((s) => s <= t.at(-1)), xunit: "s", yunit: "J" });
  pen.fillStyle = colour("soft");
  for (const v of ticks) pen.fillText(v.toExponential(0), 2, Y(v) + 10);
  const line = (values, stroke, width, label) => {
    curve(pen, t, values.map((v) => Math.max(v, low)), X, Y, stroke, width);
    pen.fillStyle = stroke;
    return label;
  };
  names.forEach((name, i) => line(moments.map((m) => m.strings[name]), colour(shades[i % shades.length]), 1));
  line(moments.map((m) => m.body), colour("ink"), 3);
  const heard = moments.at(-1).sound !== null;
  if (heard) {
    pen.setLineDash([5, 4]);
    line(moments.map((m) => m.sound ?? 0), colour("warn"), 2);
    pen.setLineDash([]);
  }
  pen.save();
  pen.textAlign = "right";
  [["strings, thin", "accent"], ["body, thick", "ink"], ...(heard ? [["left as sound, dashed", "warn"]] : [])].forEach(([text, shade], i) => {
    pen.fillStyle = colour(shade);
    pen.fillText(text, box.right - 4, box.top + 12 + 15 * i);
  });
  pen.restore();
  const last = moments.at(-1);
  const mJ = (v) => `${(1e3 * v).toPrecision(2)} mJ`;
  const words = `strings ${mJ(Object.values(last.strings).reduce((a, b) => a + b, 0))}, body ${mJ(last.body)}${heard ? `, left as sound ${mJ(last.sound)}` : ""}`;
  canvas.setAttribute("aria-label", `Energy at ${t.at(-1).toFixed(1)} s: ${words}`);
  return words;
}

// Time at which a spectrogram was drawn last: 60 pixels are a second.
const drawn = new WeakMap();

export function spectrogram(canvas, analyser, fs) {
  const ratio = devicePixelRatio || 1;
  const height = (canvas.dataset.height ??= canvas.height) * ratio, width = Math.round(canvas.clientWidth * ratio);
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
    canvas.style.height = `${canvas.dataset.height}px`;
  }
  if (!width) return;
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  const bins = new Float32Array(analyser.frequencyBinCount);
  analyser.getFloatFrequencyData(bins);
  const time = performance.now(), wide = Math.min(width, Math.round((time - (drawn.get(canvas) ?? time)) * 0.06 * ratio));
  if (wide < 1) return void (drawn.has(canvas) || drawn.set(canvas, time));
  drawn.set(canvas, time);
  pen.drawImage(canvas, -wide, 0);
  const column = pen.createImageData(wide, height);
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  for (let y = 0; y < height; y++) {
    const f = 50 * 200 ** (1 - y / height);
    const level = bins[Math.min(bins.length - 1, Math.round((f / fs) * 2 * bins.length))];
    const v = Math.max(0, Math.min(1, (level + 105) / 80)), shade = dark ? 25 + 230 * v : 255 - 255 * v;
    for (let x = 0; x < wide; x++) column.data.set([shade * (dark ? 0.75 : 0.85), shade * 0.92, dark ? shade : 255 - 140 * v, 255], 4 * (wide * y + x));
  }
  pen.putImageData(column, width - wide, 0);
  pen.font = `${12 * ratio}px system-ui, sans-serif`;
  pen.fillStyle = colour("paper");
  pen.fillRect(0, 0, 34 * ratio, height);
  pen.fillStyle = colour("soft");
  for (const f of [100, 200, 500, 1000, 2000, 5000]) pen.fillText(f >= 1000 ? `${f / 1000}k` : `${f}`, 2, height * (1 - Math.log(f / 50) / Math.log(200)));
}

export function partials(canvas, row, before) {
  const found = row.partials.filter((p) => p.t60);
  if (!found.length) return;
  const all = [...found, ...(before?.partials ?? []).filter((p) => p.t60)].map((p) => p.t60);
  const range = [0.7 * Math.min(...all), 1.4 * Math.max(...all)];
  const { pen, X, Y } = framed(canvas, [0, found.at(-1).freq * 1.05], range, { ylog: true, xticks: [500, 1000, 2000, 3000, 4000].filter((f) => f < found.at(-1).freq), yticks: [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20].filter((v) => v > range[0] && v < range[1]), xunit: "Hz", yunit: "T60, s" });
  for (const [list, shade, size] of [[(before?.partials ?? []).filter((p) => p.t60), "line", 3], [found, "accent", 4.5]]) {
    pen.fillStyle = colour(shade);
    for (const p of list) {
      pen.beginPath();
      pen.arc(X(p.freq), Y(p.t60), size, 0, 7);
      pen.fill();
    }
  }
  canvas.setAttribute("aria-label", `T60 of ${found.length} partials of ${row.string}, as in the table`);
}

export function wolves(canvas, data) {
  const rows = data.neck, longest = Math.max(...rows.map((r) => r.freqs.length));
  const { pen, X, Y, box } = framed(canvas, [-0.6, longest - 0.4], [-0.6, rows.length - 0.4], { xticks: [0, 5, 10, 15, 20, 25].filter((s) => s < longest), xunit: "stop" });
  const wide = (box.right - box.left) / longest - 2, high = (box.bottom - box.top) / rows.length - 2;
  rows.forEach((row, i) => {
    pen.fillStyle = colour("soft");
    if (rows.length < 30) pen.fillText(row.string, 6, Y(i) + 4);
    row.freqs.forEach((_, stop) => {
      const size = (list) => Math.max(0, ...list.filter((w) => w.string === row.string && w.stops.includes(stop)).map((w) => w.severity_cents));
      const now = size(data.wolves), then = size(data.start);
      pen.fillStyle = colour("warn");
      pen.globalAlpha = 0.06 + Math.min(0.9, now / 60);
      pen.fillRect(X(stop) - wide / 2, Y(i) - high / 2, wide, high);
      pen.globalAlpha = 1;
      if (then > 5) {
        pen.strokeStyle = colour("line");
        pen.strokeRect(X(stop) - wide / 2, Y(i) - high / 2, wide, high);
      }
    });
  });
  canvas.setAttribute("aria-label", `Wolf notes along the neck, ${data.wolves.length} found; outlines: those of the start`);
}

export function force(canvas, data) {
  const top = Math.max(...data.force.map(Math.abs), 1e-9) * 1.1;
  const t = data.force.map((_, i) => 1e3 * (i / data.fs - data.before));
  const { pen, X, Y } = framed(canvas, [t[0], t.at(-1)], [-top, top], { xticks: [0, 10, 20, 30, 40, 50], yticks: [Number((-top / 2).toPrecision(1)), 0, Number((top / 2).toPrecision(1))], xunit: "ms", yunit: "N" });
  curve(pen, t, data.force, X, Y, colour("accent"), 1.2);
  canvas.setAttribute("aria-label", `Force of ${data.string} on the body: largest ${(top / 1.1).toPrecision(3)} N`);
}
