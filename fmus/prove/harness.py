"""The program that is proved: the C file of a microcontroller, called from every state and input of a box."""

import math
from dataclasses import dataclass
from typing import Any

from fmus.block.scalars import flatten
from fmus.block.variables import BlockVariable
from fmus.generate.c_code import CFunction
from fmus.generate.firmware import FirmwareC, firmware_sources
from fmus.generate.trace import Traced

# of an input or a state without a range, and of the time [s]
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
    inputs = [_interval(v, v.name, LARGEST_INPUT) for v in block.of_causality("input") if v.type == "Real"]
    states = zip(block.state_variables, FirmwareC(traced).members["x"], strict=True)
    return inputs, [_interval(v, name, LARGEST_STATE) for v, name in states]


def _interval(v: BlockVariable, name: str, largest: float) -> Interval:
    """Returns the range of a variable; largest: limit where it has none."""
    items = [*(v.enumeration or ((0, 1) if v.type == "Boolean" else ()))]
    low, high = (min(items), max(items)) if items else (v.minimum, v.maximum)
    is_declared = low is not None and high is not None
    low, high = (-largest if low is None else low), (largest if high is None else high)
    return Interval(name, float(low), float(high), "declared" if is_declared else "chosen")


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
