"""Signals that differ between the instances of an ensemble."""

import math
import os
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration import Constant, Cosine, Ensemble, Event, Experiment, Ramps, Simulator, System, Table
from orchestration.errors import SystemDefinitionError
from orchestration.system.signals import Signal
from tests.shared_builds import built_once, session_folder

REFERENCE, CURRENT = "controller.depth_reference", "plant.current_velocity"
CONNECTIONS = [("plant.measured_depth", "controller.measured_depth")]
CONNECTIONS += [(f"controller.voltage[{i}]", f"plant.voltage[{i}]") for i in (1, 2)]
DIVE = Experiment(
    stop_time=1.01,  # the last step is a shorter one
    step_size=0.02,
    signals={REFERENCE: Constant(0.1), "plant.roll": Cosine(0.1, 3.0), CURRENT: Constant(0.0)},
    open_inputs="start",
)


def of_user(t: float) -> float:
    return 0.1 * t


KINDS: list[Signal] = [
    Ramps([(0.0, 0.2), (0.5, 0.4)]),
    Cosine(0.3, 2.0),
    Table([0.0, 0.3], [0.1, 0.5], hold=True),
    math.sqrt,
    Constant(-0.0),
]
SIGNALS = (KINDS * 4)[:19]  # two groups and a part of one
INERTIAS = np.linspace(5.0, 7.0, len(SIGNALS)).tolist()


@pytest.fixture(scope="session")
def system(built: Mapping[str, Path], tmp_path_factory: pytest.TempPathFactory) -> System:
    """The vehicle and its controller, compiled for groups of instances once a session."""
    vehicle = System({"plant": built["RovDepthPlant"], "controller": built["L1DepthController"]}, CONNECTIONS)
    built_once(
        session_folder(tmp_path_factory, "ensemble") / "vehicle", lambda path: Ensemble(vehicle).close()
    )
    return vehicle


def of_one(experiment: Experiment, instance: int) -> Experiment:
    """The experiment of one instance of `VARY`."""
    own = {REFERENCE: SIGNALS[instance], CURRENT: SIGNALS[-1 - instance]}
    signals = {name: own.get(name, signal) for name, signal in experiment.signals.items()}
    return replace(experiment, parameters={"plant.inertia": INERTIAS[instance]}, signals=signals)


VARY: dict[str, Any] = {"plant.inertia": INERTIAS, REFERENCE: SIGNALS, CURRENT: SIGNALS[::-1]}


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"algorithm": "gauss-seidel", "start_time": 0.1},
        {"events": (Event(0.331, {"controller.depth_feedback_gain": 3.0}),)},  # between two points
        {"record": (CURRENT, "controller.tracking_error", REFERENCE, "plant.roll")},
    ],
)
def test_each_instance_has_the_bits_of_the_run_with_its_signals(system: System, more: dict[str, Any]) -> None:
    experiment = replace(DIVE, **more)
    with Ensemble(system) as ensemble, Simulator(system) as simulator:
        recorded = ensemble.run(experiment, VARY, threads=2)
        for instance in range(len(SIGNALS)):
            one, of_ensemble = simulator.run(of_one(experiment, instance)), recorded.run(instance)
            assert of_ensemble.values.tobytes() == one.values.tobytes()
            varied = of_ensemble.provenance.pop("varied")
            assert of_ensemble.provenance == one.provenance
            assert varied[REFERENCE] == repr(SIGNALS[instance])
            assert varied["plant.inertia"] == INERTIAS[instance]
        again = ensemble.run(experiment, {"plant.inertia": [6.0]}).run(0)
        alone = simulator.run(replace(experiment, parameters={"plant.inertia": 6.0}))
        assert again.values.tobytes() == alone.values.tobytes()  # the signals are those of the experiment


def test_provenance_tells_signals_apart(system: System) -> None:
    """By what is the same in every process: of a function its name, of a table every digit."""
    times = np.arange(2000.0)
    tables = [Table(times, np.where(times == 1000.0, value, 0.1)) for value in (0.2, 0.2 + 1e-12)]
    with Ensemble(system) as ensemble:
        recorded = ensemble.run(DIVE, {REFERENCE: [*tables, of_user]})
    texts = [recorded.run(instance).provenance["varied"][REFERENCE] for instance in range(3)]
    again = eval(texts[1], {"Table": Table, "array": np.array})
    assert (again.values.tolist(), again.hold) == (np.asarray(tables[1].values).tolist(), False)
    assert texts[0] != texts[1]
    assert texts[2] == "<function of_user>"


def test_instances_led_step_by_step_have_their_signals(system: System) -> None:
    """What is read has the value of the present point, also that of a connection."""
    names = [REFERENCE, "plant.voltage[1]", "plant.roll", "plant.depth"]
    vary = {name: values for name, values in VARY.items() if name != CURRENT}
    without = replace(DIVE, signals={REFERENCE: Constant(0.0), "plant.roll": Cosine(0.1, 3.0)})
    with Ensemble(system) as ensemble:
        run = ensemble.start(without, vary, len(SIGNALS), [CURRENT])
        read = [run.read(names)]
        while not run.is_done:
            run.step()
            read.append(run.read(names))
        recorded = run.recordings()
    for instance in (0, 3, 8, 18):
        own = replace(of_one(without, instance), inputs={CURRENT: 0.0}, record=names)
        with Simulator(system) as simulator:
            one = simulator.run(own)
        assert np.array(read)[:, :, instance].tobytes() == one.values.tobytes()
        assert recorded[REFERENCE][instance].tobytes() == one[REFERENCE].tobytes()


@pytest.mark.parametrize(
    ("vary", "problem"),
    [
        ({REFERENCE: KINDS, "plant.inertia": [5.0]}, "expected lists of one length"),
        ({REFERENCE: [KINDS[0], 0.3]}, f"{REFERENCE} = 0.3: expected a signal, as in the experiment"),
        ({"plant.pitch": KINDS}, "plant.pitch: it has no signal in the experiment: expected values"),
        ({"plant.voltage[1]": KINDS}, "expected a parameter or a constant input, got one that is driven"),
        (
            {REFERENCE: [KINDS[0], Constant(math.nan)]},
            f"instance 1: signal {REFERENCE} is nan at t = 0 s: expected a finite number",
        ),
        ({REFERENCE: [lambda t: 1.0 / t]}, f"instance 0: signal {REFERENCE}: ZeroDivisionError"),
    ],
)
def test_what_is_no_signal_of_an_instance_is_refused(
    system: System, vary: dict[str, Any], problem: str
) -> None:
    with Ensemble(system) as ensemble:
        with pytest.raises(SystemDefinitionError, match=re.escape(problem)):
            ensemble.run(DIVE, vary)
        assert not ensemble.run(DIVE, {REFERENCE: KINDS}).failures


def test_signals_count_as_memory(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    """8 instances of 52 points take 55.9 kB with one variable, and 3.3 kB more with each signal."""
    one = replace(DIVE, record=("plant.depth",))
    with Ensemble(system) as ensemble:
        monkeypatch.setattr(os, "sysconf", lambda _: 242, raising=False)  # 58.6 kB
        ensemble.run(one, {"plant.inertia": INERTIAS[:8]})
        with pytest.raises(SystemDefinitionError, match=r"8 instances of 52 .* of 1 variables and 2 signals"):
            ensemble.run(one, {REFERENCE: SIGNALS[:8], CURRENT: SIGNALS[:8]})
