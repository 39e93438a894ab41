"use strict";
// Signals over time: a panel for each unit, all with one time axis, thinned to what a screen can show.

if (page.runs.length) signalsSection();

function signalsSection() {
  const FEW_SIGNALS = 6; // shown at first of runs whose metrics name none
  const FEW_RUNS = 6;
  const MOST_POINTS = 4000; // of one line; longer ones are drawn by least and largest value of each slot
  const SLOTS = 1200;
  const place = document.getElementById("panels");
  const status = document.getElementById("drawn");
  const view = document.getElementById("view");
  const inputs = [document.getElementById("from"), document.getElementById("to")];
  const panels = new Map(); // unit -> {figure, legend, plot, slots, hidden, y}
  let zoom = null; // [from, to] in s, or null for all

  const units = [...new Set(page.runs.flatMap((run) => run.signals.map((signal) => signal.unit)))];
  const chosenRuns = ticks(document.getElementById("choose-runs"), "", page.runs.map((run, i) => [run.name, i < FEW_RUNS]));
  const chosenSignals = new Map(units.map((unit) => [unit, ticks(document.getElementById("choose-signals"), unit, names(unit))]));

  /** Names of a unit's signals in any run, each with whether it is shown at first. */
  function names(unit) {
    const all = (runs) => runs.flatMap((run) => run.signals);
    const found = [...new Set(all(page.runs).filter((signal) => signal.unit === unit).map((signal) => signal.name))];
    const inMetrics = new Set(page.runs.flatMap((run) => run.in_metrics));
    const first = new Set(all(page.runs).slice(0, FEW_SIGNALS).map((signal) => signal.name));
    const anyInMetrics = all(page.runs).some((signal) => inMetrics.has(signal.name));
    return found.map((name) => [name, (anyInMetrics ? inMetrics : first).has(name)]);
  }

  /** Tick boxes with a heading and a button for all of them; returns what tells the ticked ones. */
  function ticks(fieldset, heading, entries) {
    const boxes = entries.map(([name, checked]) => element("input", { type: "checkbox", checked, value: name }));
    const every = element("button", { type: "button", className: "small", textContent: "all or none" });
    every.setAttribute("aria-label", `all or none of the ${heading ? `signals in ${heading}` : "runs"}`);
    every.addEventListener("click", () => {
      const checked = !boxes.every((box) => box.checked);
      boxes.forEach((box) => (box.checked = checked));
      draw();
    });
    boxes.forEach((box) => box.addEventListener("change", draw));
    const labels = boxes.map((box) => element("label", {}, box, box.value));
    const title = heading ? [element("b", {}, `[${heading}]`)] : [];
    fieldset.append(element("div", { className: "group" }, ...title, every, element("div", { className: "ticks" }, ...labels)));
    return () => boxes.filter((box) => box.checked).map((box) => box.value);
  }

  const times = (run) => (run.times ??= unpacked(run.time));
  const numbers = (signal) => (signal.numbers ??= unpacked(signal.values));

  /** First index whose time is not before t. */
  function firstAt(time, t) {
    let [low, high] = [0, time.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (time[middle] < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** Values at other times, straight between communication points; NaN outside. */
  function interpolated(time, values, wanted) {
    return wanted.map((t) => {
      const i = firstAt(time, t);
      if (time[i] === t) return values[i];
      if (i === 0 || i === time.length) return NaN;
      return values[i - 1] + ((values[i] - values[i - 1]) * (t - time[i - 1])) / (time[i] - time[i - 1]);
    });
  }

  /** Indices of the points to draw from `from` to `to`: all, or of each slot of time least, largest and gaps. */
  function drawnPoints(time, values, from, to) {
    const first = Math.max(0, firstAt(time, from) - 1);
    const last = Math.min(time.length - 1, firstAt(time, to));
    const count = last - first + 1;
    if (count <= MOST_POINTS) return Array.from({ length: count }, (_, i) => first + i);
    const width = (time[last] - time[first]) / SLOTS;
    const kept = [first];
    for (let i = first + 1; i < last; ) {
      const slot = Math.floor((time[i] - time[first]) / width);
      let [least, largest, gap] = [-1, -1, -1];
      for (; i < last && Math.floor((time[i] - time[first]) / width) === slot; i++) {
        if (Number.isNaN(values[i])) gap = i;
        else {
          if (least < 0 || values[i] < values[least]) least = i;
          if (largest < 0 || values[i] > values[largest]) largest = i;
        }
      }
      kept.push(...[...new Set([least, largest, gap])].filter((j) => j >= 0).sort((a, b) => a - b));
    }
    kept.push(last);
    return kept;
  }

  /** The lines of one unit that are ticked: {label, name, run, down, time, values}; run is null where all share it. */
  async function lines(unit) {
    const base = view?.value ? page.runs[Number(view.value)] : null;
    const chosen = new Set(chosenSignals.get(unit)());
    const runs = page.runs.filter((run) => chosenRuns().includes(run.name) && run !== base);
    const found = [];
    for (const name of chosen) {
      const of = (run) => run.signals.find((signal) => signal.name === name && signal.unit === unit);
      const having = runs.filter((run) => of(run) && (!base || of(base)));
      const groups = Map.groupBy(having, (run) => (base ? run : run.time + of(run).values)); // equal ones are one line
      for (const [run, ...equal] of groups.values()) {
        const time = await times(run);
        let values = await numbers(of(run));
        if (base) {
          const other = interpolated(await times(base), await numbers(of(base)), time);
          values = values.map((value, i) => value - other[i]);
        }
        const shared = equal.length > 0 && groups.size === 1;
        const whose = shared ? "all" : [run, ...equal].map((each) => each.name).join(" = ");
        const label = page.runs.length > 1 ? `${name}, ${whose}` : name;
        found.push({ label, name, run: shared ? null : page.runs.indexOf(run), down: of(run).down, time, values });
      }
    }
    return found;
  }

  /** How much ink a line takes: the sum of its changes. */
  const roughness = (trace) => trace.y.reduce((sum, y, i) => sum + (Math.abs(y - trace.y[i - 1]) || 0), 0);

  function panel(unit) {
    if (!panels.has(unit)) {
      const [caption, legend, plot] = ["figcaption", "div", "div"].map((tag) => element(tag));
      legend.className = "legend";
      plot.className = "plot";
      const made = { caption, legend, plot, figure: element("figure", {}, caption, legend, plot), slots: new Map(), buttons: new Map(), hidden: new Set(), y: null };
      panels.set(unit, made);
      const after = units.slice(units.indexOf(unit) + 1).find((each) => panels.has(each));
      place.insertBefore(made.figure, after ? panels.get(after).figure : null);
    }
    return panels.get(unit);
  }

  /** Each signal keeps its number while it is shown; a new one takes the first that is free. */
  function numbered(slots, names) {
    for (const name of [...slots.keys()]) if (!names.includes(name)) slots.delete(name);
    for (const name of names) {
      const taken = new Set(slots.values());
      let free = 0;
      while (taken.has(free)) free++;
      if (!slots.has(name)) slots.set(name, free);
    }
  }

  /** Of one run, a colour for each signal; of several, a colour for each run in every panel and dashes for signals. */
  function style(made, { name, run }) {
    const slot = made.slots.get(name);
    if (page.runs.length === 1) return { color: colour(slot), dash: dash(Math.floor(slot / 10)) };
    if (run === null) return { color: colour(SHARED), dash: dash(slot) };
    return { color: colour(colourOfRun(run)), dash: dash(slot + Math.floor(run / 9)) };
  }

  /** The button of a line, the same one as long as the line is shown: it keeps the focus. */
  function legendButton(made, line) {
    const label = line.label;
    if (!made.buttons.has(label)) {
      const button = element("button", { type: "button" });
      button.innerHTML = '<svg viewBox="0 0 28 12" aria-hidden="true"><path d="M0 6H28" stroke-width="2.5"/></svg>';
      button.append(label);
      button.addEventListener("click", () => {
        if (!made.hidden.delete(label)) made.hidden.add(label);
        draw();
      });
      made.buttons.set(label, button);
    }
    const button = made.buttons.get(label);
    button.setAttribute("aria-pressed", String(!made.hidden.has(label)));
    const path = button.querySelector("path");
    const drawn = style(made, line);
    path.setAttribute("stroke", drawn.color);
    path.setAttribute("stroke-dasharray", DASHES[drawn.dash]);
    return button;
  }

  /** The legend in the order of the lines; what is in its place already is not touched. */
  function fillLegend(made, lines) {
    lines.forEach((line, i) => {
      const button = legendButton(made, line);
      if (made.legend.children[i] !== button) made.legend.insertBefore(button, made.legend.children[i] ?? null);
    });
    while (made.legend.children.length > lines.length) made.legend.lastChild.remove();
  }

  async function drawPanel(unit, found, range) {
    const made = panel(unit);
    made.figure.hidden = !found.length;
    if (!found.length) return 0;
    numbered(made.slots, found.map((line) => line.name));
    made.caption.textContent = (view?.value ? "Difference" : "Signals") + (unit === "1" ? " without unit" : ` in ${unit}`);
    fillLegend(made, found);
    const down = found.some((line) => line.down); // depth increases downwards
    let thinned = 0;
    const traces = found.map((line) => {
      const points = drawnPoints(line.time, line.values, ...range);
      const between = firstAt(line.time, range[1]) - firstAt(line.time, range[0]);
      if (points.length < between) thinned++;
      return {
        type: "scatter", mode: points.length > 1 ? "lines" : "markers", name: plain(line.label),
        x: points.map((i) => line.time[i]), y: points.map((i) => line.values[i]),
        visible: !made.hidden.has(line.label), line: { width: 1.4, ...style(made, line) },
      };
    });
    traces.sort((a, b) => roughness(b) - roughness(a)); // smooth ones on top
    await figure(made.plot, traces, {
      hovermode: "closest",
      xaxis: { title: { text: "time [s]" }, range, exponentformat: "power" },
      yaxis: { title: { text: plain(`[${unit}]`) }, exponentformat: "power", ...(made.y ? { range: made.y } : { autorange: down ? "reversed" : true }) },
    }, `signals ${units.indexOf(unit) + 1}`);
    if (!made.listening) {
      made.listening = true;
      made.plot.on("plotly_relayout", (change) => zoomed(made, change));
    }
    return thinned;
  }

  function zoomed(made, change) {
    const range = (axis) => (change[`${axis}.range`] ?? [change[`${axis}.range[0]`], change[`${axis}.range[1]`]]).map(Number);
    const [x, y] = [range("xaxis"), range("yaxis")];
    const known = (pair) => pair.every(Number.isFinite);
    if (change["yaxis.autorange"]) made.y = null;
    else if (known(y)) made.y = y;
    if (change["xaxis.autorange"]) zoom = null;
    else if (known(x)) zoom = x;
    else return;
    draw();
  }

  let running = null; // one drawing at a time; of several requests only the last counts
  let again = false;
  function draw() {
    if (running) again = true;
    else {
      running = counted(drawOnce).finally(() => {
        running = null;
        if (again) {
          again = false;
          draw();
        }
      });
    }
    return running;
  }

  async function drawOnce() {
    const found = [];
    for (const unit of units) found.push([unit, await lines(unit)]);
    const shown = found.flatMap(([, each]) => each);
    const whole = [Math.min(...shown.map((line) => line.time[0])), Math.max(...shown.map((line) => line.time.at(-1)))];
    const range = zoom ?? whole;
    inputs.forEach((input, i) => (input.value = shown.length || zoom ? short(range[i]) : ""));
    let thinned = 0;
    for (const [unit, each] of found) thinned += await drawPanel(unit, each, range);
    status.textContent = !shown.length
      ? "Nothing is ticked."
      : thinned
        ? `${thinned} of ${shown.length} lines have more points than a screen: drawn by the least and the largest value of each of ${SLOTS} slots of time. Zoom in for every point.`
        : "Every point is drawn.";
  }

  view?.addEventListener("change", () => {
    panels.forEach((made) => (made.y = null));
    draw();
  });
  inputs.forEach((input) => input.addEventListener("change", () => {
    const range = inputs.map((each) => each.valueAsNumber);
    if (range.every(Number.isFinite) && range[0] < range[1]) zoom = range;
    draw();
  }));
  document.getElementById("whole").addEventListener("click", () => {
    zoom = null;
    panels.forEach((made) => (made.y = null));
    draw();
  });
  redraws.push(draw);
  draw();
}
