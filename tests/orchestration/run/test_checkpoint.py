"""A run that goes on from a checkpoint is the run that was never interrupted."""

from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.fmi.instance import FmuInstance
from orchestration.errors import FmuError, OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.run import simulate
from orchestration.run.checkpoint import Checkpoint, Checkpoints, read_checkpoint
from orchestration.scenarios import scenario
from orchestration.scenarios.declarations import fault
from orchestration.system.experiment import Algorithm, Event, Experiment
from orchestration.system.faults import Delay, Fault, Offset, Scale
from orchestration.system.signals import Cosine
from orchestration.system.system import LinearTransformation, System
from tests.orchestration.linear_systems import LOOP, RESUMABLE, alone, coupled
from tests.orchestration.runs import assert_same_bits, interrupt_at
from tests.shared_builds import Build


def npy() -> bytes:
    """An array, which is what NumPy's archives are made of."""
    stream = BytesIO()
    np.save(stream, np.zeros(3))
    return stream.getvalue()


_REST_S = 0.05  # simulated: the loop rests there, saves, and looks at interrupts


def interrupted(
    system: System, experiment: Experiment, path: Path, at: int, **options: Any
) -> tuple[Checkpoint, SimulationError]:
    """Run until communication point `at` is reached, and what is left of it."""
    checkpoints = Checkpoints(path, every=_REST_S)
    with pytest.raises(SimulationError, match="interrupted") as caught:
        simulate(system, experiment, interrupt_at(at), checkpoints=checkpoints, **options)
    return read_checkpoint(path), caught.value


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"algorithm": Algorithm.GAUSS_SEIDEL},
        {"extrapolation": 1, "step_sizes": {"two": 0.03}},
        {"tolerance": 1e-3, "step_size": 0.2},
        {"events": (Event(0.5, {"one.a": -3.0}), Event(1.7, {"one.a": -0.5}))},
        {"faults": (fault({"input": "two.u[1]", "kind": "delay", "delay": 0.3}, "here"),)},
    ],
    ids=lambda change: " ".join(change) or "plain",
)
def test_it_is_the_same_run_to_the_last_bit(linear: Build, tmp_path: Path, change: dict[str, Any]) -> None:
    system = coupled(linear, interpolates_inputs=True, **RESUMABLE)
    experiment = replace(Experiment(2.0, 0.01), **change)
    uninterrupted = simulate(system, experiment)
    points = len(uninterrupted.time)
    checkpoint, broken = interrupted(system, experiment, tmp_path / "checkpoint", points // 2)
    assert points // 2 <= checkpoint.position < points - 1
    assert_same_bits(broken.recording, uninterrupted, len(broken.recording.time))
    resumed = simulate(system, experiment, resume=checkpoint)
    assert_same_bits(resumed, uninterrupted)
    assert resumed.provenance == uninterrupted.provenance


@pytest.mark.usefixtures("vehicle_fmus")
def test_the_shipped_vehicle_goes_on_from_a_file_bit_for_bit(tmp_path: Path) -> None:
    """Controller, noise of the sensor and all, also to a later stop time."""
    chosen = scenario.load(scenario.find("nominal-extended"))
    experiment = replace(chosen.experiment, stop_time=12.0)
    path = tmp_path / "checkpoint"
    simulate(chosen.system, experiment, checkpoints=Checkpoints(path, every=5.0))
    checkpoint = read_checkpoint(path)
    assert checkpoint.position == round(10.0 / experiment.step_size)
    for longer in (experiment, replace(experiment, stop_time=13.0)):
        resumed = simulate(chosen.system, longer, resume=checkpoint)
        assert_same_bits(resumed, simulate(chosen.system, longer))


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"parameters": {"one.initial_state": 2.0}}, "parameters, inputs and events"),
        ({"algorithm": Algorithm.GAUSS_SEIDEL}, "the algorithm"),
        ({"tolerance": 1e-3}, "the algorithm"),
        ({"fmu_tolerance": 1e-3}, "the algorithm"),
        ({"step_size": 0.02}, "the communication points, the signals, the faults"),
        ({"record": ("one.y[1]",)}, "the record"),
        ({"signals": {"one.u[1]": Cosine(2.0, 1.0)}}, "the signals"),
        ({"events": (Event(0.1, {"one.a": -0.5}),)}, "parameters, inputs and events"),
        ({"faults": (Fault("one.u[1]", Offset(2.0)),)}, "the faults"),
        ({"faults": (Fault("one.u[1]", Delay(0.1)),)}, "the faults"),
        ({"faults": (Fault("one.u[1]", Scale(2.0)), Fault("one.u[1]", Offset(1.0)))}, "the faults"),
    ],
)
def test_another_past_is_refused(linear: Build, tmp_path: Path, change: dict[str, Any], what: str) -> None:
    system = alone(linear, **RESUMABLE)
    signals, faults = {"one.u[1]": Cosine(1.0, 1.0)}, (Fault("one.u[1]", Offset(1.0)),)
    experiment = Experiment(1.0, 0.01, signals=signals, faults=faults)
    checkpoint, _ = interrupted(system, experiment, tmp_path / "checkpoint", 60)
    with pytest.raises(SimulationError, match=f"belongs to another run, of which {what} differ"):
        simulate(system, replace(experiment, **change), resume=checkpoint)


def test_another_system_is_another_past(linear: Build, tmp_path: Path) -> None:
    experiment, fmus = Experiment(1.0, 0.01), coupled(linear, **RESUMABLE).components
    checkpoint, _ = interrupted(System(fmus, LOOP), experiment, tmp_path / "checkpoint", 50)
    others = {
        "connections": System(fmus, [(*LOOP[0], LinearTransformation(0.6)), LOOP[1]]),
        "FMUs": System({**fmus, "one": linear(a=-5.0, **RESUMABLE)}, LOOP),
    }
    for what, system in others.items():
        with pytest.raises(SimulationError, match=f"of which the {what} differ"):
            simulate(system, experiment, resume=checkpoint)


def test_fmus_must_serialise_their_state(linear: Build, tmp_path: Path) -> None:
    with pytest.raises(SystemDefinitionError, match="checkpoint: one, two cannot serialise its state"):
        simulate(coupled(linear), Experiment(1.0, 0.1), checkpoints=Checkpoints(tmp_path / "checkpoint"))


@pytest.mark.parametrize("content", [b"", b"PK\x05\x06" + bytes(18), b"text", npy()])
def test_a_damaged_or_missing_file_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "checkpoint"
    with pytest.raises(OrchestrationError, match=r"no checkpoint .*checkpoint"):
        read_checkpoint(path)
    path.write_bytes(content)
    with pytest.raises(OrchestrationError, match="checkpoint is not a checkpoint, or is damaged"):
        read_checkpoint(path)


def test_an_event_at_the_checkpoint_is_in_the_future(linear: Build, tmp_path: Path) -> None:
    """Saved before it is made, so that it may still be another."""
    system = alone(linear, **RESUMABLE)
    calm = Experiment(1.0, 0.1, inputs={"one.u[1]": 0.0})
    path = tmp_path / "checkpoint"
    changed = replace(calm, events=(Event(0.5, {"one.a": -30.0}),))
    simulate(system, changed, checkpoints=Checkpoints(path, every=0.5))
    checkpoint = read_checkpoint(path)
    assert checkpoint.time == pytest.approx(0.5)
    assert_same_bits(simulate(system, calm, resume=checkpoint), simulate(system, calm))


@pytest.mark.parametrize("start", [0.0, -5.0])
def test_checkpoints_are_as_far_apart_as_asked_wherever_time_begins(
    linear: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, start: float
) -> None:
    times: list[float] = []
    monkeypatch.setattr(Checkpoints, "save", lambda _, run: times.append(run.time))
    checkpoints = Checkpoints(tmp_path / "checkpoint", every=1.25)
    simulate(coupled(linear, **RESUMABLE), Experiment(start + 3.0, 0.125, start), checkpoints=checkpoints)
    assert times == [start + 1.25, start + 2.5]
    # an interval that is lost in the rounding of a time is a step
    times.clear()
    simulate(
        coupled(linear, **RESUMABLE),
        Experiment(start + 0.5, 0.125, start),
        checkpoints=Checkpoints(tmp_path / "checkpoint", every=1e-12),
    )
    assert times == [start + 0.125, start + 0.25, start + 0.375]


@pytest.mark.parametrize("saved", ["into a folder", "of an FMU that refuses its state"])
def test_what_cannot_be_saved_loses_no_recording(
    linear: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, saved: str
) -> None:
    def refuse(self: FmuInstance, state: int) -> bytes:
        raise FmuError(self.name, self.time, "fmi2SerializeFMUstate", "error", [])

    path = tmp_path
    if saved != "into a folder":
        path = tmp_path / "checkpoint"
        monkeypatch.setattr(FmuInstance, "serialize_fmu_state", refuse)
    system, checkpoints = coupled(linear, **RESUMABLE), Checkpoints(path)
    with pytest.raises(SimulationError, match=r"^interrupted; not saved: ") as caught:
        simulate(system, Experiment(1.0, 0.1), interrupt_at(1), checkpoints=checkpoints)
    assert len(caught.value.recording.time) == 2


def test_a_component_between_its_own_points_is_not_saved_at_the_end(linear: Build, tmp_path: Path) -> None:
    """Its last step was shorter than a longer run would make it."""
    system, checkpoints = coupled(linear, **RESUMABLE), Checkpoints(tmp_path / "checkpoint")
    experiment = Experiment(1.0, 0.1, step_sizes={"two": 0.3})
    with pytest.raises(SimulationError, match=r"not saved: at the end of the run components are between"):
        simulate(system, experiment, interrupt_at(10), checkpoints=checkpoints)


def test_a_part_of_another_shape_is_refused(linear: Build, tmp_path: Path) -> None:
    system, experiment = coupled(linear, **RESUMABLE), Experiment(1.0, 0.01)
    checkpoint, _ = interrupted(system, experiment, tmp_path / "checkpoint", 50)
    arrays = {**checkpoint.arrays, "bus": np.zeros(1)}
    with pytest.raises(SimulationError, match="the checkpoint is damaged: expected bus of shape"):
        simulate(system, experiment, resume=replace(checkpoint, arrays=arrays))
