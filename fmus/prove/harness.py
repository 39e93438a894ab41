"""The program that is proved: the C file of a microcontroller, called from every state and input of a box."""

import math
import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from fmus.block.scalars import flatten
from fmus.block.variables import BlockVariable
from fmus.generate.c_code import CFunction
from fmus.generate.firmware import FirmwareC, firmware_sources
from fmus.generate.trace import Traced

_RUNS, _STEPS, _WIDER = 20, 300, 100.0
# of an input without a range, of a state, and of the time [s]
LARGEST_INPUT, LARGEST_STATE, LARGEST_TIME = 1e3, 1e6, 1e6
REACHED = "Frama_C_show_each_end"
_MAIN = """
#include "__fc_builtin.h"
int main(void) {{
    static {name} it = {name}_START;
    double t = Frama_C_double_interval(0, {time!r});
    it.internal = {h!r};
    it.count = 1;
{calculated}{inputs}    block_step_constants(it.internal, &it.parameters, &it.calculated, it.constants);
    block_initial_state(0, &it.inputs, &it.parameters, &it.calculated, &it.state);
    {name}_output(&it, 0);
{state}    {name}_step(&it, t);
    {name}_output(&it, t + {h!r});
    {end}(it.outputs);
    return 0;
}}
"""


@dataclass(frozen=True)
class Interval:
    """A range that the proof assumes of an input or of a state; reason: its origin."""

    name: str
    low: float
    high: float
    reason: str


class Shown(FirmwareC):
    """Expressions of operations in the names of the block, to a depth."""

    _depth = 2

    def expression(self, f: CFunction, number: int) -> str:
        return self._statement(f, number).partition(" = ")[2].removesuffix(";")

    def _term(self, f: CFunction, number: int) -> str:
        if not f.operations[number].arguments:
            return super()._term(f, number).partition("->")[2] or super()._term(f, number)
        if not self._depth:
            return "..."
        self._depth -= 1
        text = f"({self.expression(f, number)})"
        self._depth += 1
        return text


def boxes(traced: Traced) -> tuple[list[Interval], list[Interval]]:
    """Returns the ranges of the Real inputs and of the states."""
    block = traced.block
    inputs = [_input(v) for v in block.of_causality("input") if v.type == "Real"]
    names = FirmwareC(traced).members["x"]
    reached = zip(names, *_reached(traced), strict=True)
    return inputs, [_state(name, low, high) for name, low, high in reached]


def _input(v: BlockVariable) -> Interval:
    is_declared = v.minimum is not None and v.maximum is not None
    low = -LARGEST_INPUT if v.minimum is None else float(v.minimum)
    high = LARGEST_INPUT if v.maximum is None else float(v.maximum)
    return Interval(v.name, low, high, "declared" if is_declared else "chosen")


def _state(name: str, low: float, high: float) -> Interval:
    """Returns the box of a state: a hundred times what random steps reach, or with its sign twice as wide."""
    if low >= 0 and high > 0:
        return Interval(name, low / 2, 2 * high, "twice what random steps reach")
    wide = min(_WIDER * max(-low, high, 1.0), LARGEST_STATE)
    return Interval(name, -wide, wide, "100 times what random steps reach")


def _reached(traced: Traced) -> tuple[list[float], list[float]]:
    """Returns the least and largest value of each state in random steps, each run until it is not finite."""
    block, numbers = traced.block, random.Random(1)
    h, p = block.step_size, flatten(block.parameters())
    c = traced.calculate(p)
    states = []
    for run in range(_RUNS):
        u = [float(value) for value in flatten(block.inputs())]
        x = traced.initial_state(0.0, u, p, c)
        for i in range(_STEPS):
            if not i % (1 + numbers.randrange(50)):
                u = list(_inputs(traced, numbers, LARGEST_INPUT if not run % 5 else 1.0))
            x = traced.step(i * h, h, x, u, p, c).full().ravel().tolist()
            if not all(map(math.isfinite, x)):
                break
            states.append(x)
    columns = [*zip(*states, strict=True)] or [(-LARGEST_STATE, LARGEST_STATE)] * traced.step.numel_out(0)
    return [min(column) for column in columns], [max(column) for column in columns]


def _inputs(traced: Traced, numbers: random.Random, largest: float) -> Iterator[float]:
    for v in traced.block.of_causality("input"):
        box = _input(v)
        is_real = v.type == "Real"
        low, high = max(box.low, -largest), min(box.high, largest)
        yield numbers.uniform(low, high) if is_real and low <= high else float(v.start)


def harness(traced: Traced, inputs: list[Interval], states: list[Interval]) -> str:
    """Returns one C file: header, equations and a main program."""
    block, name, sources = traced.block, traced.block.name, firmware_sources(traced)
    described = FirmwareC(traced).members
    members = dict(zip((v.name for v in block.of_causality("input")), described["u"], strict=True))
    calculated = traced.calculate(flatten(block.parameters())).full().ravel().tolist()
    main = _MAIN.format(
        name=name,
        h=_internal_step(traced),
        calculated="".join(
            f"    it.calculated.{member} = {value!r};\n"
            for member, value in zip(described["c"], calculated, strict=True)
        ),
        time=LARGEST_TIME,
        inputs="".join(_any(f"inputs.{members[box.name]}", box) for box in inputs),
        state="".join(_any(f"state.{box.name}", box) for box in states),
        end=REACHED,
    )
    return sources[f"{name}.c"].replace(f'#include "{name}.h"', sources[f"{name}.h"]) + main


def _internal_step(traced: Traced) -> float:
    """Returns the size of the internal steps [s] of a step of the suggested size."""
    h = float(traced.block.step_size)
    return h / max(1, math.ceil(h / traced.block.parameters().internal_step * (1 - 1e-9)))


def _any(member: str, box: Interval) -> str:
    return f"    it.{member} = Frama_C_double_interval({box.low!r}, {box.high!r});\n"


def traced_function(traced: Traced, name: str) -> Any:
    """Returns the traced function of a function `block_NAME` of the harness."""
    return getattr(traced, name.removesuffix("_constants"))
