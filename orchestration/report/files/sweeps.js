"use strict";
// Sweeps: distributions of metrics, maps, one quantity against another, and single samples.

const values = (column) => (column.numbers ??= Array.isArray(column.values) ? column.values : unpacked(column.values));

/** A figure for the histogram of a metric; returns the place to draw it in. */
function histogramPlace(section, caption) {
  const plot = element("div", { className: "plot" });
  plot.dataset.print = THIRD_OF_PRINT_WIDTH;
  section.querySelector(".histograms").append(element("figure", {}, element("figcaption", {}, caption), plot));
  return plot;
}

/** Names in the colours of their bars. */
function swatches(section, names) {
  section.querySelector(".groups").replaceChildren(...names.map((name, i) => {
    const swatch = element("span", { textContent: `${"\u25cf\u25c6\u2715"[i % 3]} ` });
    swatch.style.color = colour(i);
    return element("span", {}, swatch, name);
  }));
}

const comparedSweeps = document.getElementById("sweeps-compared");
if (comparedSweeps) {
  const places = page.compared.map(([name, unit]) => [name, histogramPlace(comparedSweeps, titled(name, unit))]);
  const draw = () => counted(async () => {
    swatches(comparedSweeps, page.sweeps.map((sweep) => sweep.label));
    for (const [name, plot] of places) {
      const groups = page.sweeps.map(async (sweep, i) => {
        const all = await values(sweep.columns.find((column) => column.kind === "metric" && column.name === name));
        return { label: sweep.label, color: colour(i), values: sweep.groups.flatMap((group) => group.members).map((at) => all[at]) };
      });
      histogram(plot, await Promise.all(groups));
    }
  });
  redraws.push(draw);
  draw();
}

for (const section of document.querySelectorAll("section.sweep")) {
  if (section.querySelector(".scatter")) sweepSection(section, page.sweeps[Number(section.dataset.sweep)]);
}

function sweepSection(section, sweep) {
  const heading = (column) => titled(column.name, column.unit);
  const find = (selector) => section.querySelector(selector);
  const [scatterPlace, across, up, number, chosen] = [".scatter", ".across", ".up", "input.sample", ".chosen"].map(find);
  const metrics = sweep.columns.filter((column) => column.kind === "metric");
  const varied = sweep.columns.filter((column) => column.kind === "varied");
  const sampleColumn = { name: "sample", unit: "", kind: "sample", values: sweep.samples };
  const columns = [...varied, ...metrics, sampleColumn];
  // a grid is no sample of anything
  const histograms = sweep.grid ? [] : metrics.map((metric) => [metric, histogramPlace(section, heading(metric))]);
  let sample = null; // the one chosen


  const named = (name) => columns.find((column) => column.name === name && column.kind !== "sample");
  const [firstAcross, firstUp] = sweep.first?.map(named) ?? [varied[0], metrics[0]];
  for (const [select, first] of [[across, firstAcross], [up, firstUp]]) {
    for (const [label, group] of [["varied", varied], ["metrics", metrics], ["", [sampleColumn]]]) {
      const options = group.map((column) => new Option(heading(column), columns.indexOf(column), false, column === first));
      select.append(...(label ? [element("optgroup", { label }, ...options)] : options));
    }
    select.addEventListener("change", () => counted(drawScatter));
  }

  const groupOf = new Map(sweep.groups.flatMap((group, i) => group.members.map((at) => [at, i])));

  async function drawHistograms() {
    if (sweep.groups.length > 1) {
      swatches(section, sweep.groups.map((group) => group.name));
    }
    for (const [metric, plot] of histograms) {
      const all = await values(metric);
      const groups = sweep.groups.map((group, i) => ({ label: group.name, color: colour(i), values: group.members.map((at) => all[at]) }));
      histogram(plot, groups);
    }
  }

  async function drawScatter() {
    const [horizontal, vertical] = [across, up].map((select) => columns[Number(select.value)]);
    const [samples, x, y] = await Promise.all([sampleColumn, horizontal, vertical].map(values));
    const names = [x, y].map((all) => (Array.isArray(all) ? [...new Set(all)] : null));
    const at = (all, known, i) => (known ? known.indexOf(all[i]) : all[i]);
    const points = Array.from(samples, (number, i) => ({
      x: at(x, names[0], i), y: at(y, names[1], i), color: colour(groupOf.get(i) ?? 0), mark: Object.keys(MARKS)[(groupOf.get(i) ?? 0) % 3], sample: number,
      text: `sample ${number}: ${short(x[i])}, ${short(y[i])}`,
    }));
    const ring = points.filter((point) => point.sample === sample).map((point) => ({ ...point, color: colour(1), size: 8, strong: true }));
    scatter(scatterPlace, [...points, ...ring], {
      x: heading(horizontal), y: heading(vertical), names, press: (point) => counted(() => choose(point.sample)),
    });
  }

  const mapped = find(".mapped"); // the metric of the maps
  if (sweep.grid) {
    mapped.append(...metrics.map((metric, i) => new Option(heading(metric), i)));
    mapped.addEventListener("change", () => counted(drawMaps));
  }

  /** Draws the metric as a map over the two numbers of a grid, one for each group. */
  async function drawMaps() {
    if (!sweep.grid) return;
    const metric = metrics[Number(mapped.value)];
    const axes = sweep.grid.map(named);
    const [numbers, x, y, all] = await Promise.all([sampleColumn, ...axes, metric].map(values));
    const known = [x, y].map((each) => [...new Set(each)].sort((a, b) => a - b));
    const finite = all.filter(Number.isFinite);
    const [least, largest] = [Math.min(...finite), Math.max(...finite)];
    find(".maps").replaceChildren();
    for (const { name, members } of sweep.groups) {
      const plot = element("div", { className: "plot map" });
      find(".maps").append(element("figure", {}, element("figcaption", {}, [heading(metric), name].filter(Boolean).join(", ")), plot));
      const cells = members.map((at) => ({
        x: known[0].indexOf(x[at]), y: known[1].indexOf(y[at]), mark: "cell", sample: numbers[at],
        share: (all[at] - least) / (largest - least || 1),
        label: known[0].length > 12 ? "" : Number.isFinite(all[at]) ? String(Number(all[at].toPrecision(3))) : "-",
        text: `sample ${numbers[at]}: ${Number.isFinite(all[at]) ? short(all[at]) : metric.absent}`,
      }));
      scatter(plot, cells, {
        x: heading(axes[0]), y: heading(axes[1]), names: known.map((each) => each.map(short)), reach: Infinity,
        press: (point) => counted(() => choose(point.sample)),
      });
    }
  }

  async function choose(wanted) {
    const samples = await values(sampleColumn);
    const at = samples.indexOf(wanted);
    sample = at < 0 ? null : wanted;
    if (at < 0) chosen.replaceChildren(element("p", {}, `No sample ${wanted}: expected ${samples[0]} to ${samples.at(-1)}.`));
    else await show(at);
    await drawScatter();
  }

  async function show(at) {
    number.value = sample;
    const error = sweep.errors[sample];
    const facts = [];
    for (const column of [...varied, ...metrics]) {
      const value = (await values(column))[at];
      if (column.kind === "varied" || !error) {
        const text = Number.isNaN(value) ? column.absent : String(value);
        facts.push(element("div", {}, element("dt", {}, heading(column)), element("dd", {}, text)));
      }
    }
    const command = sweep.command.replace("{sample}", sample);
    const copy = element("button", { type: "button", textContent: "Copy", hidden: !navigator.clipboard });
    copy.addEventListener("click", () => navigator.clipboard.writeText(command).then(() => (copy.textContent = "Copied")));
    chosen.replaceChildren(
      element("h4", {}, `Sample ${sample}`),
      ...(error ? [element("p", {}, `Failed: ${error}`)] : []),
      element("dl", { className: "facts" }, ...facts),
      element("p", {}, "Runs it again: ", element("code", {}, command), " ", copy),
    );
  }

  number.addEventListener("change", () => Number.isFinite(number.valueAsNumber) && counted(() => choose(number.valueAsNumber)));
  const draw = () => counted(() => drawHistograms().then(drawMaps).then(drawScatter));
  redraws.push(draw);
  draw();
}
