"""Intermediate updates of FMI 3.0.2 (4.2.2): inputs that move in a step, outputs inside it, early return."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import pytest
from fmpy.fmi1 import FMICallException

from fmus.generate import builder

from .blocks import EVERYTHING, block_named, in_fmi3
from .exchanged import BALL, TANK
from .fmi3_instance import Fmi3Instance, scalars

Open = Callable[..., Fmi3Instance]
SET, GET = (True, False, False), (False, True, True)


class Update(NamedTuple):
    """What the callback is told; mode: whether inputs are asked for, outputs are there, the step is over."""

    t: float
    mode: tuple[bool, bool, bool]
    can_return_early: bool


class Updated:
    """An instance with intermediate updates, in each of which `act` is called; it returns when to end."""

    def __init__(self, open_fmi3: Open, name: str, early: bool = True, **values: list[Any]) -> None:
        self.updates: list[Update] = []
        self.act: Callable[[Update], float | None] = lambda update: None
        self.fmu = open_fmi3(name, intermediate_update=self._update, early_return_allowed=early)
        for variable, value in values.items():
            self.fmu[variable] = value
        self.fmu.begin()
        self.fmu.log.clear()

    def _update(self, environment: Any, t: float, *flags: Any) -> None:
        *given, requested, early_return_time = flags
        self.updates.append(Update(t, (given[0], given[1], given[2]), given[3]))
        early = self.act(self.updates[-1])
        if early is not None:
            requested[0], early_return_time[0] = True, early

    def step(self, t: float, h: float) -> tuple[bool, float]:
        """Makes a step; returns whether it ended early, and when."""
        *nothing, is_early, reached = self.fmu.fmu.doStep(t, h)
        assert nothing == [False, False]
        return is_early, reached


def intermediate(fmu: Fmi3Instance, causality: str) -> list[str]:
    """Names of variables that have intermediateUpdate, which FMPy does not read."""
    description = ElementTree.parse(Path(fmu.fmu.unzipDirectory) / "modelDescription.xml")
    marked = description.iterfind(f"ModelVariables/*[@causality='{causality}'][@intermediateUpdate='true']")
    return [v.attrib["name"] for v in marked]


@pytest.mark.parametrize("name", [*in_fmi3(builder.block_names()), EVERYTHING.name, BALL.name])
def test_updates_that_set_nothing_change_no_bit(open_fmi3: Open, name: str) -> None:
    """Of steps that are no multiple of the internal step; the last outputs in a step are those of its end."""
    block = block_named(name)
    plain, updated = open_fmi3(name).begin(), Updated(open_fmi3, name)
    outputs = intermediate(updated.fmu, "output")
    (internal,) = plain["internal_step"]
    seen: dict[str, Any] = {}

    def read(update: Update) -> None:
        if update.mode == GET:
            seen.update({name: updated.fmu[name] for name in outputs})

    updated.act = read
    t = 0.0
    for i in range(40):
        h = (0.3, 2.7, 6.9)[i % 3] * internal
        assert plain.fmu.doStep(t, h) == (False, False, False, t + h)
        assert updated.step(t, h) == (False, t + h)
        t += h
        assert scalars(updated.fmu, block, "output") == scalars(plain, block, "output")
        assert seen == {name: plain[name] for name in outputs}
        assert updated.updates[-1] == Update(t, GET, False)
    assert outputs


def test_outputs_inside_a_step_are_those_of_short_steps(open_fmi3: Open) -> None:
    """Binary fractions, so that internal times are the same numbers."""
    values: dict[str, Any] = {"internal_step": [0.125], "initial_state": [0.5, -1.0]}
    plant, short = Updated(open_fmi3, "ExamplePlant", **values), open_fmi3("ExamplePlant")
    for name, value in values.items():
        short[name] = value
    short.begin()

    def told(fmu: Fmi3Instance) -> Any:
        return fmu["state"], fmu["output"]

    seen: list[Any] = []
    plant.act = lambda update: seen.append((update.t, told(plant.fmu))) if update.mode == GET else None
    plant.step(0.0, 0.5)
    expected = []
    for i in range(4):
        short.fmu.doStep(0.125 * i, 0.125)
        expected.append((0.125 * (i + 1), told(short)))
    assert seen == expected
    middles = [update.t for update in plant.updates if update.mode == SET]
    assert middles == [0.0625, 0.1875, 0.3125, 0.4375]
    assert [update.mode for update in plant.updates] == 4 * [SET, GET]


def test_a_ramp_by_updates_converges_to_the_closed_form_with_the_second_order(open_fmi3: Open) -> None:
    """x'' = t, so x(1) = 1/6 and x'(1) = 1/2; with the input held at its middle, each internal step of h has
    h^3/4 in place of h^3/6 in x and the right x', so the error of x(1) is h^2/12."""
    for h in (0.25, 0.125, 0.0625):
        plant = Updated(
            open_fmi3, "ExamplePlant", internal_step=[h], state_matrix=[0.0, 1.0, 0.0, 0.0], theta=[0.0, 0.0]
        )

        def ramp(update: Update, plant: Updated = plant) -> None:
            if update.mode == SET:
                plant.fmu["control"] = [update.t]

        plant.act = ramp
        plant.step(0.0, 1.0)
        x, rate = plant.fmu["state"]
        assert rate == pytest.approx(0.5, rel=1e-14)
        assert x - 1.0 / 6.0 == pytest.approx(h**2 / 12.0, rel=1e-11)  # rounding of x, about 1e-16


def test_inputs_stay_as_set_last_and_a_value_out_of_range_is_discarded(open_fmi3: Open) -> None:
    """x' = force valve + 1 - x / 2 + t, two explicit steps; the second input is refused."""
    block = Updated(open_fmi3, EVERYTHING.name)
    valve, statuses = block.fmu.reference("valve"), []
    block.fmu["force"] = [2.0]

    def act(update: Update) -> None:
        if update.mode == SET:
            statuses.append(block.fmu.status("setFloat64", [valve], [0.75 + 8.0 * update.t]))

    block.act = act
    block.step(0.0, 0.05)
    block.step(0.05, 0.05)
    assert (statuses, block.fmu["valve"]) == (["ok", "discard"], [0.95])
    x = 1.0
    for i in range(2):
        x += 0.05 * (2.0 * 0.95 + 1.0 - 0.5 * x + 0.05 * i)
    assert block.fmu["y"] == [pytest.approx(8.0 * x, rel=1e-14)]


@pytest.mark.parametrize(
    ("wanted", "reached", "calls"),
    [(0.0, 0.125, 2), (0.125, 0.125, 2), (0.5, 0.5, 8), (0.6, 0.5, 8), (1.0, 1.0, 16), (2.0, 1.0, 16)],
)
def test_a_step_ends_early_at_the_last_internal_time_that_is_not_later_than_wanted(
    open_fmi3: Open, wanted: float, reached: float, calls: int
) -> None:
    """And goes on from there as if the step had been that long."""
    plant, plain = Updated(open_fmi3, "ExamplePlant", internal_step=[0.125]), open_fmi3("ExamplePlant")
    plain["internal_step"] = [0.125]
    for fmu in (plant.fmu, plain.begin()):
        fmu["control"] = [1.0]
    plant.act = lambda update: wanted if update.t == 0.125 else None
    assert plant.step(0.0, 1.0) == (reached < 1.0, reached)
    assert (plant.fmu["time"], len(plant.updates)) == ([reached], calls)
    assert [u.can_return_early for u in plant.updates] == [u.mode == GET and u.t < 1.0 for u in plant.updates]
    plain.fmu.doStep(0.0, reached)
    for h in (0.5, 0.125):
        assert plant.fmu["state"] == plain["state"]
        assert plant.step(reached, h) == (False, reached + h)
        plain.fmu.doStep(reached, h)
        reached += h
    assert plant.fmu["state"] == plain["state"]


def test_a_step_does_not_end_early_unless_the_importer_can_have_that(open_fmi3: Open) -> None:
    plant = Updated(open_fmi3, "ExamplePlant", early=False, internal_step=[0.25])
    plant.act = lambda update: 0.25
    assert plant.step(0.0, 1.0) == (False, 1.0)
    assert {update.can_return_early for update in plant.updates} == {False}


_FORBIDDEN = [
    ("doStep", 0.0, 0.1),
    *((name,) for name in ("terminate", "reset", "exitInitializationMode", "getFMUState", "enterEventMode")),
    ("getDirectionalDerivative", [11], [1], [1.0]),
]
_TO_SET = "is not allowed in the state 'intermediate update mode, to set"
_NOT_INTERMEDIATE = "expected a variable with intermediateUpdate"


@pytest.mark.parametrize(
    ("mode", "call", "reason"),
    [
        *((mode, call, "") for mode in (SET, GET) for call in _FORBIDDEN),
        (SET, ("getFloat64", [11]), f"fmi3GetFloat64 {_TO_SET}"),
        (SET, ("getOutputDerivatives", [11], [1]), _TO_SET),
        (SET, ("setFloat64", [5], [1.0, 1.0]), f"theta[1]: {_NOT_INTERMEDIATE}"),
        (SET, ("setFloat64", [11], [1.0]), "output can not be set, it is calculated"),
        (GET, ("getOutputDerivatives", [11], [1]), "ExamplePlant has no derivatives of outputs"),
        (GET, ("setFloat64", [8], [1.0]), "is not allowed in the state 'intermediate update mode, to get"),
        (GET, ("getFloat64", [14]), f"time: {_NOT_INTERMEDIATE}"),
        (GET, ("getFloat64", [12]), f"state.x[1]: {_NOT_INTERMEDIATE}"),
    ],
)
def test_a_call_that_is_not_allowed_in_an_update_is_an_error_of_the_step_too(
    open_fmi3: Open, mode: Any, call: tuple[Any, ...], reason: str
) -> None:
    """It leaves the values of the last communication point, though some internal steps were made."""
    plant = Updated(open_fmi3, "ExamplePlant", internal_step=[0.125], initial_state=[0.5, 0.25])
    statuses: list[str] = []

    def act(update: Update) -> None:
        if update.mode == SET and update.t < 0.3:
            plant.fmu["control"] = [5.0]
        if update.mode == mode and update.t > 0.3:
            statuses.append(plant.fmu.status(*call))

    plant.act = act
    assert plant.fmu.status("doStep", 0.0, 0.5) == "error"
    assert statuses == ["error"]
    (_, _, first), (_, _, second) = plant.fmu.log
    assert reason in first
    assert second == "fmi3DoStep: a call in the intermediate update was an error"
    assert (plant.fmu["time"], plant.fmu["state"], plant.fmu["control"]) == ([0.0], [0.5, 0.25], [0.0])
    assert plant.fmu.status("doStep", 0.0, 0.5) == "error"
    assert plant.fmu.status("reset") == "ok"
    plant.act = lambda update: None
    plant.fmu.begin()
    assert plant.step(0.0, 0.5) == (False, 0.5)


@pytest.mark.parametrize("call", ["setFMUState", "freeFMUState", "serializeFMUState", "deserializeFMUState"])
def test_a_saved_state_is_not_used_in_an_update(open_fmi3: Open, call: str) -> None:
    plant = Updated(open_fmi3, "ExamplePlant")
    state = plant.fmu.fmu.getFMUState()
    argument = plant.fmu.fmu.serializeFMUState(state) if call.startswith("de") else state
    statuses: list[str] = []
    plant.act = lambda update: statuses.append(plant.fmu.status(call, argument))
    assert plant.fmu.status("doStep", 0.0, 1e-3) == "error"
    assert statuses == ["error"]
    assert "is not allowed in the state 'intermediate update mode" in plant.fmu.log[0][2]
    plant.fmu.fmu.setFMUState(state)
    plant.fmu.fmu.freeFMUState(state)


def test_an_instance_is_neither_freed_nor_reset_in_an_update(open_fmi3: Open) -> None:
    """Nor after an error in it."""
    plant = Updated(open_fmi3, "ExamplePlant")
    statuses: list[str] = []

    def act(update: Update) -> None:
        for _ in range(2):
            plant.fmu.fmu.fmi3FreeInstance(plant.fmu.fmu.component)
        statuses.append(plant.fmu.status("reset"))

    plant.act = act
    assert plant.fmu.status("doStep", 0.0, 1e-3) == "error"
    assert statuses == ["error"]
    texts = [text.partition(" is not allowed in the state ")[::2] for *_, text in plant.fmu.log]
    assert texts[:3] == [
        ("fmi3FreeInstance", "'intermediate update mode, to set inputs'"),
        ("fmi3FreeInstance", "'intermediate update mode, after an error'"),
        ("fmi3Reset", "'intermediate update mode, after an error'"),
    ]
    assert plant.fmu["time"] == [0.0]


@pytest.mark.parametrize(
    ("name", "mode", "variable"),
    [
        *((EVERYTHING.name, mode, name) for mode, name in ((SET, "level"), (GET, "level"))),
        *((EVERYTHING.name, GET, name) for name in ("steps", "high")),
        *((TANK.name, mode, name) for mode, name in ((SET, "opening"), (GET, "opening"), (GET, "shown"))),
    ],
)
def test_discrete_variables_are_neither_set_nor_read_in_updates(
    open_fmi3: Open, name: str, mode: Any, variable: str
) -> None:
    block = Updated(open_fmi3, name)
    given = block.fmu[variable]

    def act(update: Update) -> None:
        with contextlib.suppress(FMICallException):
            if update.mode == mode == SET:
                block.fmu[variable] = [2]
            elif update.mode == mode:
                block.fmu[variable]

    block.act = act
    assert block.fmu.status("doStep", 0.0, 0.1) == "error"
    assert f"{variable}: expected a variable with intermediateUpdate" in block.fmu.log[0][2]
    assert block.fmu[variable] == given


def test_a_step_that_is_discarded_leaves_the_instance_as_it_was(open_fmi3: Open) -> None:
    """An input is too much in the second internal step: the square of the state overflows."""
    block = Updated(open_fmi3, EVERYTHING.name)

    def act(update: Update) -> None:
        if update.mode == SET:
            block.fmu["force"], block.fmu["valve"] = [1e155], [1.0]

    block.act = act
    assert "not finite any more" in block.fmu.refused("doStep", 0.0, 0.3, status="discard")
    assert [update.t for update in block.updates] == pytest.approx([0.05, 0.1, 0.15])
    assert (block.fmu["force"], block.fmu["valve"], block.fmu["time"]) == ([0.0], [0.5], [0.0])
    block.act = lambda update: None
    assert block.step(0.0, 0.3) == (False, 0.3)
    text = block.fmu.refused("doStep", 0.3, 1e9)
    assert text == "fmi3DoStep: communication step size 1e+09 s: expected at most 1e+09 internal steps"


def test_intermediate_variables_are_continuous_inputs_and_outputs(open_fmi3: Open) -> None:
    """FMI 3.0.2, 2.3.1 and 2.4.7: of these an importer may require some at the instantiation."""
    fmu = open_fmi3(EVERYTHING.name)
    interface = fmu.description.coSimulation
    assert interface.providesIntermediateUpdate
    assert interface.canReturnEarlyAfterIntermediateUpdate
    assert intermediate(fmu, "input") == ["force", "valve", "wind"]
    assert intermediate(fmu, "output") == ["y", "square"]
    tank = open_fmi3(TANK.name)
    assert (intermediate(tank, "input"), intermediate(tank, "output")) == (["inflow"], ["level"])
    assert not any(intermediate(fmu, other) for other in ("parameter", "calculatedParameter", "independent"))


@pytest.mark.parametrize("required", [[8, 10, 11], [8, 12], [8, 5], [15], [0]])
def test_an_importer_may_require_intermediate_variables_alone(open_fmi3: Open, required: list[int]) -> None:
    plant = open_fmi3("ExamplePlant")
    plant.fmu.fmi3FreeInstance(plant.fmu.component)
    is_accepted = required == [8, 10, 11]
    with contextlib.nullcontext() if is_accepted else pytest.raises(Exception, match="Failed to instantiate"):
        plant.fmu.instantiate(
            loggingOn=True, logMessage=plant._message, requiredIntermediateVariables=required
        )
    texts = [text.partition(": ")[2] for *_, text in plant.log]
    assert texts == ([] if is_accepted else [f"value reference {required[-1]}: {_NOT_INTERMEDIATE}"])
