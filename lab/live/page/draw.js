// Charts and planes on a canvas: numbers in, ink out.
export const COLOURS = ["#20639b", "#c0562c", "#2f7d4f", "#7b4f9d", "#8a6d1b", "#1b7f86", "#a33b63", "#55636e", "#5f7f2a"];
const INK = "#1c2730", SOFT = "#5b6b78", LINE = "#d9e0e5", BAD = "#b3261e", MODEL = "#20639b", MEASURED = "#b5382a", GREY = "#b6c2cb";
const FONT = "12px system-ui, 'Segoe UI', 'Liberation Sans', sans-serif";

function prepared(canvas) {
  const ratio = globalThis.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = FONT;
  pen.lineJoin = "round";
  return { pen, width, height };
}

// Round values between two ends, some five of them.
export function ticks(low, high, wanted = 5) {
  const span = high - low;
  if (!(span > 0) || !Number.isFinite(span)) return [];
  const raw = span / wanted, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((n) => n * power >= raw * 0.999);
  const out = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * span; k++) out.push(k * step);
  return out;
}

const text = (value) => (Math.abs(value) < 1e-12 ? "0" : String(Number(value.toPrecision(6))));

function range(values, least) {
  let low = Infinity, high = -Infinity;
  for (const v of values) {
    if (v === null || v === undefined || !Number.isFinite(v)) continue;
    low = Math.min(low, v);
    high = Math.max(high, v);
  }
  if (low > high) return [0, least];
  const pad = Math.max(0.08 * (high - low), 0.5 * Math.max(0, least - (high - low)));
  return [low - pad, high + pad];
}

function frame(pen, box, xs, ys, x, y) {
  pen.strokeStyle = LINE;
  pen.fillStyle = SOFT;
  pen.lineWidth = 1;
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  for (const v of ys) {
    pen.beginPath();
    pen.moveTo(box.left, y(v));
    pen.lineTo(box.right, y(v));
    pen.stroke();
    pen.fillText(text(v), box.left - 5, y(v));
  }
  pen.textBaseline = "top";
  pen.textAlign = "center";
  for (const v of xs) {
    pen.beginPath();
    pen.moveTo(x(v), box.top);
    pen.lineTo(x(v), box.bottom);
    pen.stroke();
    pen.fillText(text(v), x(v), box.bottom + 4);
  }
}

// series: [{t, v, colour, dash, width}], values in the unit that is shown; limits: [value]; from .. to: seconds.
export function chart(canvas, { series, from, to, unit, limits = [], least = 1, zero = false }) {
  const { pen, width, height } = prepared(canvas);
  const box = { left: 46, right: width - 6, top: 18, bottom: height - 20 };
  const values = series.flatMap((s) => s.v);
  let [low, high] = range(values, least);
  if (zero) low = Math.min(low, 0);
  for (const limit of limits) if (limit <= 4 * high) high = Math.max(high, 1.05 * limit);
  const x = (t) => box.left + ((t - from) / (to - from || 1)) * (box.right - box.left);
  const y = (v) => box.bottom - ((v - low) / (high - low || 1)) * (box.bottom - box.top);
  frame(pen, box, ticks(from, to, Math.max(2, Math.min(6, width / 90))), ticks(low, high, 4), x, y);
  pen.textAlign = "left";
  pen.textBaseline = "top";
  pen.fillText(unit, 2, 1);
  pen.textAlign = "right";
  pen.fillText("s", box.right, 1);
  pen.save();
  pen.beginPath();
  pen.rect(box.left, box.top - 2, box.right - box.left, box.bottom - box.top + 4);
  pen.clip();
  for (const limit of limits) line(pen, [[box.left, y(limit)], [box.right, y(limit)]], BAD, 1.2, [2, 4]);
  for (const s of series) {
    const places = s.t.map((t, k) => (s.v[k] === null ? null : [x(t), y(s.v[k])]));
    line(pen, places, s.colour, s.width ?? 1.6, s.dash ?? []);
  }
  pen.restore();
}

function line(pen, places, colour, width, dash) {
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.setLineDash(dash);
  pen.beginPath();
  let down = false;
  for (const place of places) {
    if (place === null) { down = false; continue; }
    if (down) pen.lineTo(...place); else pen.moveTo(...place);
    down = true;
  }
  pen.stroke();
  pen.setLineDash([]);
}

// One plane of the tip, mm; `down`: the second axis points downwards, as the robot hangs.
// `compared`: the measured tip that `expected` is about, joined to it by a line.
export function plane(canvas, { axes, trail, states, tip, hidden, expected, compared, box: around, down }) {
  const { pen, width, height } = prepared(canvas);
  const box = { left: 44, right: width - 8, top: 18, bottom: height - 20 };
  const [a, b] = axes;
  const corners = around === null ? [] : [around.low, around.high];
  const all = [...trail, ...states, ...corners, ...[tip, expected, compared].filter(Boolean)];
  const [l0, h0] = range(all.map((p) => p[a]), 20), [l1, h1] = range(all.map((p) => p[b]), 20);
  const per = Math.max((h0 - l0) / (box.right - box.left), (h1 - l1) / (box.bottom - box.top)) || 1;
  const c0 = (l0 + h0) / 2, c1 = (l1 + h1) / 2, m0 = (box.left + box.right) / 2, m1 = (box.top + box.bottom) / 2;
  const x = (v) => m0 + (v - c0) / per, y = (v) => m1 + ((down ? 1 : -1) * (v - c1)) / per;
  const half0 = (per * (box.right - box.left)) / 2, half1 = (per * (box.bottom - box.top)) / 2;
  frame(pen, box, ticks(c0 - half0, c0 + half0), ticks(c1 - half1, c1 + half1), x, y);
  pen.textAlign = "left";
  pen.textBaseline = "top";
  pen.fillText(`${"xyz"[b]}, mm`, 2, 1);
  pen.textAlign = "right";
  pen.fillText(`${"xyz"[a]}, mm`, box.right, 1);
  pen.fillStyle = GREY;
  for (const p of states) dot(pen, x(p[a]), y(p[b]), 2.5);
  line(pen, trail.map((p) => [x(p[a]), y(p[b])]), MEASURED + "66", 1.2, []);
  if (expected) {
    pen.strokeStyle = MODEL;
    pen.lineWidth = 1.6;
    if (around !== null) {
      const left = x(around.low[a]), right = x(around.high[a]), one = y(around.low[b]), other = y(around.high[b]);
      pen.fillStyle = MODEL + "22";
      pen.fillRect(left, Math.min(one, other), right - left, Math.abs(one - other));
      pen.strokeRect(left, Math.min(one, other), right - left, Math.abs(one - other));
    }
    pen.strokeRect(x(expected[a]) - 4, y(expected[b]) - 4, 8, 8);
    if (compared) {
      line(pen, [expected, compared].map((p) => [x(p[a]), y(p[b])]), MODEL, 1.2, []);
      pen.fillStyle = MODEL;
      dot(pen, x(compared[a]), y(compared[b]), 3);
    }
  }
  if (tip) {
    if (hidden) {
      pen.strokeStyle = MEASURED;
      pen.lineWidth = 2;
      pen.beginPath();
      pen.arc(x(tip[a]), y(tip[b]), 5, 0, 7);
      pen.stroke();
    } else {
      pen.fillStyle = MEASURED;
      dot(pen, x(tip[a]), y(tip[b]), 5);
    }
  }
}

function dot(pen, x, y, radius) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 7);
  pen.fill();
}

// Points with bars: [{x, y, bar, off}], `bar`: how far the value may be by its interval; off: it is beyond.
export function dots(canvas, { points, unit, across }) {
  const { pen, width, height } = prepared(canvas);
  const box = { left: 46, right: width - 6, top: 18, bottom: height - 20 };
  const xs = points.map((p) => p.x);
  const most = Math.max(points.length ? 1e-9 : 1, ...points.map((p) => Math.max(p.y, p.bar ?? 0)));
  const first = xs.length ? Math.min(...xs) - 0.5 : 0, last = Math.max(first + 10, ...xs.map((v) => v + 0.5));
  const x = (v) => box.left + ((v - first) / (last - first)) * (box.right - box.left);
  const y = (v) => box.bottom - (v / (1.1 * most)) * (box.bottom - box.top);
  frame(pen, box, ticks(first, last, 8).filter(Number.isInteger), ticks(0, 1.1 * most, 4), x, y);
  pen.textAlign = "left";
  pen.textBaseline = "top";
  pen.fillText(unit, 2, 1);
  pen.textAlign = "right";
  pen.fillText(across, box.right, 1);
  const wide = Math.max(2, Math.min(12, 0.6 * (x(1) - x(0))));
  for (const p of points) {
    if (p.bar !== null && p.bar !== undefined) {
      pen.fillStyle = MODEL + "33";
      pen.fillRect(x(p.x) - wide / 2, y(p.bar), wide, box.bottom - y(p.bar));
    }
    pen.fillStyle = p.off ? BAD : MODEL;
    dot(pen, x(p.x), y(p.y), 3.5);
  }
  pen.fillStyle = INK;
}

// Points in two quantities, in the order in which they came.
export function path(canvas, { points, unit, across }) {
  const { pen, width, height } = prepared(canvas);
  const box = { left: 46, right: width - 6, top: 18, bottom: height - 20 };
  const [l0, h0] = range(points.map((p) => p.x), 1e-3), [l1, h1] = range(points.map((p) => p.y), 1e-3);
  const x = (v) => box.left + ((v - l0) / (h0 - l0 || 1)) * (box.right - box.left);
  const y = (v) => box.bottom - ((v - l1) / (h1 - l1 || 1)) * (box.bottom - box.top);
  frame(pen, box, ticks(l0, h0, 8), ticks(l1, h1, 4), x, y);
  pen.textAlign = "left";
  pen.textBaseline = "top";
  pen.fillText(unit, 2, 1);
  pen.textAlign = "right";
  pen.fillText(across, box.right, 1);
  pen.fillStyle = MODEL;
  for (const p of points) dot(pen, x(p.x), y(p.y), 3);
}
