"use strict";
// Shared by all sections: the data of the page, colours, and charts that follow the colour scheme.

const page = JSON.parse(document.getElementById("data").textContent);
const PALETTE = {
  light: ["#0b62c4", "#c2410c", "#15803d", "#7e22ce", "#b91c1c", "#0e7490", "#8a6100", "#be185d", "#4d5b6b", "#4d6100"],
  dark: ["#6cb2ff", "#ff9b5e", "#5fd38a", "#c79bff", "#ff8080", "#4fd1e0", "#e5c04b", "#ff8fc4", "#b6c2d0", "#c3d14f"],
};
const DASHES = { solid: "", dash: "6 4", dot: "2 3", dashdot: "8 3 2 3" };
const PRINT_WIDTH = 660; // px: A4 and Letter within their margins
const THIRD_OF_PRINT_WIDTH = 205;
const darkScheme = matchMedia("(prefers-color-scheme: dark)");
const redraws = []; // of every section, when the colour scheme or the medium changes
let printing = false;

const dark = () => darkScheme.matches && !printing;
const colour = (i) => PALETTE[dark() ? "dark" : "light"][i % 10];
const dash = (i) => Object.keys(DASHES)[i % 4];
const SHARED = 8; // the grey of lines that several runs share; no run has it
const colourOfRun = (i) => (i % 9 < SHARED ? i % 9 : 9);

/** The sum of the changes of a line. Smooth lines are drawn over rough ones. */
const roughness = ({ y }) => y.reduce((sum, value, i) => sum + (Math.abs(value - y[i - 1]) || 0), 0);

const titled = (name, unit) => (unit ? `${name} [${unit}]` : name);
const short = (value) => (typeof value === "number" ? String(Number(value.toPrecision(6))) : value);

/** A DOM element with properties and children; texts stay texts. */
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

/** Bytes from base64 of zlib of them. */
async function inflated(text) {
  const packed = Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** The inverse of `packed` in embedded.py: numbers from planes of bytes. */
async function unpacked(text) {
  const planes = await inflated(text);
  const count = planes.length / 8;
  const bytes = new Uint8Array(planes.length);
  for (let plane = 0; plane < 8; plane++) {
    for (let i = 0; i < count; i++) bytes[8 * i + plane] = planes[plane * count + i];
  }
  return new Float64Array(bytes.buffer); // little-endian, as every machine that runs a browser
}

/** Counts the drawings under way in the attribute data-drawing, so that a program can wait for them. */
async function counted(drawing) {
  const add = (change) => (document.body.dataset.drawing = Number(document.body.dataset.drawing) + change);
  add(1);
  try {
    return await drawing();
  } finally {
    add(-1);
  }
}

/**
 * Draws lines {label, unit, x, y, color, dash, width} in a place and returns the uPlot, which is `place.chart` too.
 *
 * x, y: labels of the axes; range, yRange: [from, to], all by default; down: the y axis grows downwards;
 * zoomed(x, y): called after a drag with a range or null for each axis that was not chosen, and with two nulls
 * after a double click; the chart zooms itself by default; more: further options of uPlot
 */
function chart(place, lines, { x = "Time [s]", y = "", range, yRange, down = false, zoomed, legend, more = {} } = {}) {
  const css = getComputedStyle(document.documentElement);
  const [ink, line] = ["--ink", "--line"].map((name) => css.getPropertyValue(name).trim());
  const font = `12px ${getComputedStyle(document.body).fontFamily}`;
  const axis = (label, size, own) => ({ label, stroke: ink, font, labelFont: font, labelSize: 20, size, values: (u, ticks) => ticks.map((tick) => short(tick ?? "")), grid: { stroke: line, width: 1 }, ticks: { stroke: line, width: 1 }, ...own });
  const moves = (type) => type.startsWith("mouse") && !/down|up/.test(type);
  place.chart?.destroy();
  place.chart = new uPlot({
    width: printing ? Number(place.dataset.print ?? PRINT_WIDTH) : place.clientWidth,
    height: place.clientHeight,
    legend: { show: false },
    ...more,
    scales: { x: { time: false, ...more.scales?.x }, y: { dir: down ? -1 : 1, ...more.scales?.y } },
    axes: [axis(x, 34, more.axes?.[0]), axis(y, 62, more.axes?.[1])],
    series: [{}, ...lines.map(({ label, color, dash, width = 1.4, ...own }) => ({
      label, stroke: color, width, dash: (DASHES[dash] || null)?.split(" ").map(Number), points: { show: false }, ...own.series,
    }))],
    cursor: {
      sync: { key: "page", scales: ["x", null], filters: { pub: moves, sub: moves } },
      drag: { x: true, y: true, uni: 40, setScale: false },
      bind: { dblclick: () => () => zoom(null, null) },
      ...more.cursor,
    },
    hooks: { setSelect: [selected], setCursor: [(u) => showValues(legend, u, lines)], ...more.hooks },
  }, aligned(lines), place);
  const made = place.chart;
  const zoom = zoomed ?? ((xs, ys) => {
    if (!xs && !ys) made.setData(made.data); // back to all
    if (xs) made.setScale("x", { min: xs[0], max: xs[1] });
    if (ys) made.setScale("y", { min: ys[0], max: ys[1] });
  });

  function selected({ select, over, posToVal, setSelect }) {
    const span = (key, from, size, whole) => (size > 0 && size < whole - 1 ? [posToVal(from, key), posToVal(from + size, key)].sort((a, b) => a - b) : null);
    const spans = [span("x", select.left, select.width, over.clientWidth), span("y", select.top, select.height, over.clientHeight)];
    setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    if (spans.some(Boolean)) zoom(...spans);
  }

  if (range) made.setScale("x", { min: range[0], max: range[1] });
  if (yRange) made.setScale("y", { min: yRange[0], max: yRange[1] });
  resized.observe(place);
  return made;
}

/** The data of uPlot: all x in one column, values of each line in others; NaN and infinity are gaps. */
const aligned = (lines) => uPlot.join(lines.map(({ x, y }) => [x, Array.from(y, (value) => (Number.isFinite(value) ? value : null))]));

const resized = new ResizeObserver((entries) => {
  for (const { target } of entries) if (!printing) target.chart?.setSize({ width: target.clientWidth, height: target.clientHeight });
});

/** Buttons of lines {label, color, dash, hidden, toggle}; one keeps its focus as long as its line is shown. */
function fillLegend(place, lines) {
  place.buttons ??= new Map();
  const buttons = lines.map((line) => {
    if (!place.buttons.has(line.label)) {
      const made = element("button", { type: "button" });
      made.innerHTML = '<svg viewBox="0 0 28 12" aria-hidden="true"><path d="M0 6H28" stroke-width="2.5"/></svg>';
      made.append(line.label, element("output"));
      place.buttons.set(line.label, made);
    }
    const button = place.buttons.get(line.label);
    button.onclick = line.toggle;
    button.setAttribute("aria-pressed", String(!line.hidden));
    const path = button.querySelector("path");
    path.setAttribute("stroke", line.color);
    path.setAttribute("stroke-dasharray", DASHES[line.dash]);
    return button;
  });
  buttons.forEach((button, i) => {
    if (place.children[i] !== button) place.insertBefore(button, place.children[i] ?? null);
  });
  while (place.children.length > lines.length) place.lastChild.remove();
}

/** Writes the values under the cursor beside the names of a legend. */
function showValues(legend, u, lines) {
  lines.forEach(({ label }, i) => {
    const at = u.cursor.idxs[i + 1];
    const output = legend?.buttons.get(label)?.querySelector("output");
    if (output) output.textContent = at == null || u.data[i + 1][at] == null ? "" : u.data[i + 1][at].toPrecision(4);
  });
}

const redrawAll = () => Promise.all(redraws.map((redraw) => redraw()));
darkScheme.addEventListener("change", redrawAll);
matchMedia("print").addEventListener("change", (event) => event.matches || redrawAll()); // the screen's width is back
for (const [event, value] of [["beforeprint", true], ["afterprint", false]]) {
  addEventListener(event, () => {
    printing = value;
    document.documentElement.classList.toggle("printing", value); // the style may still be that of the screen
    redrawAll();
  });
}
