"use strict";
// Charts over a common time axis, drawn by BokehJS.

Bokeh.set_log_level("error");  // an empty chart has no range yet, which BokehJS warns of
const DARK = window.matchMedia("(prefers-color-scheme: dark)");
const HEIGHT = 190, LABELS_HEIGHT = 22;  // pixels of a chart, and of the labels of its time axis
const FRAME_LEFT = 58;  // pixels from the left edge of a chart to its frame
// Okabe and Ito's colours, which colour-blind people can tell apart; a lighter blue on a dark ground.
const COLOURS = () => (DARK.matches ? { measured: "#56b4e9", wanted: "#e69f00" } : { measured: "#0072b2", wanted: "#b35900" });
const colourOf = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// BokehJS measures every label of every picture, and draws its outline, which has no colour here. Each measurement is an
// object outside of the scripts' memory, which the browser frees late. BokehJS uses the width alone.
function makeTextCheap() {
  const { prototype } = CanvasRenderingContext2D, { measureText } = prototype, known = new Map();
  prototype.measureText = function (text) {
    const key = `${this.font} ${text}`;
    let metrics = known.get(key);
    if (!metrics) {
      if (known.size >= 2000) known.clear();
      known.set(key, metrics = measureText.call(this, text));
    }
    return metrics;
  };
  prototype.strokeText = () => {};
}
makeTextCheap();

// BokehJS asks for computed styles at every stroke and text: a third of the time of a picture. Here they never change.
function omitStyleSheets(view) {
  const found = [...view.visuals][0], owner = found && Object.getPrototypeOf(Object.getPrototypeOf(found));
  if (owner && typeof owner._get_css_value === "function") owner._get_css_value = () => "";
  Object.defineProperty(view, "base_font_size", { value: 13 });
}

function dress(figure) {
  for (const [key, value] of Object.entries({
    background_fill_color: colourOf("--back"), border_fill_color: colourOf("--back"), outline_line_color: colourOf("--line"),
  })) figure[key] = value;
  for (const axis of [...figure.below, ...figure.left]) {
    axis.major_label_text_color = axis.axis_label_text_color = colourOf("--soft");
    axis.minor_tick_line_color = null;
    axis.axis_line_color = axis.major_tick_line_color = colourOf("--line");
  }
  for (const grid of figure.center) if ("grid_line_color" in grid) grid.grid_line_color = colourOf("--line"), grid.grid_line_alpha = 0.6;
}

// Draw the figure of `chart` in `parent`, and remove it again: BokehJS keeps a view until it is removed.
function show_in(chart, parent) {
  chart.view = Promise.resolve(Bokeh.Plotting.show(chart.figure, parent));
  chart.view.then(omitStyleSheets);
}
function discard(chart) {
  chart.view.then((view) => view.remove && view.remove());
}

function makeFigure(options) {
  const figure = new Bokeh.Plotting.Figure({ sizing_mode: "stretch_width", toolbar_location: null, ...options });
  figure.min_border_left = FRAME_LEFT;
  figure.output_backend = "canvas";
  dress(figure);
  return figure;
}

// One chart. `lines`: [{label, colour, dashed}], `floor`: smallest height of the y axis, in `unit`, so that the noise
// of a signal at rest does not fill the chart. `on`: functions moved(start, end), when the user pans; pointed(time under
// the pointer, or null); painted(chart), after each picture.
class Chart {
  constructor(parent, title, unit, lines, floor, on) {
    this.lines = lines;
    this.box = document.createElement("div");
    this.box.className = "chart";
    this.box.innerHTML = `<h3></h3><div></div>`;
    const heading = this.box.firstChild;
    heading.append(`${title}, ${unit}`);
    this.labels = lines.map((line) => {
      const span = document.createElement("span");
      span.className = line.dashed ? "key dashed" : "key";
      span.style.setProperty("--c", line.colour);
      span.textContent = line.label;
      heading.append(span);
      return span;
    });
    parent.append(this.box);
    const y_range = new Bokeh.DataRange1d({ min_interval: floor, range_padding: 0.08, only_visible: true });
    const x_range = new Bokeh.Range1d({ start: 0, end: 30 });
    x_range.change.connect(() => { if (!this.isMoving) on.moved(x_range.start, x_range.end); });
    this.figure = makeFigure({ height: HEIGHT, x_range, y_range, tools: "xpan" });
    this.sources = lines.map((line) => {
      const source = new Bokeh.ColumnDataSource({ data: { t: [], v: [] } });
      this.figure.line({ field: "t" }, { field: "v" }, {
        source, line_color: line.colour, line_width: line.dashed ? 1.6 : 1.8, line_dash: line.dashed ? "dashed" : "solid",
      });
      return source;
    });
    this.cursor = new Bokeh.Span({ dimension: "height", location: 0, visible: false, line_color: colourOf("--ink"), line_width: 1.5 });
    this.figure.add_layout(this.cursor);
    for (const name of ["mousemove", "tap"]) this.figure.on_event(name, (event) => on.pointed(event.x));
    this.figure.on_event("mouseleave", () => on.pointed(null));
    show_in(this, this.box.lastChild);
    this.view.then((view) => view.repainted.connect(() => on.painted(this)));
  }
  remove() { discard(this); }
  // Show or hide the labels of the time axis. Charts above each other need them once.
  labelTime(isLabelled) {
    const [axis] = this.figure.below;
    if (axis.visible === isLabelled) return;
    axis.visible = isLabelled;
    this.figure.height = isLabelled ? HEIGHT : HEIGHT - LABELS_HEIGHT;
  }
  // Show the times from `start` to `end`.
  move(start, end) {
    this.isMoving = true;
    this.figure.x_range.setv({ start, end });
    this.isMoving = false;
  }
  // `curves`: times `t` and values `v` of each line.
  draw(curves) { curves.forEach((curve, i) => { this.sources[i].data = curve; }); }
  // Mark the time of the cursor; null: there is none.
  mark(t) {
    if (t === null) { if (this.cursor.visible) this.cursor.visible = false; return; }
    this.cursor.setv({ location: t, visible: true });
  }
  label(values) { this.labels.forEach((span, i) => { span.textContent = `${this.lines[i].label} ${values[i]}`; }); }
}

class Histogram {
  constructor(parent, title) {
    this.source = new Bokeh.ColumnDataSource({ data: { left: [], right: [], top: [] } });
    this.figure = makeFigure({ height: 150, tools: "", x_range: new Bokeh.DataRange1d(), y_range: new Bokeh.DataRange1d({ start: 0 }) });
    this.figure.xaxis.axis_label = `${title}, ms`;
    this.figure.yaxis.axis_label = "periods";
    this.figure.quad({ field: "left" }, { field: "right" }, 0, { field: "top" }, { source: this.source, fill_color: COLOURS().measured, line_color: null });
    show_in(this, parent);
  }
  remove() { discard(this); }
  draw(values) {
    const sorted = Float64Array.from(values).sort();
    if (!sorted.length) return;
    const low = Math.min(0, sorted[0]), high = Math.max(sorted[Math.floor(sorted.length * 0.995)] * 1.1, 0.1), bins = 50;
    const top = new Array(bins).fill(0), width = (high - low) / bins;
    for (const v of sorted) top[Math.min(Math.floor((v - low) / width), bins - 1)] += 1;  // the last one has all beyond
    this.source.data = { left: top.map((_, i) => low + i * width), right: top.map((_, i) => low + (i + 1) * width), top };
  }
}
