"""What FMUs cannot do or take is refused before they are loaded."""

import math
from pathlib import Path
from typing import Any

import pytest

from orchestration.errors import SystemDefinitionError
from orchestration.run import Simulator, simulate
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import prepare
from orchestration.system.system import System
from tests.described_fmus import described, redescribed
from tests.shared_builds import Fmus


def test_a_signal_that_raises_is_named_before_the_run(foreign: Fmus) -> None:
    def broken(t: float) -> float:
        if t > 0.25:
            raise RuntimeError("no more data")
        return 0.0

    with pytest.raises(SystemDefinitionError, match=r"signal lag.u: RuntimeError\('no more data'\)"):
        simulate(System({"lag": foreign["Lag"]}), Experiment(1.0, 0.1, signals={"lag.u": broken}))


def _edited(path: Path, folder: Path, *changes: tuple[str, str]) -> Path:
    """A copy of an FMU with another model description."""

    def edit(text: str) -> str:
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        return text

    return redescribed(path, folder / f"edited_{path.name}", edit)


def test_what_an_fmu_cannot_do_is_said_before_it_is_loaded(foreign: Fmus, tmp_path: Path) -> None:
    fixed = _edited(
        foreign["Lag"], tmp_path,
        ('canHandleVariableCommunicationStepSize="true"', 'canHandleVariableCommunicationStepSize="false"'),
        ('canBeInstantiatedOnlyOncePerProcess="false"', 'canBeInstantiatedOnlyOncePerProcess="true"'),
    )  # fmt: skip
    with pytest.raises(SystemDefinitionError, match=r"one cannot vary its step size"):
        simulate(System({"one": fixed}), Experiment(1.05, 0.1, inputs={"one.u": 0.0}))
    both = Experiment(1.0, 0.1, inputs={"one.u": 0.0, "two.u": 0.0})
    with pytest.raises(SystemDefinitionError, match=r"one, two: expected one instance"):
        simulate(System({"one": fixed, "two": fixed}), both)


def test_a_run_that_the_caller_leads_has_no_estimate(foreign: Fmus) -> None:
    experiment = Experiment(1.0, 0.1, inputs={"one.u": 0.0}, error_estimate=True)
    with Simulator(System({"one": foreign["Lag"]})) as simulator:
        with pytest.raises(SystemDefinitionError, match="error_estimate of a run that the caller leads"):
            simulator.start(experiment)
        assert "error_estimate" in simulator.run(experiment).provenance


def test_a_constant_cannot_be_set(tmp_path: Path) -> None:
    fmu = described(tmp_path / "own.fmu", outputs=["y"], parameters=["k"])
    constant = _edited(
        fmu, tmp_path,
        ('causality="output" variability="continuous"><Real', 'causality="output" variability="constant" '
         'initial="exact"><Real start="-2.5"'),
    )  # fmt: skip
    system = System({"own": constant})
    message = r"own\.y: expected a parameter, or a variable with .*, got a constant$"
    with pytest.raises(SystemDefinitionError, match=message):
        prepare(system, Experiment(1.0, 0.1, parameters={"own.y": -3.0}))
    assert prepare(system, Experiment(1.0, 0.1, parameters={"own.k": -3.0})).settings[0][1] == -3.0


def test_a_range_and_unit_that_only_the_declared_type_states_count(foreign: Fmus, tmp_path: Path) -> None:
    types = (
        '<UnitDefinitions><Unit name="K"><BaseUnit K="1"/></Unit></UnitDefinitions><TypeDefinitions>'
        '<SimpleType name="T"><Real unit="K" max="5.0"/></SimpleType></TypeDefinitions>'
    )
    typed = _edited(
        foreign["Lag"], tmp_path,
        ("<LogCategories>", types + "<LogCategories>"),
        ('<Real start="0"', '<Real declaredType="T" start="0"'),
    )  # fmt: skip
    with pytest.raises(SystemDefinitionError, match=r"lag.u = 7.0: expected at most 5 K"):
        simulate(System({"lag": typed}), Experiment(1.0, 0.1, inputs={"lag.u": 7.0}))


def test_an_fmu_without_units_connects_to_one_with(foreign: Fmus, built: Fmus) -> None:
    system = System(
        {"lag": foreign["Lag"], "p": built["ExamplePlant"]}, (("lag.y", "p.control"), ("p.output", "lag.u"))
    )
    run = simulate(system, Experiment(0.1, 0.01, inputs={"p.disturbance": 0.0}))
    assert run["p.output"][-1] != 0.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"step_sizes": {"t": math.inf}}, "step size of t, inf s: expected a multiple"),
        ({"inputs": {"t.a": 2**40, "t.b": False}}, r"1099511627776: expected -2147483648 to 2147483647"),
    ],
)
def test_what_no_fmu_can_take_is_refused_before_the_run(
    foreign: Fmus, settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(SystemDefinitionError, match=message):
        simulate(
            System({"t": foreign["Types"]}),
            Experiment(1.0, 0.1, **{"inputs": {"t.a": 1, "t.b": False}, **settings}),
        )
