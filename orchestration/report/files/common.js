"use strict";
// What the sections share: the data of the page, colours, and figures that follow the colour scheme.

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

// plotly reads some markup in texts: names from files must not be taken for it
const plain = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
const titled = (name, unit) => plain(unit ? `${name} [${unit}]` : name);
const short = (value) => (typeof value === "number" ? String(Number(value.toPrecision(6))) : value);

/** A DOM element with properties and children; texts stay texts. */
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

/** The inverse of `packed` in embedded.py: numbers from planes of bytes. */
async function unpacked(text) {
  const packed = Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = planes.length / 8;
  const bytes = new Uint8Array(planes.length);
  for (let plane = 0; plane < 8; plane++) {
    for (let i = 0; i < count; i++) bytes[8 * i + plane] = planes[plane * count + i];
  }
  return new Float64Array(bytes.buffer); // little-endian, as every machine that runs a browser
}

/** Axes and texts in the page's own colours. */
function layout(more) {
  const style = getComputedStyle(document.documentElement);
  const [ink, line, paper, soft] = ["--ink", "--line", "--paper", "--soft"].map((name) => style.getPropertyValue(name).trim());
  const axis = { gridcolor: line, zerolinecolor: line, linecolor: soft, automargin: true };
  const { xaxis, yaxis, ...rest } = more;
  return {
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: ink },
    hoverlabel: { bgcolor: paper, bordercolor: line, font: { color: ink }, namelength: -1 },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: soft, activecolor: ink },
    margin: { l: 10, r: 10, t: 30, b: 10 },
    showlegend: false,
    xaxis: { ...axis, ...xaxis },
    yaxis: { ...axis, ...yaxis },
    ...rest,
  };
}

/** Says in the page how many drawings are under way, for whoever waits for them. */
async function counted(drawing) {
  const add = (change) => (document.body.dataset.drawing = Number(document.body.dataset.drawing) + change);
  add(1);
  try {
    return await drawing();
  } finally {
    add(-1);
  }
}

function figure(place, traces, more, file, printWidth = PRINT_WIDTH) {
  const width = printing ? printWidth : place.clientWidth;
  return Plotly.react(place, traces, { ...layout(more), width }, {
    responsive: true,
    displaylogo: false,
    modeBarButtons: [["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"], ["toImage"]],
    toImageButtonOptions: { format: "svg", filename: file },
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
