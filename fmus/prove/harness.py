"""The program that is proved: the C file of a microcontroller, called from every state and input of a box."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from fmus.block.instance import internal_steps
from fmus.block.scalars import flatten
from fmus.block.variables import BlockVariable
from fmus.firmware.code import FirmwareC, firmware_sources
from fmus.generate.c_code import CFunction
from fmus.generate.trace import Traced

# of an input or a state without a range, and of the time [s]
LARGEST_INPUT, LARGEST_STATE, LARGEST_TIME = 1e3, 1e6, 1e6
REACHED, STAYS = "Frama_C_show_each_end", "stays_"
_MAIN = """
#include "__fc_builtin.h"
int main(void) {{
    static {name} it = {name}_START;
    // Eva does not check the bounds of an array in a struct
    enum {{ constants = sizeof it.constants / sizeof *it.constants - 1 }};
    double k[constants ? constants : 1];
    {name}_state next;
    double t = Frama_C_double_interval(0, {time!r});
    it.internal = {h!r};
    it.count = 1;
{fixed}{inputs}    block_step_constants(it.internal, &it.parameters, &it.calculated, k);
    block_initial_state(0, &it.inputs, &it.parameters, &it.calculated, &it.state);
{stays}    {name}_output(&it, 0);
{state}    block_step(t, it.internal, &it.state, &it.inputs, &it.parameters, &it.calculated, k, &next);
    it.state = next;
{stays}    {name}_output(&it, t + {h!r});
    {end}(it.outputs);
    return 0;
}}
"""


@dataclass(frozen=True)
class Interval:
    """A range that the proof assumes of an input, a state or a parameter; reason: its origin."""

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


def free_parameters(traced: Traced) -> list[Interval]:
    """Returns the ranges of the parameters, but of the step size, which the proof takes as it is."""
    parameters = (v for v in traced.block.of_causality("parameter") if v.name != "internal_step")
    return [_interval(v, v.name, max(LARGEST_INPUT, 10.0 * abs(v.start))) for v in parameters]


def harness(
    traced: Traced, inputs: list[Interval], states: list[Interval], parameters: Sequence[Interval] = ()
) -> str:
    """Returns one C file: header, equations and a main program; other parameters have their start values."""
    block, name, sources = traced.block, traced.block.name, firmware_sources(traced)
    described = FirmwareC(traced).members
    members = {
        v.name: f"{kind}.{member}"
        for kind, causality, column in (("inputs", "input", "u"), ("parameters", "parameter", "p"))
        for v, member in zip(block.of_causality(causality), described[column], strict=True)
    }
    h = float(block.step_size)
    main = _MAIN.format(
        name=name,
        h=h / internal_steps(h, block.parameters().internal_step),
        fixed=_parameters(traced, [(members[box.name], box) for box in parameters]),
        stays="".join(_stays(box) for box in states),
        time=LARGEST_TIME,
        inputs="".join(_any(members[box.name], box) for box in inputs),
        state="".join(_any(f"state.{box.name}", box) for box in states),
        end=REACHED,
    )
    return sources[f"{name}.c"].replace(f'#include "{name}.h"', sources[f"{name}.h"]) + main


def _parameters(traced: Traced, free: Sequence[tuple[str, Interval]]) -> str:
    """Returns C of the free parameters, and of what is calculated: numbers, unless a parameter is free."""
    if free:
        return "".join(_any(*one) for one in free) + "    block_calculate(&it.parameters, &it.calculated);\n"
    calculated = traced.calculate(flatten(traced.block.parameters())).full().ravel().tolist()
    members = zip(FirmwareC(traced).members["c"], calculated, strict=True)
    return "".join(f"    it.calculated.{member} = {value!r};\n" for member, value in members)


def _any(member: str, box: Interval) -> str:
    return f"    it.{member} = Frama_C_double_interval({box.low!r}, {box.high!r});\n"


def _stays(box: Interval) -> str:
    """Returns an annotation that Eva proves if the state is in its range; hexadecimal, as decimals round."""
    low, high = box.low.hex(), box.high.hex()
    return f"    //@ check {STAYS}{box.name}: {low} <= it.state.{box.name} <= {high};\n"


def lasting(traced: Traced, staying: Collection[str]) -> list[str]:
    """Returns the states that stay in their ranges in every step: those that they follow from stay, too.

    staying: the states that a step from the ranges leaves in theirs
    """
    names = [*FirmwareC(traced).members["x"]]
    rows, columns = traced.step.jac_sparsity(0, traced.step.index_in("x")).get_triplet()
    stay = {i for i, name in enumerate(names) if name in staying}
    while wrong := {i for i, j in zip(rows, columns, strict=True) if i in stay and j not in stay}:
        stay -= wrong
    return [names[i] for i in sorted(stay)]


def traced_function(traced: Traced, name: str) -> Any:
    """Returns the traced function of a function `block_NAME` of the harness."""
    return getattr(traced, name.removesuffix("_constants"))
