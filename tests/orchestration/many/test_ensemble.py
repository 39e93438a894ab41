"""Each instance of an ensemble has the bits of its own run; what an ensemble cannot run is refused."""

import math
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.block import Block, variable
from fmus.errors import ExportError
from fmus.files import write_archive
from fmus.fmi.description import describe
from fmus.fmi.instance import FmuInstance
from fmus.numerics import exp
from fmus.platforms import instruction_sets
from fmus.store import record_build
from orchestration import Ensemble, Event, Experiment, Fault, Offset, Ramps, Simulator, System
from orchestration.errors import EnsembleError, OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.many import ensemble_loop
from orchestration.many.ensemble import check_ensemble
from orchestration.many.ensemble_loop import Device
from orchestration.many.lane_library import LANES, lane_library
from orchestration.many.run_many import run_many
from orchestration.many.stepped_ensemble import EnsembleRecording
from tests.described_fmus import members
from tests.orchestration.many.instances import (
    CONNECTIONS,
    CURRENT,
    REFERENCE,
    assert_same_bits,
    built_for_ensembles,
    instances,
)

DIVE = Experiment(
    stop_time=4.01,  # the last step is a shorter one
    step_size=0.02,
    parameters={"controller.augmentation": "pi", "plant.sensor_noise": 0.002},
    signals={REFERENCE: Ramps([(0.0, 0.0), (1.0, 0.4), (10.0, 0.4)], smooth=False)},
    open_inputs="start",
)
CHANGE = Event(2.0, {"plant.buoyancy_change": 0.3, "controller.filter_bandwidth": 5.0})
HEAVIER = Event(2.0, {"plant.net_weight": 30.0, "plant.weight": 40.0})  # contradictory until both are set
STIFFER = Event(2.0, {"controller.depth_feedback_gain": 3.0})
WITHOUT_BUOYANCY = {"plant.net_weight": 29.2}  # of instances that weigh less
WEIGHTS = {"plant.weight": [29.5, 29.0, 29.43]}


def varied(count: int) -> dict[str, list[Any]]:
    """Parameters, seeds, start values, a choice of the law and a constant input, another of each instance."""
    draw = np.random.default_rng(7)
    return {
        "plant.inertia": draw.uniform(5.0, 7.0, count).tolist(),
        "plant.sensor_seed": draw.integers(1, 10_000, count).tolist(),
        "plant.initial_depth": draw.uniform(-0.02, 0.5, count).tolist(),
        "plant.thruster_rate_limit[1]": np.where(draw.random(count) < 0.5, 0.0, 30.0).tolist(),
        "plant.sensor_period": draw.choice([0.04, 0.06], count).tolist(),
        "plant.current_velocity": draw.normal(0.0, 0.05, count).tolist(),
        "controller.augmentation": draw.choice(["none", "pi"], count).tolist(),
    }


@pytest.mark.slow
def test_37_instances_have_the_bits_of_37_runs(system: System, device: Device | None) -> None:
    """37: four groups and a part of one."""
    experiments = instances(DIVE, varied(37))
    with Ensemble(system, device=device) as ensemble, Simulator(system) as simulator:
        assert_same_bits(ensemble.run(experiments), simulator, experiments)


@pytest.mark.parametrize(
    "more",
    [
        {"algorithm": "gauss-seidel"},
        {"events": (CHANGE,)},
        {"events": (HEAVIER,)},
        {"events": (STIFFER,), "record": ("controller.feedforward_gain", "plant.depth")},  # calculated
        {"events": (Event(DIVE.stop_time, {"plant.net_weight": 50.0}),)},  # no step takes it
        {"step_size": 0.05},  # internal steps
        {"start_time": 1.0, "record": ("plant.inertia", "controller.depth_reference", "plant.sensor_ideal")},
    ],
)
def test_other_experiments_too(system: System, more: dict[str, Any], device: Device | None) -> None:
    experiments = instances(replace(DIVE, **more), varied(3))
    with Ensemble(system, device=device) as ensemble, Simulator(system) as simulator:
        assert_same_bits(ensemble.run(experiments), simulator, experiments)


def test_a_signal_has_a_row_for_each_instance(system: System) -> None:
    with Ensemble(system) as ensemble:
        recorded = ensemble.run(instances(DIVE, {"plant.initial_depth": [0.0, 0.1, 0.2]}))
    assert recorded["plant.depth"].shape == (3, len(recorded.time))
    assert recorded["plant.depth"][:, 0].tolist() == [0.0, 0.1, 0.2]
    with pytest.raises(OrchestrationError, match=r"nearest is 'plant\.depth'"):
        recorded["plant.dept"]


def test_a_run_within_a_run_is_refused(system: System) -> None:
    refusals: list[str] = []

    with Ensemble(system) as ensemble:

        def start_another(t: float) -> float:
            for another in (lambda: ensemble.run([DIVE]), lambda: ensemble.start([DIVE], [CURRENT])):
                with pytest.raises(OrchestrationError, match="this ensemble is running") as refusal:
                    another()
                refusals.append(str(refusal.value))
            return 0.0

        assert not ensemble.run([replace(DIVE, signals={REFERENCE: start_another})]).failures
    assert refusals


def test_without_a_compiler_the_ensemble_is_refused(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise ExportError("no compiler")

    monkeypatch.setattr(ensemble_loop, "load_compiled", refuse)
    ensemble_loop.loop_library.cache_clear()
    with pytest.raises(EnsembleError, match=r"no compiler.*Simulator"):
        Ensemble(system)


def failed(system: System, device: Device | None, experiments: Sequence[Experiment]) -> EnsembleRecording:
    """An ensemble of which only the instance of index 1 fails, and the others have the bits of their runs."""
    with Ensemble(system, device=device) as ensemble, Simulator(system) as simulator:
        recorded = ensemble.run(experiments)
        assert list(recorded.failures) == [1]
        for instance in (0, 2):
            one = simulator.run(experiments[instance])
            assert recorded.run(instance).values.tobytes() == one.values.tobytes()
    return recorded


def test_an_instance_that_cannot_begin_is_named_and_disturbs_no_other(
    system: System, device: Device | None
) -> None:
    weights = {"plant.net_weight": [-1.0, 30.0, -1.2], "plant.weight": [29.0, 29.0, 29.43]}
    recorded = failed(system, device, instances(DIVE, weights))
    assert "net_weight" in recorded.failures[1]
    assert np.isnan(recorded["plant.depth"][1]).all()
    assert len(recorded.run(1).time) == 0


@dataclass(frozen=True)
class Growth:
    a: float = variable(1.0, "Growth in a step")


@dataclass(frozen=True)
class Limited:
    u: float = variable(0.0, "Input with a range", max=5.0)


@dataclass(frozen=True)
class Steps:
    count: float = 0.0


@dataclass(frozen=True)
class Exponential:
    y: float = variable(1.0, "exp(a count)")


GROWING = Block(
    "Growing",
    "An output that soon is infinite, of a state that is not",
    parameters=Growth,
    inputs=Limited,
    state=Steps,
    outputs=Exponential,
    step=lambda t, h, state, u, p, c: Steps(state.count + 1.0),
    output=lambda t, state, p, c: Exponential(exp(p.a * state.count)),
    step_size=0.1,
)


@pytest.fixture(scope="module")
def growing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built_for_ensembles(tmp_path_factory.mktemp("growing"), GROWING)


@pytest.mark.slow
def test_an_instance_whose_output_becomes_infinite_fails_though_its_state_is_finite(
    growing: Path, device: Device | None
) -> None:
    """exp(300 n) from n = 3 on."""
    experiment = Experiment(0.5, 0.1, open_inputs="start")
    recorded = failed(System({"one": growing}), device, instances(experiment, {"one.a": [1.0, 300.0, -0.5]}))
    assert recorded.counts.tolist() == [6, 3, 6]


def test_an_fmu_that_was_built_without_equations_for_vectors_runs_in_simulators(
    growing: Path, tmp_path: Path
) -> None:
    """Unless an ensemble is asked for; the reason is one line."""
    content = {name: data for name, data in members(growing).items() if "model_lanes" not in name}
    older = write_archive(tmp_path / "Growing.fmu", content)
    record_build(older.read_bytes())
    system, experiment = System({"one": older}), Experiment(0.5, 0.1, open_inputs="start")
    reason = (
        r"^one: no ensemble of .*Growing.fmu, which has no sources/model_lanes\.h: build it again.*runs it$"
    )
    with pytest.raises(EnsembleError, match=reason):
        Ensemble(system)
    with pytest.raises(EnsembleError, match=reason):
        check_ensemble(system, experiment, 10**9)
    experiments = [replace(experiment, parameters={"one.a": a}) for a in np.linspace(0.0, 1.0, LANES)]
    expected = run_many(System({"one": growing}), experiments, where="vectors")
    for recorded, one in zip(run_many(system, experiments), expected, strict=True):
        assert recorded.values.tobytes() == one.values.tobytes()
    with pytest.raises(EnsembleError, match=reason):
        list(run_many(system, experiments, where="vectors"))


def test_the_range_of_an_input_is_that_of_values_it_is_given_not_of_the_last_point(
    growing: Path, device: Device | None
) -> None:
    """5.5 at 0.5 s, where nothing is set any more; and where it is, it ends the instance."""
    system = System({"one": growing, "two": growing}, [("one.y", "two.u")])
    beyond = {"one.a": [math.log(5.5) / 5.0, 0.1]}
    experiment = Experiment(0.5, 0.1, open_inputs="start")
    experiments = instances(experiment, beyond)
    with Ensemble(system, device=device) as ensemble, Simulator(system) as simulator:
        assert_same_bits(recorded := ensemble.run(experiments), simulator, experiments)
        longer = ensemble.run([replace(one, stop_time=0.6) for one in experiments])
    assert not recorded.failures
    assert [*longer.failures] == [0]
    assert longer.counts.tolist() == [6, 7]


def test_of_two_reasons_at_one_point_the_first_is_named(growing: Path, device: Device | None) -> None:
    """At 0.1 s exp(400) goes beyond the range of the input, and the step that follows makes exp(800)."""
    system = System({"one": growing, "two": growing}, [("one.y", "two.u")])
    experiments = instances(Experiment(0.5, 0.1, open_inputs="start"), {"one.a": [0.1, 400.0]})
    with Ensemble(system, device=device) as ensemble:
        recorded = ensemble.run(experiments)
    assert [*recorded.failures] == [1]
    assert recorded.failures[1].startswith("one.y -> two.u at t = 0.1 s: ")


def test_an_initial_value_beyond_all_numbers_ends_one_instance_without_a_warning(
    system: System, device: Device | None
) -> None:
    scaled = System(system.components, [(*CONNECTIONS[0], {"factor": 1e308})])
    vary = {"plant.initial_depth": [0.0, 20.0], "plant.sensor_noise": [0.0, 0.0]}
    with Ensemble(scaled, device=device) as ensemble, warnings.catch_warnings():
        warnings.simplefilter("error")
        recorded = ensemble.run(instances(replace(DIVE, stop_time=0.02), vary))
    assert "measured_depth" in recorded.failures[1]


def test_a_run_that_is_refused_leaves_the_next_one_as_it_is(system: System) -> None:
    """Some of its values were set before an FMU refused another one of the same component."""
    no_item = {"controller.filter_bandwidth": 2.0, "controller.augmentation": 77}
    with Ensemble(system) as ensemble:
        expected = ensemble.run(instances(DIVE, WEIGHTS))
        with pytest.raises(OrchestrationError, match="augmentation = 77"):
            ensemble.run(instances(replace(DIVE, parameters=no_item), WEIGHTS))
        again = ensemble.run(instances(DIVE, WEIGHTS))
    assert again.values.tobytes() == expected.values.tobytes()


@pytest.mark.parametrize("weights", [[30.0, 29.0], [29.0, 30.0], [29.5] * 11])
def test_recordings_of_all_that_did_not_fail_are_in_c_order(system: System, weights: list[float]) -> None:
    """As one run has them: where a sum along time rounds."""
    with Ensemble(system) as ensemble:
        net = {"plant.net_weight": [29.2] * len(weights)}
        recorded = ensemble.run(instances(DIVE, {"plant.weight": weights, **net}))
    together = recorded.recordings()
    assert recorded.complete == [i for i, weight in enumerate(weights) if weight > 29.2]
    for run, instance in enumerate(recorded.complete):
        assert together.run(run).values.tobytes() == recorded.run(instance).values.tobytes()
    assert {together[name].strides[-1] for name in together.names} == {8}
    assert (together.run_count, len(together.time)) == (len(recorded.complete), len(recorded.time))


def test_the_state_of_another_fmu_is_refused(system: System) -> None:
    controller, plant = system.components["controller"], system.components["plant"]
    library = lane_library("plant", plant, instruction_sets()[0])
    with (
        FmuInstance("controller", controller, describe(controller)) as instance,
        pytest.raises(EnsembleError, match="built again"),
    ):
        library.values(instance.serialize_fmu_state(instance.get_fmu_state()))


@pytest.mark.parametrize(
    ("experiment", "vary"),
    [
        (replace(DIVE, events=(Event(2.0, WITHOUT_BUOYANCY),)), WEIGHTS),
        (
            replace(DIVE, parameters={**DIVE.parameters, "plant.sensor_noise": 0.0}),
            {"plant.initial_depth": [0.0, 1e300, 0.1]},
        ),
    ],
    ids=["parameters that become contradictory", "a voltage beyond its input's range"],
)
def test_an_instance_that_cannot_go_on_ends_where_its_own_run_ends(
    system: System, device: Device | None, experiment: Experiment, vary: dict[str, Any]
) -> None:
    experiments = instances(experiment, vary)
    recorded = failed(system, device, experiments)
    with Simulator(system) as simulator, pytest.raises(SimulationError) as error:
        simulator.run(experiments[1])
    ended = error.value.recording
    assert recorded.run(1).values.tobytes() == ended.values.tobytes()
    assert np.isnan(recorded["plant.depth"][1, len(ended.time) :]).all()
    assert f" at t = {ended.time[-1]:.9g} s: " in recorded.failures[1]


@pytest.mark.parametrize(
    ("more", "name"),
    [
        ({"extrapolation": 1}, "extrapolation"),
        ({"tolerance": 1e-3, "stop_time": 4.0}, "tolerance"),
        ({"step_sizes": {"controller": 0.04}}, "step_sizes"),
        ({"faults": (Fault("controller.measured_depth", Offset(0.1)),)}, "faults"),
        ({"error_estimate": True, "stop_time": 4.0}, "error_estimate"),
    ],
)
def test_what_only_a_simulator_has_is_refused(system: System, more: dict[str, Any], name: str) -> None:
    with Ensemble(system) as ensemble, pytest.raises(EnsembleError, match=f"{name}: .*Simulator"):
        ensemble.run(instances(replace(DIVE, **more), varied(2)))


@pytest.mark.parametrize(
    ("vary", "problem"),
    [
        ({"plant.inertia": [5.0, -1.0]}, "plant.inertia = -1.0: expected 0.1 to 1e"),
        ({"controller.augmentation": ["none", 7]}, "controller.augmentation = 7: expected one of none (1), "),
        ({"plant.inerta": [5.0]}, "nearest is 'plant.inertia'"),
        ({"plant.voltage[1]": [1.0]}, "plant.voltage[1]: expected a parameter"),
        ({"plant.internal_step": [0.02, 0.01]}, "plant.internal_step: expected one for all"),
    ],
)
def test_what_cannot_differ_is_refused(
    system: System, vary: dict[str, Any], problem: str, device: Device | None
) -> None:
    with Ensemble(system, device=device) as ensemble:
        with pytest.raises(SystemDefinitionError, match=re.escape(problem)):
            ensemble.run(instances(DIVE, vary))
        assert not ensemble.run([DIVE, DIVE]).failures


@pytest.mark.parametrize(
    "experiments", [[], [DIVE, replace(DIVE, stop_time=2.0)], [DIVE, *instances(DIVE, {CURRENT: [0.1]})]]
)
def test_experiments_that_differ_in_more_than_values_are_refused(
    system: System, experiments: list[Experiment]
) -> None:
    problem = f"got {len(experiments)} experiments: expected at least one, which differ in values"
    with Ensemble(system) as ensemble, pytest.raises(SystemDefinitionError, match=problem):
        ensemble.run(experiments)


def test_unknown_instructions_are_refused(system: System) -> None:
    with pytest.raises(EnsembleError, match=r"instructions 'x86-64-v33': this processor has .*portable"):
        Ensemble(system, "x86-64-v33")
