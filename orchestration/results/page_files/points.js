"use strict";
// Points: any quantity against another one, with names on an axis where it has no numbers; and histograms.

const MARKS = {
  circle: (path, x, y, r) => path.arc(x, y, r, 0, 2 * Math.PI),
  diamond: (path, x, y, r) => [[0, -r], [r, 0], [0, r], [-r, 0], [0, -r]].forEach(([across, down], i) => path[i ? "lineTo" : "moveTo"](x + across, y + down)),
  cross: (path, x, y, r) => [[-r, -r, r, r], [-r, r, r, -r]].forEach(([a, b, c, d]) => (path.moveTo(x + a, y + b), path.lineTo(x + c, y + d))),
  cell: (path, x, y, r, u) => {
    const [width, height] = ["x", "y"].map((axis) => Math.abs(u.valToPos(1, axis, true) - u.valToPos(0, axis, true)));
    path.rect(x - width / 2, y - height / 2, width, height);
  },
  bar: (path, x, y, r) => (path.moveTo(x - 3 * r, y), path.lineTo(x + 3 * r, y)),
};

/**
 * Draws points {x, y, color, text, mark, size, strong, label} and returns the uPlot.
 *
 * text is shown under the pointer, label beside the point; a cell has a share from 0 to 1 in place of a colour, and
 * its label inside; press(point) is called with the nearest one within reach [px]; line: points that a grey line
 * joins; names: [of x, of y], lists of which a coordinate is an index, or null for numbers
 */
function scatter(place, points, { x, y, log = false, names = [], line = [], reach = 12, press }) {
  const drawn = points.filter((point) => Number.isFinite(point.x) && Number.isFinite(point.y));
  const tip = element("output", { className: "tip" });
  const near = { point: null };
  const across = (values) => {
    const isSlanted = values?.join("").length > 40; // letters that have room side by side on a phone
    return values ? { splits: () => values.map((_, i) => i), values: () => values, rotate: isSlanted ? -30 : 0, size: isSlanted ? 110 : 34 } : {};
  };
  const scale = (values) => (values ? { range: [-0.5, values.length - 0.5] } : { distr: log ? 3 : 1, range: log ? oneDigit : padded });
  const invisible = { ...sorted(drawn), label: "points", series: { paths: () => null } };
  const joined = { ...sorted(line), label: "line", color: "#888888", width: 1, series: { spanGaps: true } };
  place.points = drawn;
  const made = chart(place, line.length ? [invisible, joined] : [invisible], {
    x, y,
    more: {
      scales: { x: scale(names[0]), y: scale(names[1]) },
      axes: [{ ...(log ? { filter: someDigits } : {}), ...across(names[0]) }, names[1] ? { splits: () => names[1].map((_, i) => i), values: () => names[1], size: 110 } : log ? { filter: someDigits } : {}],
      cursor: { points: { show: false }, sync: null },
      hooks: { draw: [(u, taken = drawn.some(({ label }) => label) ? drawn.map((point) => room(u, point)) : []) => drawn.forEach((point) => mark(u, point, taken))], setCursor: [point] },
    },
  });
  made.over.append(tip);
  made.over.addEventListener("click", () => near.point && press?.(near.point));

  function point(u) {
    const far = (each) => Math.hypot(u.valToPos(each.x, "x") - u.cursor.left, u.valToPos(each.y, "y") - u.cursor.top);
    const nearest = drawn.reduce((best, each) => (far(each) < far(best) ? each : best), drawn[0]);
    near.point = nearest && u.cursor.left >= 0 && far(nearest) < reach ? nearest : null;
    tip.textContent = near.point?.text ?? "";
    const { left, top } = u.cursor;
    const [width, height] = [u.over.clientWidth, u.over.clientHeight];
    tip.style.inset = [top < height / 2 ? top + 12 : null, left > width / 2 ? width - left + 12 : null, top < height / 2 ? null : height - top + 12, left > width / 2 ? null : left + 12]
      .map((px) => (px === null ? "auto" : `${px}px`)).join(" "); // towards the middle
  }

  return made;
}

const sorted = (points) => {
  const ascending = [...points].sort((a, b) => a.x - b.x);
  return { x: ascending.map((point) => point.x), y: ascending.map((point) => point.y) };
};
const someDigits = (u, ticks) => ticks.map((tick) => (/^[1235]e/.test(tick.toExponential(0)) ? tick : null));
const oneDigit = (u, least, largest) => [Number((least / 1.5).toExponential(0)), largest * 1.2]; // ticks are multiples of it
const padded = (u, least, largest) => {
  const margin = 0.05 * (largest - least) || 0.05 * Math.abs(largest) || 1;
  return [least - margin, largest + margin];
};

/** The fill of a share from 0 to 1, farther from the colour of the page if larger, and a legible ink on it. */
function heat(share) {
  const lightness = Number.isFinite(share) ? (dark() ? 20 + 60 * share : 95 - 60 * share) : dark() ? 10 : 100;
  return [`hsl(210 ${Number.isFinite(share) ? 65 : 0}% ${lightness}%)`, lightness > 55 ? "#000000" : "#ffffff"];
}

/** The room of a point that no label takes; `at` is the base line of a text that would hide it. */
const room = (u, { x, y, size = 4 }) => ({ middle: u.valToPos(x, "x", true), half: size * devicePixelRatio, at: u.valToPos(y, "y", true) + (size + 1) * devicePixelRatio });

/** Draws a point, and its label above it, or below it where points or labels in `taken` are in the way. */
function mark(u, { x, y, color, share, mark = "circle", size = 4, strong = false, label = "" }, taken) {
  const [across, down, r] = [u.valToPos(x, "x", true), u.valToPos(y, "y", true), size * devicePixelRatio];
  const path = new Path2D();
  MARKS[mark](path, across, down, r, u);
  u.ctx.save();
  u.ctx.textAlign = "center";
  if (mark === "cell") {
    const [fill, ink] = heat(share);
    u.ctx.fillStyle = fill;
    u.ctx.fill(path);
    u.ctx.fillStyle = ink;
    u.ctx.textBaseline = "middle";
    u.ctx.fillText(label, across, down);
    u.ctx.restore();
    return;
  }
  u.ctx.globalAlpha = strong ? 1 : 0.65;
  [u.ctx.fillStyle, u.ctx.strokeStyle, u.ctx.lineWidth] = [color, color, (strong ? 3 : 1.5) * devicePixelRatio];
  if (color !== "none" && !strong) u.ctx.fill(path);
  u.ctx.stroke(path);
  u.ctx.globalAlpha = 1;
  u.ctx.fillStyle = u.axes[0].stroke();
  const [half, line] = [u.ctx.measureText(label).width / 2, 14 * devicePixelRatio];
  const middle = Math.min(across, u.ctx.canvas.width - half);
  const overlaps = (at) => taken.some((other) => Math.abs(other.middle - middle) < other.half + half && Math.abs(other.at - at) < line);
  let at = down - 2 * r;
  if (label && overlaps(at)) for (at = down + 2 * r + line; overlaps(at); ) at += line;
  if (label) taken.push({ middle, half, at });
  u.ctx.fillText(label, middle, at);
  u.ctx.restore();
}

const BINS = 20;

/** Draws how often values of each of some groups {label, color, values} fall into equal bins, one group over the other. */
function histogram(place, groups, x = "") {
  const finite = groups.map(({ values }) => Array.from(values).filter(Number.isFinite));
  const all = finite.flat();
  const [least, largest] = all.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
  const count = largest > least ? BINS : 1;
  const width = (largest - least) / BINS || Math.abs(least) * 1e-3 || 1;
  const starts = Array.from({ length: count }, (_, i) => least + i * width);
  const lines = groups.map(({ label, color }, i) => {
    const counts = starts.map(() => 0);
    finite[i].forEach((value) => counts[Math.min(Math.floor((value - least) / width), count - 1)]++);
    return { label, x: starts, y: counts, color, dash: dash(i), width: 1, series: { fill: `${color}99`, paths: uPlot.paths.bars({ size: [1, Infinity], align: 1 }) } };
  });
  chart(place, lines, {
    x, y: "samples",
    more: { scales: { x: { range: [least, least + count * width] }, y: { range: (u, low, high) => [0, 1.05 * high] } }, axes: [{ space: 42 }, {}], cursor: { sync: null } },
  });
}
