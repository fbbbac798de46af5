// What comes from the server is kept in `live` and drawn at most once a frame. Text is put in as text, never as markup.
import { COLOURS, chart, dots, path, plane } from "./draw.js";

const live = { about: null, points: [], rows: [], gaps: [], log: [], streams: {}, newest: {}, drawn: 0 };
globalThis.live = live;
const KEPT = 60, POINTS = 600, LINES = 200, SHOWN_ROWS = 12, LISTED = 2000;
const LATE = 2, LATE_SAMPLES = 5; // s of the host, and samples, without which a stream is silent
const $ = (id) => document.getElementById(id);
let due = false, lost = false;

const source = new EventSource("events");
source.addEventListener("whole", (event) => { take(JSON.parse(event.data), true); });
source.addEventListener("new", (event) => { take(JSON.parse(event.data), false); });
source.onerror = () => {
  lost = true;
  if (live.outcome && !live.more) source.close(); // the run is over, and whoever served it too
  plan();
};

function take(data, whole) {
  lost = false;
  const { points, rows, log, ...rest } = data;
  if (whole) Object.assign(live, { points: [], rows: [], gaps: [], log: [], now: null });
  Object.assign(live, rest, { received: performance.now() });
  if (points) live.points.push(...points);
  const oldest = live.t - KEPT * (live.about?.speed ?? 1);
  while (live.points.length > POINTS || (live.points.length > 2 && live.points[1].t < oldest)) live.points.shift();
  if (rows) live.rows.push(...rows);
  if (live.rows.length > LISTED) live.rows.splice(0, live.rows.length - LISTED);
  if (log) live.log.push(...log);
  if (live.log.length > LINES) live.log.splice(0, live.log.length - LINES);
  plan();
}

function plan() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => { due = false; draw(); });
}
addEventListener("resize", plan);

// -- words
const speed = () => live.about?.speed || 1;
const clock = () => (live.clock ?? 0) + (live.outcome || live.trouble ? 0 : ((performance.now() - live.received) / 1000) * Math.min(speed(), 1e3));
const age = (t) => (t === null || t === undefined ? null : Math.max(0, (clock() - t) / speed()));
const late = (s) => age(s.t) > Math.max(LATE, s.rate > 0 ? LATE_SAMPLES / (s.rate * speed()) : 0);
const number = (value, digits) => (value === null || value === undefined ? "–" : (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits));
function seconds(s) {
  if (s === null || s === undefined) return "–";
  if (s < 10) return `${s.toFixed(1)} s`;
  if (s < 90) return `${Math.round(s)} s`;
  const minutes = Math.round(s / 60);
  return minutes < 90 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, "0")} min`;
}
function filled(id, text) { const e = $(id); if (e.textContent !== text) e.textContent = text; }
function element(kind, text, name) {
  const e = document.createElement(kind);
  if (text !== undefined) e.textContent = text;
  if (name) e.className = name;
  return e;
}
const cells = (texts, kind = "td") => { const row = element("tr"); row.append(...texts.map((t) => element(kind, t))); return row; };
const length3 = (v) => Math.hypot(...v);

// -- the page
function draw() {
  if (!live.about) { lead(); return; }
  const a = live.about;
  document.title = `${a.protocol || a.file} - lab watch`;
  filled("title", a.protocol ? `${a.protocol} on ${a.robot || "a robot"}` : a.file);
  filled("part", live.part ?? "");
  filled("subtitle", [a.file, a.rig, ...a.labels, a.speed !== 1 ? `${a.speed} rig seconds in a second` : "", ...a.missing].filter(Boolean).join("; "));
  lead();
  steer();
  progress();
  numbers();
  tips();
  charts();
  gaps();
  lists();
  live.drawn += 1;
  live.drawnAt = Date.now();
  live.drawnNewest = live.sent - ((live.clock - live.t) / speed()) * 1000; // wall time of the newest sample shown, ms
}

function lead() {
  const [text, kind] = standing();
  filled("lead", text);
  $("lead").className = `lead ${kind}`;
}

function standing() {
  if (lost && live.more && (live.outcome || live.trouble)) return ["The connection to lab watch is lost; trying again ...", "bad"];
  if (live.trouble) return [`The recording cannot be read any further: ${live.trouble}`, "bad"];
  if (live.outcome) {
    const { outcome, detail } = live.outcome;
    const unsafe = !live.unsafe ? "" : live.steered ? "The safe state is not confirmed: use the vent valve and the emergency stop. " : "The safe state was not confirmed. ";
    const ended = unsafe + [outcome === "abrupt" ? "Ended abruptly" : outcome[0].toUpperCase() + outcome.slice(1), detail].filter(Boolean).join(": ");
    return [ended + (live.more ? "; the next run is shown when it begins" : ""), outcome === "completed" && !live.unsafe ? "good" : "bad"];
  }
  if (lost) return ["The connection to lab watch is lost; trying again ...", "bad"];
  if (!live.about) return ["Waiting for the recording ...", ""];
  const quiet = age(live.t), s = live.state, paused = live.pause?.begun;
  if (quiet > 2) return [`No data for ${seconds(quiet)}`, "bad"];
  const hidden = live.newest.tip && !live.newest.tip.valid;
  const silent = Object.keys(live.streams).filter((name) => late(live.streams[name])).sort();
  if (silent.length) return [`No data on ${silent.map((name) => `${name} for ${seconds(age(live.streams[name].t))}`).join(", ")}`, "bad"];
  if (paused) return [`Paused for ${seconds(age(live.pause.t))} (asked for at the ${live.pause.by}): vented and stopped; the run goes on when somebody asks for it` +
    (hidden ? "; the tip is hidden" : ""), "warm"];
  const now = (s ? asked(s) : "Preparing: no state was asked for yet") + (live.pause ? "; then a pause" : "");
  if (hidden) return [`The tip is hidden from the cameras, ${since(live.newest.tip.seen)}. ${now}`, "warm"];
  return [now, s?.clipped ? "warm" : ""];
}
function asked(s) {
  const most = Math.max(0, ...s.targets), done = live.progress?.steps ?? 0, next = live.about.steps[done];
  const what = s.specimen ? `${s.specimen} pushed` : `${number(most / 1e3, 0)} kPa ${s.branch}`;
  return `Trial ${s.trial}, state ${s.step}: ${what}, spine ${number(s.spine * 1e2, 1)} cm, repeat ${s.repeat}; ` +
    (!s.read ? `waits for the reading (${s.rule})` : next ? `read; now step ${done + 1}: ${next[0]}` : "read") + (s.clipped ? "; set-points were clipped" : "");
}
const since = (t) => (t === null || t === undefined ? "never seen" : `last seen ${seconds(age(t))} ago`);

// -- what is asked of the run
function steer() {
  $("steer").hidden = !live.steered || Boolean(live.outcome) || Boolean(live.trouble);
  filled("pause", live.pause ? "Go on" : "Pause");
  $("pause").className = live.pause ? "on" : "";
}

async function ask(kind, text = "") {
  let said = "";
  try {
    const answer = await fetch("ask", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ kind, text }) });
    if (!answer.ok) said = answer.status === 429 ? "too many at once; try again in a moment" : `not taken: ${answer.statusText || answer.status}`;
  } catch {
    said = "the page of the run does not answer";
  }
  filled("steer-line", said);
  return !said;
}
for (const kind of ["repeat", "skip", "finish"]) $(kind).addEventListener("click", () => ask(kind));
$("pause").addEventListener("click", () => ask(live.pause ? "go on" : "pause"));
$("note-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const field = $("note"), text = field.value;
  if (text.trim() && (await ask("note", text)) && field.value === text) field.value = "";
});

function progress() {
  const p = live.progress;
  $("bar").hidden = !p;
  if (!p) { filled("plan-line", live.about.steps.length ? `${live.about.steps.length} steps planned` : ""); return; }
  const share = p.seconds_planned > 0 ? Math.min(1, p.seconds / p.seconds_planned) : 1;
  $("done").style.width = `${(100 * share).toFixed(2)}%`;
  const passed = age(p.t) - (live.pause?.begun ? age(live.pause.t) : 0);
  const left = live.outcome ? "" : `, about ${seconds(Math.max(0, p.left - passed))} left${live.part ? " of this run" : ""}`;
  filled("plan-line", `${p.steps} of ${p.planned} steps done (${(100 * share).toFixed(0)} %)${left}`);
}

function numbers() {
  const n = live.newest, limits = live.about.limits, out = [];
  const add = (name, text, bad, topic) => {
    const silent = live.streams[topic] && late(live.streams[topic]);
    out.push([name, silent ? `${text}, ${seconds(age(live.streams[topic].t))} ${live.outcome ? "before the end" : "old"}` : text, bad || silent]);
  };
  if (n.tip) {
    add("tip x, y, z, mm", n.tip.valid ? n.tip.position.map((v) => number(v === null ? null : v * 1e3, 1)).join("  ") : "hidden", !n.tip.valid, "/tip");
    add("tip", !n.tip.valid ? since(n.tip.seen) : live.outcome || late(live.streams["/tip"]) ? "seen" : `seen, ${seconds(age(n.tip.t))} old`, !n.tip.valid || age(n.tip.t) > (limits.hidden ?? 2), "/tip");
  }
  if (n.pressure) {
    const most = Math.max(...n.pressure.measured.map((v) => v ?? NaN));
    add("highest pressure", `${number(most / 1e3, 1)} kPa`, limits.pressure && most > limits.pressure, "/pressure");
  }
  if (n.force) add("force", `${number(n.force.force, 2)} N`, limits.force && n.force.peak > limits.force, "/force");
  if (n.force) add("moment", `${number(n.force.moment, 3)} N m`, limits.moment && n.force.moment > limits.moment, "/force");
  if (n.spine) add("spine length", `${number(n.spine.length * 1e3, 1)} mm`, false, "/spine");
  if (n.vacuum) add("pressure in the spine", `${number(n.vacuum.absolute / 1e3, 1)} kPa abs`, false, "/vacuum");
  if (n.valve) add("vacuum valve", n.valve.on ? "on, jammed" : "off", false, "/valve");
  add("newest data", live.outcome ? "ended" : `${seconds(age(live.t))} old`, !live.outcome && age(live.t) > 1);
  const list = $("numbers");
  while (list.children.length > out.length) list.lastChild.remove();
  out.forEach(([name, text, bad], k) => {
    let box = list.children[k];
    if (!box) { box = element("div"); box.append(element("dt"), element("dd")); list.append(box); }
    if (box.firstChild.textContent !== name) box.firstChild.textContent = name;
    if (box.lastChild.textContent !== text) box.lastChild.textContent = text;
    box.className = bad ? "bad" : "";
  });
}

const mm = (p) => p.map((v) => v * 1e3);
const whole3 = (p) => p && p.every((v) => v !== null);
function tips() {
  const seen = live.points.filter((p) => p.tip && p.tip.valid && whole3(p.tip.position));
  const trail = seen.map((p) => mm(p.tip.position));
  const states = live.rows.filter((r) => whole3(r.tip)).slice(-200).map((r) => mm(r.tip));
  const none = !live.newest.tip && !states.length;
  $("planes").hidden = $("tip-legend").hidden = none;
  if (none) { filled("tip-line", "no motion capture in this recording"); return; }
  // The model's answer comes a little later than the tip that it is about, which it brings along.
  const now = live.now, fine = now && whole3(now.tip) && !(age(now.t) > LATE) ? now : null;
  const compared = fine && whole3(fine.measured) ? mm(fine.measured) : null;
  const tip = live.newest.tip, hidden = tip ? !tip.valid : false;
  const place = tip && tip.valid && whole3(tip.position) ? mm(tip.position) : trail.at(-1);
  const shown = { trail, states, tip: place, hidden, expected: fine ? mm(fine.tip) : null, compared,
    box: fine && whole3(fine.low) && whole3(fine.high) ? { low: mm(fine.low), high: mm(fine.high) } : null };
  $("key-model").hidden = !fine;
  $("key-interval").hidden = !shown.box;
  plane($("plane-xy"), { ...shown, axes: [0, 1], down: false });
  plane($("plane-xz"), { ...shown, axes: [0, 2], down: true });
  plane($("plane-yz"), { ...shown, axes: [1, 2], down: true });
  const words = [tip ? (hidden ? `hidden, ${since(tip.seen)}` : "seen") : "not seen now"];
  if (compared) {
    const off = compared.map((v, k) => v - shown.expected[k]);
    words.push(`${number(length3(off), 1)} mm from the model (${off.map((v) => number(v, 1)).join(", ")} mm)`);
  }
  words.push(live.now?.error ? `no prediction: ${live.now.error}` : live.model.stands === "starting" ?
    "the model is starting; its kernels may have to be compiled first" : live.model.why ? `model: ${live.model.why}` : "");
  filled("tip-line", words.filter(Boolean).join("; "));
}

function charts() {
  const to = live.t, from = Math.max(live.points[0]?.t ?? 0, to - KEPT * speed());
  const of = (name) => live.points.filter((p) => p[name]).map((p) => p[name]);
  const span = { from, to: Math.max(to, from + 1) }, limits = live.about.limits;
  const pressure = of("pressure");
  const chambers = pressure.at(-1)?.measured.length ?? 0;
  let groups = live.about.channels.filter((g) => g.every((c) => c <= chambers));
  if (!groups.length) groups = Array.from({ length: chambers }, (_, k) => [k + 1]);
  const scaled = (v, by) => (v === null || v === undefined ? null : v / by);
  const series = groups.flatMap((g, k) => {
    const t = pressure.map((p) => p.t), colour = COLOURS[k % COLOURS.length];
    return [{ t, v: pressure.map((p) => scaled(p.setpoint[g[0] - 1], 1e3)), colour, dash: [5, 4], width: 1.2 },
      { t, v: pressure.map((p) => scaled(p.measured[g[0] - 1], 1e3)), colour }];
  });
  chart($("chart-pressure"), { series, ...span, unit: "kPa", limits: limits.pressure ? [limits.pressure / 1e3] : [], least: 10, zero: true });
  legend("legend-pressure", [...groups.map((g, k) => [`chamber${g.length > 1 ? "s" : ""} ${g.join(", ")}`, COLOURS[k % COLOURS.length]]),
    ["set-points dashed", null], [limits.pressure ? `limit ${number(limits.pressure / 1e3, 0)} kPa` : "", null]]);
  const one = (id, name, value, options, words) => {
    const found = of(name), figure = $(`chart-${id}`).parentElement;
    figure.hidden = !found.length;
    if (figure.hidden) return;
    chart($(`chart-${id}`), { series: value.map(([v, colour, dash]) => ({ t: found.map((p) => p.t), v: found.map(v), colour, dash })), ...span, ...options });
    legend(`legend-${id}`, words);
  };
  one("force", "force", [[(p) => p.peak, COLOURS[0]]], { unit: "N", limits: limits.force ? [limits.force] : [], least: 0.5, zero: true },
    [["largest of each tenth of a second", null], [limits.force ? `limit ${number(limits.force, 0)} N` : "", null]]);
  one("spine", "spine", [[(p) => scaled(p.goal, 1e-3), COLOURS[0], [5, 4]], [(p) => scaled(p.length, 1e-3), COLOURS[0]]],
    { unit: "mm", limits: limits.spine ? [limits.spine * 1e3] : [], least: 10, zero: true },
    [["goal dashed", null], [limits.spine ? `limit ${number(limits.spine * 1e3, 0)} mm` : "", null]]);
  one("vacuum", "vacuum", [[(p) => scaled(p.absolute, 1e3), COLOURS[0]]], { unit: "kPa abs", least: 5, zero: true },
    [["absolute pressure in the spine", null]]);
}

function legend(id, words) {
  const box = $(id), key = JSON.stringify(words);
  if (box.dataset.key === key) return;
  box.dataset.key = key;
  box.replaceChildren(...words.filter(([text]) => text).flatMap(([text, colour], k) => {
    const word = element("span", (k ? "; " : "") + text);
    if (colour) word.style.color = colour;
    return [word];
  }));
}

function gaps() {
  const first = live.of - live.rows.length, start = (live.compared ?? 0) - live.gaps.length;
  const gap = (k) => live.gaps[k + first - start] ?? null; // of row k of those that are listed
  const pushed = live.rows.some((r) => r.deflection !== null);
  if (pushed) {
    const points = live.rows.filter((r) => r.deflection !== null && r.force !== null).map((r) => ({ x: r.deflection * 1e3, y: r.force }));
    path($("chart-gap"), { points, unit: "force, N", across: "deflection, mm" });
  } else {
    const points = live.rows.flatMap((r, k) => {
      const g = gap(k);
      if (!g || !whole3(g.gap)) return [];
      const known = whole3(g.low) && whole3(g.high);
      const off = known && r.tip.some((v, i) => v < g.low[i] || v > g.high[i]);
      return [{ x: k + first + 1, y: length3(g.gap) * 1e3, bar: known ? length3(g.high.map((v, i) => (v - g.low[i]) / 2)) * 1e3 : null, off }];
    });
    dots($("chart-gap"), { points, unit: "gap, mm", across: "state" });
  }
  const compared = live.gaps.filter((g) => g && whole3(g.gap));
  const rms = Math.sqrt(compared.reduce((sum, g) => sum + length3(g.gap) ** 2, 0) / (compared.length || 1)) * 1e3;
  filled("gap-line", [`${live.of ?? 0} state${live.of === 1 ? "" : "s"} read`, compared.length ? `gap between measured tip and model ${number(rms, 2)} mm rms over ${compared.length} state${compared.length === 1 ? "" : "s"}` : "",
    compared.some((g) => whole3(g.low)) ? "band: 95 % interval, red: beyond it" : "",
    live.rows.length && !pushed && !compared.length && live.model.stands === "starting" ? "gaps follow when the model is ready" : ""].filter(Boolean).join("; "));
  const key = `${live.of}/${live.compared}/${live.gaps.length}`;
  if ($("rows").dataset.key === key) return;
  $("rows").dataset.key = key;
  $("rows-head").replaceChildren(cells(pushed ? ["state", "trial", "step", "specimen", "deflection, mm", "force, N"] :
    ["state", "trial", "step", "branch", "pressure, kPa", "spine, mm", "x, mm", "y, mm", "z, mm", "gap, mm", "gap x, y, z, mm"], "th"));
  $("rows").replaceChildren(...live.rows.map((r, k) => [r, k]).slice(-SHOWN_ROWS).reverse().map(([r, k]) => {
    const name = String(k + first + 1);
    if (pushed) return cells([name, `${r.trial}`, `${r.step}`, r.specimen ?? "", number(r.deflection === null ? null : r.deflection * 1e3, 3), number(r.force, 3)]);
    const tip = whole3(r.tip) ? mm(r.tip).map((v) => number(v, 2)) : ["–", "–", "–"], g = gap(k);
    const off = g && whole3(g.gap) ? [number(length3(g.gap) * 1e3, 2), mm(g.gap).map((v) => number(v, 2)).join(", ")] : ["–", "–"];
    return cells([name, `${r.trial}`, `${r.step}`, r.branch + (r.clipped ? ", clipped" : "") + (r.again ? ", read again" : ""), number(Math.max(...r.pressures) / 1e3, 1), number(r.spine * 1e3, 1), ...tip, ...off]);
  }));
}

function lists() {
  const log = $("log"), end = live.log.at(-1), key = `${live.log.length} ${end?.t} ${end?.text}`;
  if (log.dataset.key !== key) {
    log.dataset.key = key;
    log.replaceChildren(...live.log.slice().reverse().map((line) => {
      const item = element("li", undefined, line.level), time = element("time", `${number(line.t, 1)} s`);
      item.append(time, ["info", "asked"].includes(line.level) ? line.text : `${line.level}: ${line.text}`);
      return item;
    }));
  }
  const before = $("before"), ended = live.before ?? [];
  if (before.children.length !== ended.length) {
    before.parentElement.hidden = !ended.length;
    before.replaceChildren(...ended.map(({ part, outcome, trouble }) => element("li",
      `${part}: ${outcome ? [outcome.outcome, outcome.detail].filter(Boolean).join(": ") : trouble}`, outcome?.outcome === "completed" ? "" : "error")).reverse());
  }
  const done = live.progress?.steps ?? 0, steps = $("steps"), of = live.about.steps;
  const mark = `${of.length} ${done} ${Boolean(live.outcome)}`;
  if (steps.dataset.key !== mark) {
    steps.dataset.key = mark;
    const first = Math.max(0, done - 4);
    steps.replaceChildren(...of.slice(first, first + 60).map(([label, takes], k) => element("li", `${first + k < done ? "✓ " : ""}${first + k + 1}. ${label}, ${seconds(takes)}`,
      first + k < done ? "done" : first + k === done && !live.outcome ? "next" : "")));
    if (!of.length) steps.replaceChildren(element("li", "not in this recording", "done"));
  }
  const table = $("streams"), names = Object.keys(live.streams).sort();
  table.replaceChildren(...names.map((name) => {
    const s = live.streams[name], old = age(s.t);
    const row = cells([name, String(s.count), `${number(s.rate, 1)} Hz`, live.outcome ? "–" : seconds(old), String(s.dropped), s.lost === null ? "–" : String(s.lost)]);
    if (!live.outcome && late(s)) row.children[3].className = "bad";
    if (s.dropped) row.children[4].className = "bad";
    if (s.lost) row.children[5].className = "bad";
    return row;
  }));
}

setInterval(plan, 250); // ages go on while nothing comes
