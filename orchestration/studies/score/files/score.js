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
const kept = new Map(); // of numbers: print does not wait for them to be unpacked again
const numbers = (packed) => kept.get(packed) ?? kept.set(packed, unpacked(packed).then((all) => all.map((number) => number / page.scale))).get(packed);
const value = (row, name) => row.cases[find("case").value]?.metrics[name] ?? NaN;

find("table").addEventListener("change", () => {
  for (const table of document.querySelectorAll("[data-table]")) table.hidden = table.dataset.table !== find("table").value;
});

/** Buttons that show and hide the lines of each controller. */
function legend() {
  fillLegend(find("lines"), page.rows.map((row, i) => ({
    label: row.title, ...shade(i), hidden: hidden.has(row.name),
    toggle: () => {
      if (!hidden.delete(row.name)) hidden.add(row.name);
      draw();
    },
  })));
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
    const line = { label: row.title, x: time, ...shade(i) };
    panels.depth.push({ ...line, y: z });
    panels.error.push({ ...line, y: z.map((at, k) => 100 * (at - depth[k])) });
    panels.force.push({ ...line, y: u });
  }
  panels.depth.push({ label: "reference", x: time, y: depth, color: "#888888", width: 1 });
  chart(find("depth"), panels.depth, { y: "Depth [m]", down: true });
  chart(find("error"), panels.error, { y: "Error [cm]", legend: find("lines") });
  chart(find("force"), panels.force, { y: "u [N]" });
}

/** Rows that no other one beats in both metrics, by ascending RMSE. */
function front(rows) {
  const isBetter = (one, other) => ["rmse", "total_variation"].some((name) => value(one, name) < value(other, name));
  const beaten = (row) => rows.some((other) => isBetter(other, row) && !isBetter(row, other));
  return rows.filter((row) => !beaten(row)).sort((a, b) => value(a, "rmse") - value(b, "rmse"));
}

async function drawPareto() {
  const failed = (row) => row.cases[find("case").value]?.failed.length > 0;
  const rows = page.rows.filter((row) => Number.isFinite(value(row, "rmse")));
  const best = front(rows.filter((row) => !failed(row)));
  const margins = rows.map((row) => row.delay_margin).filter(Number.isFinite);
  const [least, largest] = [Math.min(...margins), Math.max(...margins)];
  const points = rows.map((row) => ({
    x: value(row, "rmse"), y: value(row, "total_variation"), name: row.name,
    text: [`${row.title}, inputs: ${row.connected.join(", ")}`, `RMSE ${value(row, "rmse").toPrecision(3)} cm`, `total variation ${value(row, "total_variation").toPrecision(4)} N`, `delay margin ${row.delay_margin?.toPrecision(3) ?? "-"} s`].join("\n"),
    label: row.scored || best.includes(row) ? row.title : "", size: row.scored ? 7 : 4.5,
    mark: failed(row) ? "cross" : row.connected.length > 1 ? "diamond" : "circle",
    color: Number.isFinite(row.delay_margin) ? `hsl(${240 - 220 * ((row.delay_margin - least) / (largest - least || 1))} 70% ${dark() ? 65 : 42}%)` : "#888888",
  }));
  const line = best.map((row) => ({ x: value(row, "rmse"), y: value(row, "total_variation") }));
  scatter(find("pareto"), points, { x: "RMSE [cm]", y: "Total variation of u [N]", log: true, line });
  find("margins").textContent = margins.length ? `blue ${least.toPrecision(3)} s to orange ${largest.toPrecision(3)} s` : "not judged";
}

/** The plants of a controller stand above its name, spread so that they do not hide each other; a bar is their median. */
function drawPlants() {
  const name = find("plant-metric")?.value;
  if (!name) return;
  const points = page.rows.flatMap((row, i) => {
    const values = (row.plants?.metrics[name].values ?? []).filter(Number.isFinite).sort((a, b) => a - b);
    const { color } = shade(i);
    const text = (y) => `${row.title}: ${y.toPrecision(4)}`;
    const drawn = values.map((y, k) => ({ x: i + 0.5 * (((k * 0.618) % 1) - 0.5), y, color, size: 2, text: text(y), name: row.title }));
    const median = row.plants?.metrics[name].median;
    return [...drawn, { x: i, y: median, color, size: 4, mark: "bar", strong: true, text: `${row.title}: median ${median?.toPrecision(4)}` }];
  });
  const { title, unit } = page.protocol.metrics[name];
  scatter(find("boxes"), points, { x: "", y: titled(title, unit), log: true, names: [page.rows.map((row) => row.title)] });
}

function draw() {
  legend();
  return counted(() => drawTracking().then(drawPareto).then(drawPlants));
}

find("case").addEventListener("change", draw);
find("plant-metric")?.addEventListener("change", draw);
redraws.push(draw);
draw();
