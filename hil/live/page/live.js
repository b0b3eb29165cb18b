"use strict";
// The page: keeps ten minutes of rows, draws those that are in view, and passes requests to the server.

const HISTORY_S = 600, FIXED = 5;
const byId = (id) => document.getElementById(id);
const show = (value, digits = 4) => (Number.isFinite(value) ? value.toFixed(digits) : "–");

class Rows {
  // Rows of float64, in arrival order, with their time in column 0.
  // `gap_s`: a longer time between two rows is a gap.
  constructor(width, capacity, gap_s) { Object.assign(this, { width, capacity, gap_s }); this.clear(); }
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
  // True if periods are missing before a row: the line has a gap there.
  isAfterGap(row) { return row > this.begin && this.at(row, 0) - this.at(row - 1, 0) > this.gap_s; }
  // Times and values between two rows, for one line of a chart. `value(row)` returns the value of a row. Of more
  // than `points` rows, every pair of points is the lowest and highest value of its part of the time, so that no
  // peak is lost. A point between two of the same value is left out, because the line is the same without it.
  cut(from, to, value, points) {
    const stride = Math.max(1, Math.ceil((2 * (to - from)) / points)), t = [], v = [];
    const add = (row, x) => {
      const n = v.length;
      if (n > 1 && v[n - 1] === x && v[n - 2] === x) t[n - 1] = this.at(row, 0);
      else { t.push(this.at(row, 0)); v.push(x); }
    };
    const addPart = (begin, end) => {
      let low = Infinity, high = -Infinity, lowAt = -1, highAt = -1;
      for (let k = begin; k < end; k += 1) {
        const x = value(k);
        if (x < low) { low = x; lowAt = k; }
        if (x > high) { high = x; highAt = k; }
      }
      if (lowAt < 0) add(begin, NaN);
      else if (lowAt === highAt) add(lowAt, low);
      else if (lowAt < highAt) { add(lowAt, low); add(highAt, high); }
      else { add(highAt, high); add(lowAt, low); }
    };
    const part = stride < 3 ? 1 : stride;
    for (let begin = from; begin < to;) {
      let end = Math.min((Math.floor(begin / part) + 1) * part, to);  // parts stay where they are while time goes on
      if (begin > from && this.isAfterGap(begin)) add(begin - 1, NaN);
      for (let k = begin + 1; k < end; k += 1) if (this.isAfterGap(k)) end = k;
      addPart(begin, end);
      begin = end;
    }
    if (part > 1 && to > from) add(to - 1, value(to - 1));
    return { t, v };
  }
}

const live = window.hilLive = { rows: null, run: null, charts: [], delays_ms: [], received: 0, drawn: 0, last: null };
const FRESH = 4;  // column that is 0 in a period without a good sample
const MAX_DRAWN_ROWS = 1000;  // more rows at once are drawn in the next frame
const OLD_SAMPLE_S = 0.5;  // age of the last good sample from which on it is said
const DRAW_MS = 28, LABEL_MS = 200, MAX_DRAW_MS = 500;  // a picture for each update, and 5 values a second
const GAP_PERIODS = 10;
let isPaused = false, isDirty = false, mayOperate = false, isOver = false, isRecording = false;
let fault = "", readiness = "", fresh_s = null;  // of the run; fresh_s: time of the last good sample
let view = [0, 30], cursor_s = null, histograms = null, next_draw_ms = 0, labelled_ms = 0;

function take(message) {
  if (message.run) begin(message);
  if (message.clear) { live.rows.clear(); fresh_s = null; next_row_s = -Infinity; byId("log").replaceChildren(); }
  if (message.log) message.log.forEach(addLogEntry);
  if (message.status) setStatus(message.status);
  if (message.bus) setCounts("bus", message.bus);
  if (message.readings) setReadings(message.readings);
  if (message.over) { isOver = connection.isOver = true; connection.isAwaited = message.is_awaited; showConnection(); }
  if ("position_s" in message) { setPosition(message.position_s); connection.tookData(); }
  if ("beat_s" in message) connection.tookBeat(message);
  if ("feed_error" in message) connection.feedError = message.feed_error;
  if (message.reply) { connection.answered(message.id); showReply(message.reply); if (jog) jog.answered(message.id); }
}

function takeRows(values) {
  const { width } = live.rows;
  for (let row = values.length - width; row >= 0; row -= width) if (values[row + FRESH]) { fresh_s = values[row]; break; }
  live.rows.add(values);
  live.received += values.length / width;
  isDirty = true;
  // Now, and not in the next frame: that is when BokehJS paints. Of a large part of the past, more is on its way.
  if (!document.hidden && values.length < MAX_DRAWN_ROWS * width) draw(performance.now());
}

// Begin anew: with the connection's first message, and when another run has begun.
function begin(message) {
  const { run } = message, before = live.run;
  const isSame = before && JSON.stringify(before) === JSON.stringify(run);
  mayOperate = message.may_operate;
  isOver = connection.isOver = false;
  isRecording = message.mode === "recording";
  byId("log").replaceChildren();
  if (isSame) {
    live.rows.clear();
    if (isRecording) resume();
  } else {
    live.run = run;
    fresh_s = null;
    connection.forgetData();
    live.rows = new Rows(FIXED + 3 * run.axes.length, Math.ceil(HISTORY_S / run.period_s), GAP_PERIODS * run.period_s);
    next_row_s = -Infinity;
    pause(false);
    if (!before || JSON.stringify(before.axes) !== JSON.stringify(run.axes)) buildSeries();
    buildCharts();
    buildOperator();
    if (isRecording) buildPlayer(message);
  }
  showConnection();
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

// A chart outside the window is not drawn; it is drawn as soon as it comes into the window.
const visibility = new IntersectionObserver((entries) => entries.forEach(({ target, isIntersecting }) => {
  target.chart.isVisible = isIntersecting;
  if (isIntersecting && target.chart.isStale) { target.chart.isStale = false; isDirty = true; }
}), { rootMargin: "50px" });
function watchVisibility(chart) {
  chart.isVisible = false;
  chart.isStale = true;
  chart.box.chart = chart;
  visibility.observe(chart.box);
}

// Charts with another one below them have no labels of the time axis. One below the other, each fills a small screen.
function labelTimes() {
  const columns = getComputedStyle(byId("charts")).gridTemplateColumns.split(" ").length, { charts } = live;
  charts.forEach((chart, i) => chart.labelTime(columns === 1 || i + columns >= charts.length));
}
new ResizeObserver(labelTimes).observe(byId("charts"));

const chosen = (group) => [...document.querySelectorAll(`#series input[data-group=${group}]:checked`)].map((input) => input.value);

function buildCharts() {
  const place = byId("charts"), colours = COLOURS();
  visibility.disconnect();
  live.charts.forEach((chart) => chart.remove());
  place.replaceChildren();
  live.charts = [];
  const floors = { m: 0.01, rad: 0.03 };  // many times the resolution of the potentiometers
  const wanted = chosen("axis"), kinds = chosen("kind");
  for (const kind of kinds) {
    live.run.axes.forEach(([name, unit], i) => {
      if (!wanted.includes(name)) return;
      const r = FIXED + 3 * i, y = r + 1, v = r + 2;
      // Without a good sample, a row repeats the position of the last one.
      const column = (c) => (row) => (c === y && !live.rows.at(row, FRESH) ? NaN : live.rows.at(row, c));
      const measured = column(y);
      const [lines, columns, of, floor] = {
        position: [[{ label: "setpoint", colour: colours.wanted, dashed: true }, { label: "measured", colour: colours.measured }], [r, y], unit, floors[unit]],
        error: [[{ label: "setpoint − measured", colour: colours.measured }], [r, y], unit, floors[unit]],
        valve: [[{ label: "command", colour: colours.measured }], [v], "V", 0.2],
      }[kind];
      const chart = new Chart(place, `${name}, ${KINDS[kind]}`, of, lines, floor, { moved, pointed: setCursor, painted });
      watchVisibility(chart);
      const values = kind === "error" ? [(row) => live.rows.at(row, r) - measured(row)] : columns.map(column);
      Object.assign(chart, { kind, columns, values, digits: kind === "valve" ? 3 : 4 });
      live.charts.push(chart);
    });
  }
  labelTimes();
  if (histograms) histograms.forEach((histogram) => histogram.remove());
  byId("lateness").replaceChildren();
  byId("response").replaceChildren();
  histograms = [new Histogram(byId("lateness"), "lateness of SYNC"), new Histogram(byId("response"), "from SYNC to the command")];
  isDirty = true;
}

function drawFrame(now_ms) {
  requestAnimationFrame(drawFrame);
  draw(now_ms);
}
function draw(now_ms) {
  if (isDirty && live.rows && live.rows.length && now_ms > next_draw_ms) {
    isDirty = false;
    limitDrawing(now_ms);
    const rows = live.rows, span = Number(byId("span").value);
    if (!isPaused) {
      // Without new data the time goes on, and the lines end where the data do. Half of a chart still shows them.
      const waited_s = connection.isStale && !isRecording ? Math.min(connection.age_ms / 1000, span / 2) : 0;
      const start = Math.max(rows.last + waited_s - span, rows.at(rows.begin, 0));
      view = [start, start + span];
    }
    const from = Math.max(rows.find(view[0]) - 1, rows.begin), to = Math.min(rows.find(view[1]) + 1, rows.end);
    const hasLabels = now_ms - labelled_ms > LABEL_MS;
    if (hasLabels) labelled_ms = now_ms;
    for (const chart of live.charts) {
      if (!chart.isVisible) { chart.isStale = true; continue; }
      const points = chart.box.clientWidth - FRAME_LEFT;  // one for each pixel of the time axis
      chart.draw(chart.values.map((value) => rows.cut(from, to, value, points)));
      chart.move(...view);
      if (hasLabels) label(chart);
    }
    showConnection();
    live.drawn = live.received;
    live.last = Array.from(rows.data.subarray((rows.end - 1) * rows.width, rows.end * rows.width));
    noteDelays(rows);
  }
}

// Note the time from sampled to drawn, in ms, of each row that is drawn for the first time.
let next_row_s = -Infinity, unpainted = { sampled_ms: [], charts: new Set() };
function noteDelays(rows) {
  const zero_ms = (live.run.start_ns + live.run.epoch_offset_ns) / 1e6, first = rows.find(next_row_s), end = rows.end;
  next_row_s = rows.last + 1e-6;
  unpainted.charts = new Set(live.charts.filter((chart) => chart.isVisible));
  if (!unpainted.charts.size || unpainted.sampled_ms.length > 1000) unpainted.sampled_ms = [];  // nothing is painted
  else for (let row = Math.max(first, end - 100); row < end; row += 1) unpainted.sampled_ms.push(zero_ms + 1000 * rows.at(row, 0));
}
function painted(chart) {
  if (!unpainted.charts.delete(chart) || unpainted.charts.size) return;
  const { sampled_ms } = unpainted;
  unpainted.sampled_ms = [];
  setTimeout(() => {  // after the frame in which the last chart has been painted
    const now_ms = Date.now();
    for (const at_ms of sampled_ms) live.delays_ms.push(now_ms - at_ms);
    if (live.delays_ms.length > 5000) live.delays_ms.splice(0, 2500);
  });
}

// Draw at most half of the time, so that buttons answer at once also on a machine that draws slowly.
function limitDrawing(start_ms) {
  next_draw_ms = Infinity;
  requestAnimationFrame(() => setTimeout(() => {  // after this picture, its painting and one frame
    const busy_ms = performance.now() - start_ms;
    next_draw_ms = start_ms + Math.min(Math.max(2 * busy_ms - 40, DRAW_MS), MAX_DRAW_MS);
  }));
}

// Values of a chart: those at the cursor, or the last ones.
function label(chart) {
  const { rows } = live;
  const row = cursor_s === null ? rows.end - 1 : Math.min(Math.max(rows.find(cursor_s), rows.begin), rows.end - 1);
  const isOld = cursor_s === null && connection.isStale;
  chart.label(chart.values.map((value) => (isOld ? "–" : show(value(row), chart.digits))));
  chart.mark(cursor_s === null ? null : rows.at(row, 0));
}
function setCursor(t) {
  cursor_s = t;
  byId("cursor").textContent = t === null ? "" : `cursor ${t.toFixed(3)} s`;
  if (live.rows && live.rows.length) live.charts.filter((chart) => chart.isVisible).forEach(label);
}

setInterval(() => {
  const rows = live.rows;
  if (!rows || !rows.length || !histograms || document.hidden) return;
  const from = Math.max(rows.find(rows.last - Number(byId("span").value)), rows.begin);
  [1, 2].forEach((column, i) => {
    const values = [];
    for (let row = from; row < rows.end; row += 1) if (rows.at(row, FRESH) && Number.isFinite(rows.at(row, column))) values.push(rows.at(row, column));
    histograms[i].draw(values);
  });
}, 500);

// What is said about the run

function setState(text, kind = text) {
  const box = byId("state");
  if (box.textContent === text) return;
  box.textContent = text;
  box.className = `state ${kind}`;
  showAllowed(text);
  document.title = `${text} · hil live`;
}

// Show the state of the loop, or that nothing is known of it now.
function showConnection() {
  const { rows } = live, { isOpen, isStale, trouble } = connection;
  if (isOver) setState(connection.isAwaited ? "waiting for a daemon" : "run has ended", "lost");
  else if (!isOpen) setState(live.run ? "connection lost" : "no connection", "lost");
  else if (isStale) setState(connection.isBehind ? "loading" : "no data", "lost");
  else if (rows && rows.length) setState(live.run.states[rows.at(rows.end - 1, 3)]);
  showReason();
  document.body.classList.toggle("stale", isStale || isOver);
  byId("connection").hidden = !trouble;
  if (byId("trouble").textContent !== trouble) byId("trouble").textContent = trouble;
  byId("age").textContent = connection.age;
  const stop = isOpen ? "Stop" : "Stop: no connection";
  if (byId("stop").textContent !== stop) byId("stop").textContent = stop;
}

// Say why the axes are not under control: the fault, or what is missing while the loop is offline.
function showReason() {
  const { rows } = live, isOffline = byId("state").textContent === "offline";
  const sentence = (text) => (text.endsWith(".") ? text : `${text}.`);
  const reason = fault ? `Fault. ${sentence(fault)}` : isOffline && readiness ? `Offline: ${sentence(readiness)}` : "";
  const age_s = fresh_s === null ? 0 : rows.last - fresh_s;
  byId("fault").hidden = !reason;
  if (byId("reason").textContent !== reason) byId("reason").textContent = reason;
  byId("sample-age").textContent = reason && age_s > OLD_SAMPLE_S ? `The last good sample is ${Math.round(age_s)} s old.` : "";
}

function setStatus(status) {
  const { run } = live, { counts = {}, controllers = {}, recording } = status;
  fault = status.fault || "";
  readiness = status.readiness || "";
  const used = Object.entries(controllers).map(([axis, name]) => `${axis}: ${name}`).join(", ");
  const facts = [`bus ${run.bus}`, `rig ${run.rig}`, used && `controllers ${used}`, recording ? `recording ${recording}` : "not recorded"];
  byId("facts").textContent = facts.filter(Boolean).join(" · ");
  showReason();
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
      : [name, `no step from rest; error at most ${show(s.max_error, 4)} ${s.unit}, RMS ${show(s.rms_error, 4)} ${s.unit}`]));
    if (s.kind !== "StepResponse") Object.assign(body.lastChild.lastChild, { colSpan: 4, className: "text" });
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

function buildPlayer({ begin_s, end_s }) {
  byId("player").hidden = false;
  const slider = byId("position");
  slider.min = begin_s;
  slider.max = end_s;
}
byId("position").addEventListener("input", (event) => send({ seek_s: Number(event.target.value) }));
byId("speed").addEventListener("change", (event) => send({ speed: Number(event.target.value) }));
// Go on where the page was when it lost the connection.
function resume() {
  send({ speed: Number(byId("speed").value) });
  send({ seek_s: Number(byId("position").value) });
  send({ paused: isPaused });
}
function setPosition(position_s) {
  const slider = byId("position");
  if (document.activeElement !== slider || !slider.matches(":active")) slider.value = position_s;
  byId("position-text").textContent = `${position_s.toFixed(1)} of ${Number(slider.max).toFixed(1)} s`;
}

// Operator

// State of the life cycle in which the daemon takes a request. A button says this at once, and the daemon checks it.
const STATE_OF = { arm: "ready", start: "armed", disarm: "armed", reset: "fault" };
let requests = new Map();  // buttons by the name of their request
function addRequest(bar, name) {
  const button = document.createElement("button");
  button.textContent = name[0].toUpperCase() + name.slice(1);
  // A disabled button would lose the keyboard's focus as soon as its request has changed the state.
  button.addEventListener("click", () => {
    if (button.ariaDisabled === "true") showReply({ accepted: false, text: button.title });
    else send({ request: name });
  });
  bar.append(button);
  return button;
}
function showAllowed(state) {
  for (const [name, button] of requests) {
    const isAllowed = !live.run.states.includes(state) || STATE_OF[name] === state;  // without data the daemon decides
    setAllowed(button, isAllowed, STATE_OF[name], state);
  }
  // A jog that is held is itself the state running.
  if (held) setAllowed(held, !live.run.states.includes(state) || state === "armed" || state === "running", "armed", state);
}
function setAllowed(button, isAllowed, needed, state) {
  button.ariaDisabled = String(!isAllowed);
  button.title = isAllowed ? "" : `${button.textContent} needs state ${needed}; the state is ${state}`;
}

let jog = null, held = null;  // jog of the button that is held
function buildOperator() {
  if (jog) jog.release();
  const bar = byId("operator");
  bar.replaceChildren();
  bar.hidden = byId("stop").hidden = !mayOperate;
  if (!mayOperate) return;
  const button = (text, request) => { const b = document.createElement("button"); b.textContent = text; b.addEventListener("click", () => send(request())); bar.append(b); return b; };
  const field = (label, attributes) => { const l = document.createElement("label"), i = document.createElement("input"); Object.assign(i, attributes); l.append(label, i); bar.append(l); return i; };
  requests = new Map(Object.keys(STATE_OF).map((name) => [name, addRequest(bar, name)]));
  const axis = document.createElement("select");
  axis.setAttribute("aria-label", "axis");
  live.run.axes.forEach(([name]) => axis.append(new Option(name)));
  bar.append(axis);
  const setpoint = field("setpoint", { type: "text", size: 12 });
  button("Set", () => ({ request: "setpoint", axis: axis.value, setpoint: setpoint.value }));
  const volts = field("jog, V", { type: "number", step: 0.1, value: 0.5, style: "width: 6em" });
  held = document.createElement("button");
  held.textContent = "Hold to jog";
  bar.append(held);
  showAllowed(byId("state").textContent);
  // The server refuses a jog whose `beat_s` is old: it may have waited somewhere after the button was released.
  jog = new HeldJog(() => send({ request: "jog", axis: axis.value, offset_v: Number(volts.value), duration_s: 0.2, beat_s: connection.beat_s }));
  const press = (event) => {
    event.preventDefault();
    if (held.ariaDisabled === "true") showReply({ accepted: false, text: held.title });
    else jog.press();
  };
  held.addEventListener("pointerdown", press);
  held.addEventListener("keydown", (event) => { if (event.key === " " || event.key === "Enter") press(event); });
  for (const name of ["pointerup", "pointerleave", "pointercancel", "keyup", "blur"]) held.addEventListener(name, () => jog.release());
  const file = field("controller", { type: "file", accept: ".json" });
  file.addEventListener("change", async () => {
    if (file.files.length) send({ request: "controller", axis: axis.value, name: file.files[0].name, document: await file.files[0].text() });
    file.value = "";
  });
}
byId("stop").addEventListener("click", () => { if (jog) jog.release(); send({ request: "stop" }); });
const INSTEAD = "Use `hil stop` in a terminal, or the emergency stop.";
function showReply({ accepted, text }) {
  const box = byId("reply");
  box.hidden = false;
  box.textContent = text;
  box.className = accepted ? "reply" : "reply refused";
}
function send(message) {
  const id = connection.send(message);
  if (id) return id;
  const what = message.request ? `${message.request} was not sent: no connection.` : "Not sent: no connection.";
  showReply({ accepted: false, text: message.request === "stop" ? `${what} ${INSTEAD}` : what });
  return 0;
}

// One button: it holds the view, and a recording with it.
function pause(wanted) {
  if (wanted === isPaused) return;
  isPaused = wanted;
  const button = byId("pause");
  button.setAttribute("aria-pressed", String(isPaused));
  button.textContent = isPaused ? (isRecording ? "Play" : "Follow") : "Pause";
  if (isRecording) send({ paused: isPaused });
  if (!isPaused) setCursor(null);
  isDirty = true;
}
byId("pause").addEventListener("click", () => pause(!isPaused));
byId("span").addEventListener("change", () => { isDirty = true; });
DARK.addEventListener("change", () => live.run && buildCharts());
// Zooming and panning pause the view; all charts move together.
function moved(start, end) {
  pause(true);
  view = [start, end];
  isDirty = true;
}

// Zoom by `factor` about the time `at_s`, which stays where it is.
function zoom(factor, at_s = (view[0] + view[1]) / 2) {
  const width = Math.min(Math.max((view[1] - view[0]) * factor, 0.05), HISTORY_S);
  const begin = at_s - (at_s - view[0]) / (view[1] - view[0]) * width;
  moved(begin, begin + width);
}
byId("zoom-in").addEventListener("click", () => zoom(0.5));
byId("zoom-out").addEventListener("click", () => zoom(2));
// The wheel alone scrolls the page; with Ctrl it zooms about the pointer.
byId("charts").addEventListener("wheel", (event) => {
  const box = event.target.closest(".chart");
  if (!event.ctrlKey || !box || !live.rows || !live.rows.length) return;
  event.preventDefault();
  const { left, width } = box.getBoundingClientRect();
  const share = Math.min(Math.max((event.clientX - left - FRAME_LEFT) / (width - FRAME_LEFT), 0), 1);
  zoom(event.deltaY > 0 ? 1.25 : 0.8, view[0] + share * (view[1] - view[0]));
}, { passive: false });

// Keys of the charts: arrows pan, plus and minus zoom, shift and arrows move the cursor, End goes on.
function moveCursor(direction) {
  const { rows } = live, row = cursor_s === null ? rows.find(view[1]) - 1 : rows.find(cursor_s);
  pause(true);
  const next = Math.min(Math.max(row + direction, rows.begin), rows.end - 1);
  setCursor(rows.at(next, 0));
  const width = view[1] - view[0];
  if (cursor_s < view[0] || cursor_s > view[1]) view = [cursor_s - width / 2, cursor_s + width / 2];
  isDirty = true;
}
byId("charts").addEventListener("keydown", (event) => {
  if (!live.rows || !live.rows.length) return;
  const [start, end] = view, width = end - start, right = event.key === "ArrowRight" ? 1 : -1;
  if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
    if (event.shiftKey) moveCursor(right * (event.ctrlKey ? 20 : 1));
    else moved(start + right * width / 10, end + right * width / 10);
  } else if (event.key === "+" || event.key === "=") zoom(0.5);
  else if (event.key === "-") zoom(2);
  else if (event.key === "End") pause(false);
  else return;
  event.preventDefault();
});
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape" && mayOperate) byId("stop").click();
});
const connection = new Connection({
  messages: (messages) => messages.forEach(take),
  rows: takeRows,
  changed: () => { showConnection(); if (connection.isStale) isDirty = true; },
  unanswered: (id, name, why) => {
    if (jog) jog.unanswered(id);
    showReply({ accepted: false, text: `${name}: ${why}. It may have been done or not.${name === "stop" ? ` ${INSTEAD}` : ""}` });
  },
});
requestAnimationFrame(drawFrame);
