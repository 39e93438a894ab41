"use strict";
// Runs the scenario in this page, each run in a new instance of its program, and draws the runs one over the other.

const form = document.getElementById("sliders");
const hidden = new Set(page.columns.filter(({ shown }) => !shown).map(({ name }) => name));
let results = []; // for each run of `page.runs`: columns in the order of `page.columns`, time first

/** Makes one run; returns its columns, or throws what an FMU reported. */
function simulate({ module, points, signals }, values) {
  const imports = {};
  for (const { module: from, name } of WebAssembly.Module.imports(module)) (imports[from] ??= {})[name] = () => 0;
  const { exports } = new WebAssembly.Instance(module, imports);
  const array = (name, count) => new Float64Array(exports.memory.buffer, exports[name].value, count);
  array("wiring_points", points.length).set(points);
  array("wiring_signal_values", signals.length).set(signals);
  array("setting_values", values.length).set(values);
  exports._initialize();
  const count = exports.run();
  const text = new Uint8Array(exports.memory.buffer, exports.message.value, 1024);
  const message = new TextDecoder().decode(text.subarray(0, text.indexOf(0)));
  if (message) throw new Error(message);
  const width = page.columns.length;
  const rows = array("wiring_rows", count * width);
  const columns = page.columns.map(() => new Float64Array(count));
  for (let i = 0; i < count; i++) for (let c = 0; c < width; c++) columns[c][i] = rows[i * width + c];
  return [points.subarray(0, count), ...columns];
}

/** Where a value stands between the limits of its slider, 0 to 1; and back. */
const share = ({ low, high, isLogarithmic }, value) => (isLogarithmic ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low));
const valueAt = ({ low, high, isLogarithmic }, at) => (isLogarithmic ? low * (high / low) ** at : low + (high - low) * at);

/** The value of a slider: exactly the scenario's where it stands as at first. */
function chosen(slider) {
  const input = form.elements[slider.name];
  return input.value === input.defaultValue ? slider.value : valueAt(slider, input.valueAsNumber);
}

/** Metrics of a run, computed as in metrics.py from {function, signal, ...} as the scenario declares them. */
const METRICS = {
  settling_time: ({ signal, target, band }, time, columns) => {
    const last = columns(signal).findLastIndex((value) => !(Math.abs(value - target) <= band));
    return last === time.length - 1 ? NaN : time[Math.max(last, 0)];
  },
  rmse: ({ signal, reference, scale = 1 }, time, columns) => {
    const [values, wanted] = [signal, reference].map(columns);
    return scale * Math.sqrt(values.reduce((sum, value, i) => sum + (value - wanted[i]) ** 2, 0) / time.length);
  },
};

/** The value of a metric in its window of a run, NaN where it did not happen. */
function measured(metric, [time, ...columns]) {
  const [start, end] = metric.window ?? [-Infinity, Infinity];
  const tolerance = 1e-9 * Math.max(1, Math.abs(end)); // as metrics.py
  const isInside = (t) => metric.window === undefined || (t >= start - tolerance && t <= end + tolerance);
  const inside = [time.findIndex(isInside), time.findLastIndex(isInside) + 1];
  const column = (name) => columns[page.columns.findIndex((each) => each.name === name)].subarray(...inside);
  return inside[1] ? METRICS[metric.function](metric, time.subarray(...inside), column) : NaN;
}

function showMetrics() {
  page.metrics.forEach((metric, i) => {
    const cells = document.querySelectorAll(`#metrics tbody tr:nth-child(${i + 1}) td`);
    results.forEach((columns, run) => {
      const value = measured(metric, columns);
      cells[run].textContent = Number.isNaN(value) ? metric.absent : value.toPrecision(4);
    });
  });
}

function runAll(program) {
  const status = document.getElementById("status");
  const values = page.sliders.map(chosen);
  page.sliders.forEach((slider, i) => (form.elements[slider.name].previousElementSibling.value = values[i].toPrecision(4)));
  try {
    results = page.runs.map((run) => {
      const own = Float64Array.from(run.values);
      page.sliders.forEach(({ indices }, i) => {
        for (const index of indices) if (own[index] === page.runs[0].values[index]) own[index] = values[i]; // else the runs differ in it
      });
      return simulate(program, own);
    });
    status.textContent = "";
    status.className = "";
    showMetrics();
    draw();
  } catch (error) {
    status.textContent = error.message;
    status.className = "failed";
  }
}

const panels = page.panels.map(({ names, axis, down }) => {
  const columns = names.map((name) => page.columns.find((column) => column.name === name));
  const legend = element("div", { className: "legend" });
  const plot = element("div", { className: "plot" });
  document.getElementById("panels").append(element("figure", {}, legend, plot));
  return { columns, axis, down, legend, plot };
});

/** The lines of a panel: one colour a signal; runs after the first are dashed and pale; a signal of the scenario, equal in all runs, is thin and grey. */
function linesOf(columns) {
  return columns.flatMap((column, i) =>
    page.runs.slice(0, column.isSignal ? 1 : undefined).map(({ label }, run) => ({
      label: run ? `${column.name}, ${label}` : column.name,
      color: (column.isSignal ? colour(SHARED) : colour(i % SHARED)) + (run ? "99" : ""),
      width: column.isSignal ? 1 : 1.4,
      dash: dash(run),
      run,
      hidden: hidden.has(column.name),
      toggle: () => {
        hidden[hidden.has(column.name) ? "delete" : "add"](column.name);
        draw(true);
      },
      x: results[run][0],
      y: results[run][1 + page.columns.indexOf(column)],
    })),
  );
}

const more = { cursor: { drag: { x: true, y: false, setScale: false } } };
let range = null; // of time, that was chosen by a drag in a chart; all by default

function zoomed(times) {
  range = times;
  draw(true);
}

/** Draws all runs; anew: with other lines, colours or times, else with new values alone. */
function draw(anew = false) {
  for (const { columns, axis, down, legend, plot } of panels) {
    const lines = linesOf(columns);
    const shown = lines.filter((line) => !line.hidden);
    fillLegend(legend, lines.filter(({ run }) => !run));
    plot.hidden = !shown.length;
    if (!shown.length) continue;
    if (anew || !plot.chart) {
      // the order stays until the chart is drawn anew, because new values go to its lines by their place
      plot.order = shown.toSorted((one, other) => other.run - one.run || roughness(other) - roughness(one)).map(({ label }) => label);
    }
    shown.sort((one, other) => plot.order.indexOf(one.label) - plot.order.indexOf(other.label));
    if (anew || !plot.chart) chart(plot, shown, { y: axis, down, legend, range, zoomed, more });
    else {
      plot.chart.setData(dataOf(shown));
      if (range) plot.chart.setScale("x", { min: range[0], max: range[1] });
    }
  }
}

/** The data of uPlot; runs that ended early have gaps. */
function dataOf(lines) {
  const longest = lines.reduce((best, { x }) => (x.length > best.length ? x : best), lines[0].x);
  return [longest, ...lines.map(({ y }) => y)];
}

counted(async () => {
  const inflatedProgram = await inflated(page.program);
  const [module, points, signals] = await Promise.all([WebAssembly.compile(inflatedProgram), unpacked(page.points), unpacked(page.signals)]);
  for (const slider of page.sliders) form.elements[slider.name].defaultValue = share(slider, slider.value);
  const program = { module, points, signals };
  let waits = false;
  const follow = () => {
    if (waits) return;
    waits = true;
    requestAnimationFrame(() => {
      waits = false;
      runAll(program);
    });
  };
  form.addEventListener("input", follow);
  form.addEventListener("reset", follow);
  redraws.push(() => draw(true));
  runAll(program);
});
