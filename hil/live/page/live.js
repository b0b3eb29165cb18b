"use strict";
// The page: keeps ten minutes of rows, draws those that are in view, and passes requests to the server.

const HISTORY_S = 600, FIXED = 5;
const byId = (id) => document.getElementById(id);
const show = (value, digits = 4) => (Number.isFinite(value) ? value.toFixed(digits) : "–");

class Rows {
  // Rows of float64, in arrival order, with their time in column 0.
  constructor(width, capacity) { this.width = width; this.capacity = capacity; this.clear(); }
  clear() { this.data = new Float64Array(this.width * this.capacity * 2); this.begin = this.end = 0; }
  get length() { return this.end - this.begin; }
  add(values) {
    const count = values.length / this.width;
    if (this.end + count > 2 * this.capacity) {
      this.data.copyWithin(0, (this.end - Math.min(this.length, this.capacity)) * this.width, this.end * this.width);
      this.end = Math.min(this.length, this.capacity);
      this.begin = 0;
    }
    this.data.set(values.subarray(0, Math.min(count, 2 * this.capacity - this.end) * this.width), this.end * this.width);
    this.end = Math.min(this.end + count, 2 * this.capacity);
    this.begin = Math.max(this.begin, this.end - this.capacity);
  }
  at(row, column) { return this.data[row * this.width + column]; }
  find(t) {  // the first row with a time of at least t
    let low = this.begin, high = this.end;
    while (low < high) { const middle = (low + high) >> 1; if (this.at(middle, 0) < t) low = middle + 1; else high = middle; }
    return low;
  }
  get last() { return this.end ? this.at(this.end - 1, 0) : 0; }
  // Time and columns between two rows. Of more than `points` rows, every pair of points is the lowest and highest
  // value of its part of the time, so that no peak is lost.
  cut(from, to, columns, points) {
    const stride = Math.max(1, Math.floor((2 * (to - from)) / points));
    const t = [], out = columns.map(() => []);
    if (stride < 2) {
      for (let row = from; row < to; row += 1) { t.push(this.at(row, 0)); columns.forEach((c, i) => out[i].push(this.at(row, c))); }
      return [t, out];
    }
    const first = Math.floor(from / stride) * stride;  // parts stay where they are while time goes on
    for (let row = first; row < to; row += stride) {
      const a = Math.max(row, from), b = Math.min(row + stride, to);
      t.push(this.at(a, 0), this.at(b - 1, 0));
      columns.forEach((c, i) => {
        let low = Infinity, high = -Infinity, lowAt = a, highAt = a;
        for (let k = a; k < b; k += 1) { const v = this.at(k, c); if (v < low) { low = v; lowAt = k; } if (v > high) { high = v; highAt = k; } }
        if (low === Infinity) low = high = NaN;
        out[i].push(lowAt <= highAt ? low : high, lowAt <= highAt ? high : low);
      });
    }
    return [t, out];
  }
}

const live = window.hilLive = { rows: null, run: null, charts: [], delays_ms: [], received: 0, drawn: 0, last: null };
let socket = null, isPaused = false, isDirty = false, mayOperate = false, isOver = false, view = [0, 30], histograms = null;

function connect() {
  socket = new WebSocket(`ws://${location.host}/stream${location.search}`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = (event) => (typeof event.data === "string" ? JSON.parse(event.data).forEach(take) : takeRows(new Float64Array(event.data)));
  socket.onclose = () => {
    setState(isOver ? "run has ended" : "connection lost", "lost");
    if (!isOver) setTimeout(connect, 1000);
  };
}

function take(message) {
  if (message.run) begin(message);
  if (message.clear) { live.rows.clear(); byId("log").replaceChildren(); }
  if (message.log) message.log.forEach(addLogEntry);
  if (message.status) setStatus(message.status);
  if (message.bus) setCounts("bus", message.bus);
  if (message.readings) setReadings(message.readings);
  if (message.over) { isOver = true; setState("run has ended", "lost"); }
  if ("position_s" in message) setPosition(message.position_s);
  if (message.reply) showReply(message.reply);
}

function takeRows(values) {
  live.rows.add(values);
  live.received += values.length / live.rows.width;
  isDirty = true;
}

function begin(message) {
  const { run } = message;
  const isSame = live.run && JSON.stringify(live.run) === JSON.stringify(run);
  mayOperate = message.may_operate;
  byId("log").replaceChildren();
  if (isSame) { live.rows.clear(); return; }
  live.run = run;
  live.rows = new Rows(FIXED + 3 * run.axes.length, Math.ceil(HISTORY_S / run.period_s));
  const controllers = Object.entries(run.controllers).map(([axis, name]) => `${axis}: ${name}`).join(", ");
  byId("facts").textContent = [run.bus && `bus ${run.bus}`, run.rig && `rig ${run.rig}`, controllers, run.recording && `recording ${run.recording}`].filter(Boolean).join(" · ");
  buildSeries();
  buildCharts();
  if (message.mode === "recording") buildPlayer(message.duration_s);
  if (mayOperate) buildOperator();
}

// Charts

const KINDS = { position: "position", error: "error", valve: "valve voltage" };
function buildSeries() {
  const box = byId("series");
  box.querySelectorAll("label").forEach((label) => label.remove());
  const add = (group, value, text, on) => {
    const label = document.createElement("label"), input = document.createElement("input");
    Object.assign(input, { type: "checkbox", value, checked: on });
    input.dataset.group = group;
    input.addEventListener("change", buildCharts);
    label.append(input, text);
    box.append(label);
  };
  live.run.axes.forEach(([name]) => add("axis", name, name, true));
  Object.entries(KINDS).forEach(([key, text]) => add("kind", key, text, key !== "error"));
}

const chosen = (group) => [...document.querySelectorAll(`#series input[data-group=${group}]:checked`)].map((input) => input.value);

function buildCharts() {
  const place = byId("charts"), colours = COLOURS();
  place.replaceChildren();
  live.charts = [];
  const floors = { m: 0.01, rad: 0.03 };  // many times the resolution of the potentiometers
  const wanted = chosen("axis"), kinds = chosen("kind");
  for (const kind of kinds) {
    live.run.axes.forEach(([name, unit], i) => {
      if (!wanted.includes(name)) return;
      const r = FIXED + 3 * i, y = r + 1, v = r + 2;
      const [lines, columns, of, floor] = {
        position: [[{ name: "r", label: "setpoint", colour: colours.wanted, dashed: true }, { name: "y", label: "measured", colour: colours.measured }], [r, y], unit, floors[unit]],
        error: [[{ name: "e", label: "setpoint − measured", colour: colours.measured }], [r], unit, floors[unit]],
        valve: [[{ name: "v", label: "command", colour: colours.measured }], [v], "V", 0.2],
      }[kind];
      const chart = new Chart(place, `${name}, ${KINDS[kind]}`, of, lines, floor, moved);
      Object.assign(chart, { kind, columns, error: kind === "error" ? [r, y] : null, digits: kind === "valve" ? 3 : 4 });
      live.charts.push(chart);
    });
  }
  byId("lateness").replaceChildren();
  byId("response").replaceChildren();
  histograms = [new Histogram(byId("lateness"), "lateness of SYNC"), new Histogram(byId("response"), "from SYNC to the command")];
  isDirty = true;
}

function draw() {
  if (isDirty && live.rows && live.rows.length) {
    isDirty = false;
    const rows = live.rows, span = Number(byId("span").value);
    if (!isPaused) {
      const start = Math.max(rows.last - span, rows.at(rows.begin, 0));
      view = [start, start + span];
    }
    const from = Math.max(rows.find(view[0]) - 1, rows.begin), to = Math.min(rows.find(view[1]) + 1, rows.end);
    const points = Math.min(1600, 2 * (byId("charts").clientWidth || 800));
    for (const chart of live.charts) {
      let [t, columns] = rows.cut(from, to, chart.error || chart.columns, points);
      if (chart.error) columns = [columns[0].map((value, i) => value - columns[1][i])];
      chart.draw(t, columns);
      chart.move(...view);
      const last = columns.map((column) => show(column[column.length - 1], chart.digits));
      chart.label(last);
    }
    setState(live.run.states[rows.at(rows.end - 1, 3)]);
    live.drawn = live.received;
    live.last = Array.from(rows.data.subarray((rows.end - 1) * rows.width, rows.end * rows.width));
    const sampled_ms = (live.run.start_ns + live.run.epoch_offset_ns) / 1e6 + 1000 * rows.last;
    requestAnimationFrame(() => {  // after the charts of this frame have been painted
      live.delays_ms.push(Date.now() - sampled_ms);
      if (live.delays_ms.length > 2000) live.delays_ms.splice(0, 1000);
    });
  }
  requestAnimationFrame(draw);
}

setInterval(() => {
  const rows = live.rows;
  if (!rows || !rows.length || !histograms || document.hidden) return;
  const from = Math.max(rows.find(rows.last - Number(byId("span").value)), rows.begin);
  [1, 2].forEach((column, i) => {
    const values = [];
    for (let row = from; row < rows.end; row += 1) if (rows.at(row, 4) && Number.isFinite(rows.at(row, column))) values.push(rows.at(row, column));
    histograms[i].draw(values);
  });
}, 500);

// What is said about the run

function setState(text, kind = text) {
  if (isOver) { text = "run has ended"; kind = "lost"; }
  const box = byId("state");
  if (box.textContent === text) return;
  box.textContent = text;
  box.className = `state ${kind}`;
  document.title = `${text} · hil live`;
}

function setStatus({ counts = {}, fault, readiness }) {
  byId("fault").hidden = !fault;
  if (fault) byId("fault").textContent = `Fault. ${fault}`;
  const entries = Object.entries({ ...counts, ...(readiness ? { boards: readiness } : {}) });
  setCounts("counts", Object.fromEntries(entries));
}

function setCounts(place, counts) {
  byId(place).replaceChildren(...Object.entries(counts).flatMap(([name, value]) => {
    const dt = document.createElement("dt"), dd = document.createElement("dd");
    dt.textContent = name;
    dd.textContent = value;
    return [dt, dd];
  }));
}

function setReadings(readings) {
  const place = byId("readings"), names = Object.keys(readings);
  if (!names.length) { place.innerHTML = `<p class="soft">No controller is acting.</p>`; return; }
  const table = document.createElement("table");
  const row = (kind, cells) => {
    const tr = document.createElement("tr");
    cells.forEach((text, i) => { const cell = document.createElement(kind === "th" || i === 0 ? "th" : "td"); cell.textContent = text; tr.append(cell); });
    return tr;
  };
  const head = document.createElement("thead"), body = document.createElement("tbody");
  head.append(row("th", ["axis", "from → to", "overshoot", "settling (2 %)", "error at the end"]));
  for (const name of names) {
    const s = readings[name];
    body.append(row("td", s.kind === "StepResponse"
      ? [name, `${show(s.step_from, 3)} → ${show(s.step_to, 3)} ${s.unit}`, `${show(s.overshoot_percent, 1)} %`, s.settling_s === null ? "not yet" : `${show(s.settling_s, 2)} s`, `${show(s.steady_state_error, 5)} ${s.unit}`]
      : [name, "no step from rest", `largest error ${show(s.max_error, 4)} ${s.unit}`, `RMS ${show(s.rms_error, 4)} ${s.unit}`, ""]));
  }
  table.append(head, body);
  place.replaceChildren(table);
}

const SEVERITIES = { 20: "info", 30: "warning", 40: "error", 50: "fatal" };
function addLogEntry([time_s, severity, source, text]) {
  const item = document.createElement("li"), time = document.createElement("time"), name = document.createElement("b");
  const kind = SEVERITIES[severity] || "info";
  item.className = kind;
  time.textContent = `${time_s.toFixed(2)} s`;
  name.textContent = kind === "info" ? source : `${kind}, ${source}`;
  item.append(time, name, `: ${text}`);
  const list = byId("log");
  list.prepend(item);
  while (list.children.length > 500) list.lastChild.remove();
}

// Player of a recording

function buildPlayer(duration_s) {
  byId("player").hidden = false;
  const slider = byId("position");
  slider.max = duration_s;
  slider.addEventListener("input", () => send({ seek_s: Number(slider.value) }));
  byId("speed").addEventListener("change", (event) => send({ speed: Number(event.target.value) }));
  byId("play").addEventListener("click", (event) => {
    const isPlaying = event.target.getAttribute("aria-pressed") === "true";
    event.target.setAttribute("aria-pressed", String(!isPlaying));
    event.target.textContent = isPlaying ? "Play recording" : "Pause recording";
    send({ paused: isPlaying });
  });
}
function setPosition(position_s) {
  const slider = byId("position");
  if (document.activeElement !== slider || !slider.matches(":active")) slider.value = position_s;
  byId("position-text").textContent = `${position_s.toFixed(1)} of ${Number(slider.max).toFixed(1)} s`;
}

// Operator

function buildOperator() {
  const bar = byId("operator");
  bar.hidden = byId("stop").hidden = false;
  const button = (text, request) => { const b = document.createElement("button"); b.textContent = text; b.addEventListener("click", () => send(request())); bar.append(b); return b; };
  const field = (label, attributes) => { const l = document.createElement("label"), i = document.createElement("input"); Object.assign(i, attributes); l.append(label, i); bar.append(l); return i; };
  for (const name of ["arm", "start", "disarm", "reset"]) button(name[0].toUpperCase() + name.slice(1), () => ({ request: name }));
  const axis = document.createElement("select");
  axis.setAttribute("aria-label", "axis");
  live.run.axes.forEach(([name]) => axis.append(new Option(name)));
  bar.append(axis);
  const setpoint = field("setpoint", { type: "text", size: 12 });
  button("Set", () => ({ request: "setpoint", axis: axis.value, setpoint: setpoint.value }));
  const volts = field("jog, V", { type: "number", step: 0.1, value: 0.5, style: "width: 6em" });
  const jog = button("Hold to jog", () => ({}));
  let timer = null;
  const again = () => send({ request: "jog", axis: axis.value, offset_v: Number(volts.value), duration_s: 0.2 });
  const release = () => { clearInterval(timer); timer = null; };
  const press = (event) => { event.preventDefault(); if (!timer) { again(); timer = setInterval(again, 100); } };
  const fresh = jog.cloneNode(true);  // without the listener for a click
  jog.replaceWith(fresh);
  fresh.addEventListener("pointerdown", press);
  fresh.addEventListener("keydown", (event) => { if (event.key === " " || event.key === "Enter") press(event); });
  for (const name of ["pointerup", "pointerleave", "pointercancel", "keyup", "blur"]) fresh.addEventListener(name, release);
  const file = field("controller", { type: "file", accept: ".json" });
  file.addEventListener("change", async () => {
    if (file.files.length) send({ request: "controller", axis: axis.value, name: file.files[0].name, document: await file.files[0].text() });
    file.value = "";
  });
  byId("stop").addEventListener("click", () => send({ request: "stop" }));
}
function showReply({ accepted, text }) {
  const box = byId("reply");
  box.hidden = false;
  box.textContent = text;
  box.className = accepted ? "reply" : "reply refused";
}
function send(message) { if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message)); }

byId("pause").addEventListener("click", (event) => {
  isPaused = !isPaused;
  event.target.setAttribute("aria-pressed", String(isPaused));
  event.target.textContent = isPaused ? "Follow" : "Pause";
  isDirty = true;
});
byId("span").addEventListener("change", () => { isDirty = true; });
DARK.addEventListener("change", () => live.run && buildCharts());
// Zooming and panning pause the view; all charts move together.
function moved(start, end) {
  if (!isPaused) byId("pause").click();
  view = [start, end];
  isDirty = true;
}
connect();
requestAnimationFrame(draw);
