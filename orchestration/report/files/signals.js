"use strict";
// Signals over time: a panel for each unit, with tracking errors beside their signals, all with one time axis.

if (page.runs.length) signalsSection();

function signalsSection() {
  const FEW_SIGNALS = 6; // shown at first of runs whose metrics name none
  const FEW_RUNS = 6;
  const place = document.getElementById("panels");
  const status = document.getElementById("drawn");
  const view = document.getElementById("view");
  const inputs = [document.getElementById("from"), document.getElementById("to")];
  const panels = new Map(); // unit -> {figure, caption, legend, plot, slots, hidden, y}
  let zoom = null; // [from, to] in s, or null for all

  const panelOf = (signal) => (signal.error_of ? `error [${signal.unit}]` : signal.unit);
  const units = [...new Set(page.runs.flatMap((run) => run.signals.map(panelOf)))]; // and errors apart
  const errors = new Map(page.runs.flatMap((run) => run.signals).filter((signal) => signal.error_of).map((signal) => [panelOf(signal), signal.error_of]));
  const beside = new Map([...errors, ...[...errors].map(([error, unit]) => [unit, error])]); // the panels of a signal and its error
  const inBrackets = (unit) => (errors.has(unit) ? unit : `[${unit}]`);
  const chosenRuns = ticks(document.getElementById("choose-runs"), "", page.runs.map((run, i) => [run.name, i < FEW_RUNS || run.is_measured, run.label]));
  const chosenSignals = new Map(units.map((unit) => [unit, ticks(document.getElementById("choose-signals"), unit, names(unit))]));

  /** Names of a unit's signals in any run, each with whether it is shown at first. */
  function names(unit) {
    const all = (runs) => runs.flatMap((run) => run.signals);
    const found = [...new Set(all(page.runs).filter((signal) => panelOf(signal) === unit).map((signal) => signal.name))];
    const inMetrics = new Set(page.runs.flatMap((run) => run.in_metrics));
    const first = new Set(all(page.runs).slice(0, FEW_SIGNALS).map((signal) => signal.name));
    const anyInMetrics = all(page.runs).some((signal) => inMetrics.has(signal.name));
    return found.map((name) => [name, (anyInMetrics ? inMetrics : first).has(name)]);
  }

  /** Tick boxes with a heading and a button for all of them; returns a function that lists the ticked ones. */
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
    const labels = boxes.map((box, i) => element("label", { title: box.value }, box, entries[i][2] ?? box.value));
    const title = heading ? [element("b", {}, inBrackets(heading))] : [];
    fieldset.append(element("div", { className: "group" }, ...title, every, element("div", { className: "ticks" }, ...labels)));
    return () => boxes.filter((box) => box.checked).map((box) => box.value);
  }

  const times = (run) => (run.times ??= unpacked(run.time));
  const numbers = (signal) => (signal.numbers ??= unpacked(signal.values));

  /** The times of the points of a signal: all or some of the run's. */
  async function timesOf(run, signal) {
    const time = await times(run);
    let at = 0;
    return signal.steps ? (signal.times ??= (await unpacked(signal.steps)).map((step) => time[(at += step)])) : time;
  }

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
      let i = firstAt(time, t);
      if (time[i] === t) {
        while (time[i + 1] === t) i += 1; // at a jump, the value after it
        return values[i];
      }
      if (i === 0 || i === time.length) return NaN;
      return values[i - 1] + ((values[i] - values[i - 1]) * (t - time[i - 1])) / (time[i] - time[i - 1]);
    });
  }

  /** The lines of one unit that are ticked: {label, name, run, down, x, y}; run is null where all share it. */
  async function lines(unit) {
    const base = view?.value ? page.runs[Number(view.value)] : null;
    const chosen = new Set(chosenSignals.get(unit)());
    const runs = page.runs.filter((run) => chosenRuns().includes(run.name) && run !== base);
    const found = [];
    for (const name of chosen) {
      const of = (run) => run.signals.find((signal) => signal.name === name && panelOf(signal) === unit);
      const having = runs.filter((run) => of(run) && (!base || of(base)));
      const groups = Map.groupBy(having, (run) => (base ? run : run.time + of(run).steps + of(run).values)); // equal ones are one line
      for (const [run, ...equal] of groups.values()) {
        const x = await timesOf(run, of(run));
        let y = await numbers(of(run));
        if (base) {
          const other = interpolated(await timesOf(base, of(base)), await numbers(of(base)), x);
          y = y.map((value, i) => value - other[i]);
        }
        const shared = equal.length > 0 && groups.size === 1;
        const whose = shared ? "all" : [run, ...equal].map((each) => each.label).join(" = ");
        const label = page.runs.length > 1 ? `${name}, ${whose}` : name;
        found.push({ label, name, run: shared ? null : page.runs.indexOf(run), down: of(run).down, thinned: Boolean(of(run).steps), series: { spanGaps: run.is_measured }, x, y });
      }
    }
    return found;
  }

  function panel(unit) {
    if (!panels.has(unit)) {
      const [caption, legend, plot] = ["figcaption", "div", "div"].map((tag) => element(tag));
      legend.className = "legend";
      plot.className = "plot";
      const made = { caption, legend, plot, figure: element("figure", {}, caption, legend, plot), slots: new Map(), hidden: new Set(), y: null };
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

  /** Of one run, a colour for each signal; of several, for each run. Dashes differ with both, for readers without colours. */
  function style(made, { name, run }) {
    const slot = made.slots.get(name);
    if (page.runs.length === 1) return { color: colour(slot), dash: dash(slot + Math.floor(slot / 20)) };
    if (run === null) return { color: colour(SHARED), dash: dash(slot) };
    return { color: colour(colourOfRun(run)), dash: dash(slot + run) };
  }

  function drawPanel(unit, found, range, isBeside) {
    const made = panel(unit);
    made.figure.hidden = !found.length;
    made.figure.classList.toggle("beside", isBeside);
    if (!found.length) return;
    numbered(made.slots, found.map((line) => line.name));
    made.caption.textContent = (view?.value ? "Difference" : "Signals") + (unit === "1" ? " without unit" : ` in ${unit}`);
    const styled = found.map((line) => ({
      ...line,
      ...style(made, line),
      hidden: made.hidden.has(line.label),
      toggle: () => {
        if (!made.hidden.delete(line.label)) made.hidden.add(line.label);
        draw();
      },
    }));
    if (errors.has(unit)) made.caption.textContent = (view?.value ? "Difference, tracking " : "Tracking ") + unit;
    fillLegend(made.legend, styled);
    const shown = styled.filter((line) => !line.hidden).sort((a, b) => roughness(b) - roughness(a)); // smooth ones on top
    chart(made.plot, shown, {
      y: page.axes[unit] ?? unit.replace("error", "Error"), range, yRange: made.y, down: found.some((line) => line.down), // depth increases downwards
      legend: made.legend, zoomed: (x, y) => zoomed(made, x, y),
    });
  }

  function zoomed(made, x, y) {
    if (x || !y) zoom = x;
    if (y || !x) made.y = y;
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
    const whole = [Math.min(...shown.map((line) => line.x[0])), Math.max(...shown.map((line) => line.x.at(-1)))];
    const range = zoom ?? whole;
    inputs.forEach((input, i) => (input.value = shown.length || zoom ? short(range[i]) : ""));
    const drawn = new Set(found.filter(([, each]) => each.length).map(([unit]) => unit));
    for (const [unit, each] of found) drawPanel(unit, each, range, drawn.has(beside.get(unit)));
    const thinned = shown.filter((line) => line.thinned).length;
    status.textContent = !shown.length
      ? "Nothing is ticked."
      : thinned
        ? `${thinned} of ${shown.length} lines are decimated: the page holds the least and the largest value of each of ${page.columns} columns of time, and both ends. The recording has every point.`
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
