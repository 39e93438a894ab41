"""One declaration gives every name, reference, type and limit."""

import sys
from dataclasses import dataclass, replace
from enum import IntEnum
from types import ModuleType
from typing import Any

import numpy
import pytest

from fmus.block import Block, NoValues, variable
from fmus.block.scalars import flatten, unflatten


class Mode(IntEnum):
    """A choice."""

    SLOW = 1
    FAST = 2


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(0.1, "Step", unit="s", min=1e-3, max=1.0, variability="fixed")
    mode: Mode = variable(Mode.SLOW, "Mode", variability="fixed")
    matrix: tuple = variable(((1.0, 2.0), (3.0, 4.0)), "Matrix", unit=(("m", "m/s"), ("m", "m/s")))


@dataclass(frozen=True)
class Inputs:
    count: int = variable(0, "Count", min=0, max=3)


@dataclass(frozen=True)
class State:
    x: float = 0.0
    pair: tuple = (0.0, (1.0, 2.0))


@dataclass(frozen=True)
class Outputs:
    active: bool = variable(False, "Active")


def output(*_: object) -> Outputs:
    return Outputs()


BLOCK = Block.of_module(__name__, "Tiny", "")


def test_vectors_and_matrices_become_scalars_in_row_order() -> None:
    names = [v.name for v in BLOCK.variables]
    assert names == [
        "internal_step", "mode", "matrix[1,1]", "matrix[1,2]", "matrix[2,1]", "matrix[2,2]",
        "count", "active",
    ]  # fmt: skip
    assert [v.value_reference for v in BLOCK.variables] == list(range(8))
    assert [v.unit for v in BLOCK.variables[2:6]] == ["m", "m/s", "m", "m/s"]


def test_the_class_decides_causality_and_the_type_decides_variability() -> None:
    by_name = {v.name: v for v in BLOCK.variables}
    assert (by_name["mode"].type, by_name["mode"].variability) == ("Enumeration", "fixed")
    assert (by_name["matrix[1,1]"].causality, by_name["matrix[1,1]"].variability) == ("parameter", "tunable")
    assert (by_name["count"].type, by_name["count"].variability) == ("Integer", "discrete")
    assert (by_name["active"].type, by_name["active"].initial) == ("Boolean", "calculated")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("internal_step", 2.0, "internal_step = 2.0: expected 0.001 to 1 s"),
        ("internal_step", float("nan"), "internal_step = nan: expected a finite number"),
        ("mode", 3, "mode = 3: expected one of 1 (slow), 2 (fast)"),
        ("count", -1, "count = -1: expected 0 to 3"),
    ],
)
def test_a_refused_value_is_named_with_what_was_expected(name: str, value: Any, message: str) -> None:
    declared = next(v for v in BLOCK.variables if v.name == name)
    assert declared.refuse(value) == message
    assert declared.refuse(declared.start) is None


def test_flatten_and_unflatten_are_inverse() -> None:
    state = State(5.0, (6.0, (7.0, 8.0)))
    assert flatten(state) == [5.0, 6.0, 7.0, 8.0]
    assert unflatten(State, flatten(state)) == state
    assert unflatten(replace(state, x=0.0), flatten(state)) == state


@pytest.mark.parametrize("count", [3, 5])
def test_a_wrong_number_of_scalars_is_refused(count: int) -> None:
    with pytest.raises(ValueError, match=f"{count} scalars are too"):
        unflatten(State, [0.0] * count)


def test_a_block_without_an_internal_step_is_given_one_that_starts_at_its_step_size() -> None:
    @dataclass(frozen=True)
    class Gain:
        gain: float = variable(2.0, "Gain")

    block = replace(BLOCK, parameters=Gain, step_size=0.5)
    gain, step = block.of_causality("parameter")
    assert (gain.name, step.name, step.start, step.unit) == ("gain", "internal_step", 0.5, "s")


def test_the_state_begins_as_it_is_declared() -> None:
    block = Block("Tiny", "", state=State, outputs=Outputs, output=lambda *_: Outputs())
    assert block.initial_state(0.0, None, None, None) == State()
    assert block.step(0.0, 0.1, State(5.0), None, None, None) == State(5.0)


def test_a_class_that_is_no_frozen_dataclass_or_by_its_base_alone_is_refused() -> None:
    """The fields that it adds to those of its base would be no variables."""

    @dataclass
    class Changeable:
        x: float = 0.0

    class More(State):
        y: float = 0.0

    for wrong in (Changeable, More):
        with pytest.raises(
            TypeError, match=r"'Tiny': state: expected a class with @dataclass\(frozen=True\)"
        ):
            replace(BLOCK, state=wrong)


def module(monkeypatch: pytest.MonkeyPatch, **members: Any) -> str:
    """Returns the name of a module with these members besides the classes of this one."""
    made = ModuleType("made")
    vars(made).update({"Outputs": Outputs, "output": output} | members)
    for member in vars(made).values():
        if getattr(member, "__module__", None) == __name__:
            monkeypatch.setattr(member, "__module__", "made")
    monkeypatch.setitem(sys.modules, "made", made)
    return "made"


def test_a_block_takes_what_its_module_defines(monkeypatch: pytest.MonkeyPatch) -> None:
    def step(*_: object) -> State:
        return State(2.0)

    block = Block.of_module(module(monkeypatch, State=State, step=step), "Made", "", inputs=Inputs)
    assert (block.state, block.inputs, block.outputs, block.step) == (State, Inputs, Outputs, step)
    assert (block.parameters.__name__, block.calculated) == ("NoValues", NoValues)


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"inital_state": lambda *_: State()}, "inital_state in made: expected initial_state"),
        ({"Input": Inputs}, "Input in made: expected Inputs"),
        ({"step": flatten}, "step is imported into made: expected step=step"),
        ({"output": None}, "expected output in made, above it"),
        ({"Outputs": None}, "expected Outputs in made, above it"),
    ],
)
def test_a_name_that_a_block_does_not_find_is_refused(
    monkeypatch: pytest.MonkeyPatch, members: dict[str, Any], message: str
) -> None:
    name = module(monkeypatch, **members)
    for absent in [own for own, member in members.items() if member is None]:
        del vars(sys.modules[name])[absent]
    with pytest.raises(TypeError, match=f"^block 'Made': {message}$"):
        Block.of_module(name, "Made", "")


def test_a_name_that_is_given_is_not_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A private name is none of a part, however like it is."""
    name = module(monkeypatch, step=flatten, Input=Inputs, _State=State)
    block = Block.of_module(name, "Made", "", step=flatten, inputs=Inputs)
    assert (block.step, block.inputs) == (flatten, Inputs)


def test_start_values_of_numpy_become_numbers_of_python() -> None:
    @dataclass(frozen=True)
    class Gains:
        one: float = variable(numpy.float64(2.0), "One")
        count: int = variable(numpy.int64(3), "Whole")  # pyright: ignore[reportAssignmentType]
        more: tuple[float, ...] = variable(tuple(numpy.linspace(0.0, 1.0, 3)), "More")

    starts = [
        v.start for v in replace(BLOCK, parameters=Gains, inputs=NoValues).of_causality("parameter")[:-1]
    ]
    assert starts == [2.0, 3, 0.0, 0.5, 1.0]
    assert [type(start) for start in starts] == [float, int, float, float, float]


def test_a_block_with_other_start_values_is_a_block_of_its_own() -> None:
    other = BLOCK.with_starts(
        __name__, "Other", "Another", {"internal_step": (0.5, "measured")}, stop_time=9.0
    )
    assert (other.name, other.description, other.stop_time, BLOCK.name) == ("Other", "Another", 9.0, "Tiny")
    assert BLOCK.variables[0].start == 0.1
    changed = {"start": 0.5, "source": "measured"}
    assert other.variables == (replace(BLOCK.variables[0], **changed), *BLOCK.variables[1:])
    assert other.parameters().internal_step == 0.5


def test_a_start_value_of_an_unknown_parameter_is_refused_with_the_nearest() -> None:
    with pytest.raises(
        TypeError, match="block 'Other': no parameter 'internal_stop'; nearest is 'internal_step'"
    ):
        BLOCK.with_starts(__name__, "Other", "", {"internal_stop": (0.5, "")})
