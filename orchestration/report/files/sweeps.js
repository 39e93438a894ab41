"use strict";
// Sweeps: how metrics are distributed, what they depend on, and what one sample was.

for (const section of document.querySelectorAll("section.sweep")) {
  if (section.querySelector(".scatter")) sweepSection(section, page.sweeps[Number(section.dataset.sweep)]);
}

function sweepSection(section, sweep) {
  const find = (selector) => section.querySelector(selector);
  const [scatter, across, up, number, chosen] = [".scatter", ".across", ".up", "input.sample", ".chosen"].map(find);
  const metrics = sweep.columns.filter((column) => column.kind === "metric");
  const varied = sweep.columns.filter((column) => column.kind === "varied");
  const sampleColumn = { name: "sample", unit: "", kind: "sample", values: sweep.samples };
  const columns = [...varied, ...metrics, sampleColumn];
  const histograms = metrics.map((metric) => {
    const plot = element("div", { className: "plot" });
    find(".histograms").append(element("figure", {}, element("figcaption", {}, heading(metric)), plot));
    return [metric, plot];
  });
  let sample = null; // the one chosen

  function heading(column) {
    return column.unit ? `${column.name} [${column.unit}]` : column.name;
  }

  const values = (column) => (column.numbers ??= Array.isArray(column.values) ? column.values : unpacked(column.values));

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
      find(".groups").replaceChildren(...sweep.groups.map((group, i) => {
        const swatch = element("span", { textContent: "\u25a0 " });
        swatch.style.color = colour(i);
        return element("span", {}, swatch, group.name);
      }));
    }
    for (const [metric, plot] of histograms) {
      const all = await values(metric);
      const traces = sweep.groups.map((group, i) => ({
        type: "histogram", name: plain(group.name), bingroup: 1, opacity: sweep.groups.length > 1 ? 0.65 : 1,
        x: group.members.map((at) => all[at]).filter(Number.isFinite), marker: { color: colour(i) },
      }));
      await figure(plot, traces, { barmode: "overlay", bargap: 0.04, yaxis: { title: { text: "samples" } }, xaxis: { exponentformat: "power" } }, `distribution of ${metric.name}`, THIRD_OF_PRINT_WIDTH);
    }
  }

  async function drawScatter() {
    const [horizontal, vertical] = [across, up].map((select) => columns[Number(select.value)]);
    const [samples, x, y] = await Promise.all([sampleColumn, horizontal, vertical].map(values));
    const at = samples.indexOf(sample);
    const points = {
      type: "scatter", mode: "markers", x, y, customdata: samples,
      marker: { size: 7, opacity: 0.65, color: Array.from(samples, (_, at) => colour(groupOf.get(at) ?? 0)) },
      hovertemplate: "sample %{customdata}<br>%{x}, %{y}<extra></extra>",
    };
    const ring = {
      type: "scatter", mode: "markers", x: at < 0 ? [] : [x[at]], y: at < 0 ? [] : [y[at]], hoverinfo: "skip",
      marker: { size: 14, color: "rgba(0,0,0,0)", line: { width: 3, color: colour(1) } },
    };
    await figure(scatter, [points, ring], {
      hovermode: "closest",
      xaxis: { title: { text: titled(horizontal.name, horizontal.unit) }, exponentformat: "power" },
      yaxis: { title: { text: titled(vertical.name, vertical.unit) }, exponentformat: "power" },
    }, `${vertical.name} against ${horizontal.name}`);
    if (!scatter.dataset.listening) {
      scatter.dataset.listening = "true";
      scatter.on("plotly_click", (event) => counted(() => choose(event.points[0].customdata)));
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
  const draw = () => counted(() => drawHistograms().then(drawScatter));
  redraws.push(draw);
  draw();
}
