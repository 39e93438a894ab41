"use strict";
// A score: which table is shown, what the controllers did in a case, and how they compare.

const find = (id) => document.getElementById(id);
const names = page.rows.map((row) => row.name);
const hidden = new Set(names.filter((name) => !page.shown.includes(name))); // whose lines are not drawn
const order = [...page.shown, ...hidden]; // those that are drawn at first have styles that differ most

// forty pairs of ten colours and four dashes; neighbours differ in both
const shade = (i) => {
  const at = order.indexOf(names[i]);
  return { color: colour(at), dash: dash(at + Math.floor(at / 20)), width: page.rows[i].scored ? 3 : 1.5 };
};
const numbers = async (packed) => (await unpacked(packed)).map((number) => number / page.scale);
const value = (row, name) => row.cases[find("case").value]?.metrics[name] ?? NaN;

find("table").addEventListener("change", () => {
  for (const table of document.querySelectorAll("[data-table]")) table.hidden = table.dataset.table !== find("table").value;
});

/** Buttons that show and hide the lines of each controller. */
function legend() {
  find("lines").replaceChildren(...page.rows.map((row, i) => {
    const button = element("button", { type: "button" });
    button.innerHTML = '<svg viewBox="0 0 28 12" aria-hidden="true"><path d="M0 6H28" stroke-width="2.5"/></svg>';
    button.append(row.title);
    const path = button.querySelector("path");
    path.setAttribute("stroke", shade(i).color);
    path.setAttribute("stroke-dasharray", DASHES[shade(i).dash]);
    button.setAttribute("aria-pressed", String(!hidden.has(row.name)));
    button.addEventListener("click", () => {
      if (!hidden.delete(row.name)) hidden.add(row.name);
      draw();
    });
    return button;
  }));
}

async function drawTracking() {
  const chosen = find("case").value;
  const reference = page.references[chosen];
  const [time, depth] = reference ? await Promise.all([numbers(reference.time), numbers(reference.reference)]) : [[], []];
  const panels = { depth: [], error: [], force: [] };
  for (const [i, row] of page.rows.entries()) {
    const trace = row.traces[chosen];
    if (!trace || hidden.has(row.name)) continue;
    const [z, u] = await Promise.all([numbers(trace.depth), numbers(trace.u)]);
    const line = { type: "scatter", mode: "lines", name: plain(row.title), x: time, line: shade(i) };
    panels.depth.push({ ...line, y: z });
    panels.error.push({ ...line, y: z.map((at, k) => 100 * (at - depth[k])) });
    panels.force.push({ ...line, y: u });
  }
  panels.depth.push({ type: "scatter", mode: "lines", name: "reference", x: time, y: depth, line: { color: "#888888", width: 1 } });
  const seconds = { title: { text: "Time [s]" } };
  await figure(find("depth"), panels.depth, { xaxis: seconds, yaxis: { autorange: "reversed" } }, `depth ${chosen}`);
  await figure(find("error"), panels.error, { xaxis: seconds }, `error ${chosen}`);
  await figure(find("force"), panels.force, { xaxis: seconds }, `force ${chosen}`);
}

/** Rows that no other one beats in both metrics, by ascending RMSE. */
function front(rows) {
  const beaten = (row) => rows.some((other) => other !== row && value(other, "rmse") <= value(row, "rmse") && value(other, "total_variation") < value(row, "total_variation"));
  return rows.filter((row) => !beaten(row)).sort((a, b) => value(a, "rmse") - value(b, "rmse"));
}

async function drawPareto() {
  const failed = (row) => row.cases[find("case").value]?.failed.length > 0;
  const rows = page.rows.filter((row) => Number.isFinite(value(row, "rmse")));
  const best = front(rows.filter((row) => !failed(row)));
  const line = { type: "scatter", mode: "lines", x: best.map((row) => value(row, "rmse")), y: best.map((row) => value(row, "total_variation")), line: { color: "#888888", width: 1 }, hoverinfo: "skip" };
  const points = {
    type: "scatter", mode: "markers+text", textposition: "top center",
    x: rows.map((row) => value(row, "rmse")), y: rows.map((row) => value(row, "total_variation")),
    text: rows.map((row) => (row.scored || best.includes(row) ? plain(row.title) : "")), hovertext: rows.map((row) => plain(`${row.title}, told ${row.connected.join(", ")}`)),
    marker: {
      size: rows.map((row) => (row.scored ? 14 : 9)), symbol: rows.map((row) => (failed(row) ? "x" : row.connected.length > 1 ? "diamond" : "circle")),
      color: rows.map((row) => row.delay_margin ?? NaN), colorscale: "Viridis", colorbar: { title: { text: "Delay margin [s]" } },
      line: { width: rows.map((row) => (row.scored ? 3 : 1)), color: "#888888" },
    },
    hovertemplate: "%{hovertext}<br>RMSE %{x:.3g} cm<br>total variation %{y:.4g} N<br>delay margin %{marker.color:.3g} s<extra></extra>",
  };
  await figure(find("pareto"), [line, points], {
    hovermode: "closest",
    xaxis: { title: { text: "RMSE [cm]" }, type: "log" },
    yaxis: { title: { text: "Total variation of u [N]" }, type: "log" },
  }, `price ${find("case").value}`);
}

async function drawBoxes() {
  const name = find("plant-metric")?.value;
  if (!name) return;
  const traces = page.rows.map((row, i) => ({
    type: "box", name: plain(row.title), y: row.plants?.metrics[name].values.filter(Number.isFinite) ?? [],
    boxpoints: "outliers", marker: { color: shade(i).color, size: 3 }, line: { width: row.scored ? 2.5 : 1 },
  }));
  const { title, unit } = page.protocol.metrics[name];
  await figure(find("boxes"), traces, { yaxis: { title: { text: titled(title, unit) }, type: "log" }, xaxis: { tickangle: -40 } }, `plants ${name}`);
}

function draw() {
  legend();
  return counted(() => drawTracking().then(drawPareto).then(drawBoxes));
}

find("case").addEventListener("change", draw);
find("plant-metric")?.addEventListener("change", draw);
redraws.push(draw);
draw();
