"""The generated Modelica package read back and run: its arguments, in the order that its equations say.

A stand-in for a Modelica tool: it knows the few forms that the generator writes, and nothing else.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from orchestration.exchange import modelica


@dataclass(frozen=True)
class Block:
    """What a block's text says, evaluated with the modifiers of an instance."""

    name: str
    arguments: list[list[float]]
    inputs: list[str]
    outputs: list[str]
    starts: list[float]
    follows: bool
    bound: dict[str, float]


def _elements(text: str) -> list[str]:
    return [] if text.startswith("fill(") else [element.strip("{}") for element in text.split(", ")]


def _scalars(name: str, text: str) -> dict[str, float]:
    """name -> value, name[i] -> value of a vector, or name[i,j] -> value of a matrix."""
    values = [{"true": 1.0, "false": 0.0}.get(e) for e in _elements(text)]
    numbers = [float(e) if v is None else v for e, v in zip(_elements(text), values, strict=True)]
    columns = len(_elements(text.partition("}")[0])) if text.startswith("{{") else 0
    if columns:
        return {f"{name}[{i // columns + 1},{i % columns + 1}]": x for i, x in enumerate(numbers)}
    if text.startswith("{"):
        return {f"{name}[{i}]": x for i, x in enumerate(numbers, start=1)}
    return {name: numbers[0]}


def read_block(path: Path, modifiers: dict[str, str]) -> Block:
    """The block with the modifiers of an instance."""
    text = path.read_text(encoding="utf-8")
    values: dict[str, float] = {}
    declared = r"^  parameter (?:Real|Integer|Boolean) (\w+)(?:\[[\d, ]+\])?(?:\(.*?\))?"
    for name, value in re.findall(rf"{declared} = (\{{\{{.*?\}}\}}|\{{.*?\}}|\S+)", text, re.M):
        values |= _scalars(name, value)
    for name, value in modifiers.items():
        values |= _scalars(name, value)
    call = re.search(r'FMU fmu = FMU\(folder, "(\w+)", "\w+",(.*?)\);', text, re.S)
    assert call
    lists = re.findall(r"\{.*?\}|fill\(.*?\)", call[2])
    names = re.search(r"^  Real now\[\d+\] = (\{.*?\})", text, re.M)
    starts = re.search(r"else\n    y = startFMU\(fmu, startTime, (\{.*?\}), \d+\)", text)
    assert names
    assert starts
    return Block(
        name=call[1],
        arguments=[[_evaluated(e, values) for e in _elements(elements)] for elements in lists],
        inputs=_elements(names[1]),
        outputs=[n for n, _ in re.findall(r"^  (\S+) = y\[(\d+)\];", text, re.M)],
        starts=[float(e) for e in _elements(starts[1])],
        follows=modifiers.get("initialOutputsFollowInputs") == "true",
        bound={n: x for n, x in values.items() if n in _elements(names[1])},
    )


def _evaluated(element: str, values: dict[str, float]) -> float:
    name = re.sub(r"^if (\S+) then 1 else 0$", r"\1", element)
    return values[name] if name in values else float(name)


@dataclass(frozen=True)
class Loop:
    """What the text of the closed loop says."""

    blocks: dict[str, Block]
    table: list[tuple[float, float]]
    connections: list[tuple[str, str]]
    start: float
    stop: float
    step: float


def read_loop(folder: Path) -> Loop:
    text = (folder / f"{modelica.SYSTEM}.mo").read_text(encoding="utf-8")
    blocks = {}
    for kind, name, inside in re.findall(r"^  (\w+) (\w+)\(\n(.*?)\);\n", text, re.S | re.M):
        modifiers = dict(re.findall(r"(\w+) = (\{\{.*?\}\}|\{.*?\}|[^,\n]+)", inside))
        blocks[name] = read_block(folder / f"{kind}.mo", modifiers)
    table = re.search(r"table = \[(.*?)\]", text)
    experiment = re.search(r"StartTime = (\S+), StopTime = (\S+), Interval = ([\d.e-]+)\)", text)
    assert table
    assert experiment
    rows = [tuple(float(e) for e in row.split(",")) for row in table[1].split(";")]
    return Loop(
        blocks=blocks,
        table=[(t, x) for t, x in rows],
        connections=re.findall(r"connect\((\S+), (\S+)\);", text),
        start=float(experiment[1]),
        stop=float(experiment[2]),
        step=float(experiment[3]),
    )


def driver(loop: Loop, folder: Path) -> str:
    """C that calls the external functions as the equations of the package do.

    It writes the outputs of all components to the file that it is given, a row for each communication point.
    """
    order = sorted(loop.blocks, key=lambda name: loop.blocks[name].follows)
    lines = [
        '#include "modelica_fmu.h"',
        _table_function(loop),
        "int main(int argc, char **argv) {",
        '    FILE *out = argc == 2 ? fopen(argv[1], "wb") : NULL;',
        "    if (!out) return 1;",
    ]
    for name in order:
        block = loop.blocks[name]
        lines += _opening(name, block, folder)
        lines.append(f"    double {name}_u[{len(block.inputs)}], {name}_y[{len(block.outputs)}];")
    for name in order:
        block = loop.blocks[name]
        lines += _now(loop, name, f"{loop.start!r}") if block.follows else []
        given = f"{name}_u" if block.follows else _literal(block.starts, "double")
        # twice, as tools do
        lines += [f"    modelica_fmu_start({name}, {loop.start!r}, {given}, {name}_y);"] * 2
    steps = round((loop.stop - loop.start) / loop.step)
    lines.append(f"    for (int k = 0; k <= {steps}; k++) {{")
    for name in order:
        step = f"modelica_fmu_step({name}, {loop.start!r}, {loop.step!r}, k, {name}_u, {name}_y);"
        lines.append(f"    if (k) {step}")
        lines.append(f"    if (k) {step}")
    for name in order:
        lines += _now(loop, name, f"{loop.start!r} + k * {loop.step!r}")
    lines += [f"    fwrite({n}_y, sizeof(double), {len(loop.blocks[n].outputs)}, out);" for n in order]
    lines.append("    }")
    lines += [f"    modelica_fmu_close({name});" for name in order]
    return "\n".join([*lines, "    return fclose(out);", "}", ""])


def columns(loop: Loop) -> list[str]:
    """Names of what the driver writes in a row."""
    order = sorted(loop.blocks, key=lambda name: loop.blocks[name].follows)
    return [f"{name}.{output}" for name in order for output in loop.blocks[name].outputs]


def _literal(values: list[float], kind: str) -> str:
    if not values:
        return "NULL"
    numbers = [repr(float(x)) if kind == "double" else str(int(x)) for x in values]
    return f"(const {kind}[]){{{', '.join(numbers)}}}"


def _opening(name: str, block: Block, folder: Path) -> list[str]:
    reals, real_values, integers, integer_values, booleans, boolean_values, inputs, outputs = block.arguments
    parts = []
    for references, values, kind in (
        (reals, real_values, "double"), (integers, integer_values, "int"), (booleans, boolean_values, "int"),
    ):  # fmt: skip
        parts.append(f"{_literal(references, 'int')}, {_literal(values, kind)}, {len(values)}")
    ends = ", ".join(f"{_literal(references, 'int')}, {len(references)}" for references in (inputs, outputs))
    unpacked = folder / "Resources" / "FMUs" / block.name
    values = ", ".join(parts)
    return [
        f'    void *{name} = modelica_fmu_open("{unpacked}", "{block.name}", "{name}", {values}, {ends});'
    ]


def _now(loop: Loop, name: str, time: str) -> list[str]:
    """The inputs of a component at a time, from the connections, the table and the modifiers."""
    source = {target: source for source, target in loop.connections}
    assignments = []
    for i, variable in enumerate(loop.blocks[name].inputs):
        given = source.get(f"{name}.{variable}")
        if given is None:
            text = repr(loop.blocks[name].bound[variable])
        elif given.endswith(".y[1]"):
            text = f"table({time})"
        else:
            component, output = given.split(".", 1)
            text = f"{component}_y[{loop.blocks[component].outputs.index(output)}]"
        assignments.append(f"    {name}_u[{i}] = {text};")
    return assignments


def _table_function(loop: Loop) -> str:
    """Linear interpolation, held outside, as CombiTimeTable with HoldLastPoint documents."""
    lines = [
        "static double table(double t) {",
        f"    if (t <= {loop.table[0][0]!r}) return {loop.table[0][1]!r};",
    ]
    for (t_0, x_0), (t_1, x_1) in zip(loop.table, loop.table[1:], strict=False):
        fraction = f"((t - {t_0!r}) / ({t_1!r} - {t_0!r}))"
        lines.append(f"    if (t <= {t_1!r}) return {x_0!r} + ({x_1!r} - {x_0!r}) * {fraction};")
    return "\n".join([*lines, f"    return {loop.table[-1][1]!r};", "}"])
