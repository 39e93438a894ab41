"""Signals that differ between the instances of an ensemble."""

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orchestration import Constant, Cosine, Ensemble, Event, Experiment, Ramps, Simulator, System, Table
from orchestration.errors import SystemDefinitionError
from orchestration.many.ensemble_loop import Device
from orchestration.results.recording import on_host
from orchestration.system import experiment_checks
from orchestration.system.signals import Signal
from tests.orchestration.many.instances import CURRENT, REFERENCE, assert_same_bits, instances

DIVE = Experiment(
    stop_time=1.01,  # the last step is a shorter one
    step_size=0.02,
    signals={REFERENCE: Constant(0.1), "plant.roll": Cosine(0.1, 3.0), CURRENT: Constant(0.0)},
    open_inputs="start",
)


KINDS: list[Signal] = [
    Ramps([(0.0, 0.2), (0.5, 0.4)]),
    Cosine(0.3, 2.0),
    Table([0.0, 0.3], [0.1, 0.5], hold=True),
    Table([0.0, 0.3, 0.3, 0.9], [0.1, 0.3, -0.2, 0.0]),
    math.sqrt,
    Constant(-0.0),
]
SIGNALS = (KINDS * 4)[:19]  # two groups and a part of one
INERTIAS = np.linspace(5.0, 7.0, len(SIGNALS)).tolist()


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
def test_each_instance_has_the_bits_of_the_run_with_its_signals(
    system: System, more: dict[str, Any], device: Device | None
) -> None:
    experiments = instances(replace(DIVE, **more), VARY)
    with Ensemble(system, device=device) as ensemble, Simulator(system) as simulator:
        assert_same_bits(ensemble.run(experiments), simulator, experiments)
        alone = [replace(DIVE, **more)]  # the signals are those of the experiment again
        assert_same_bits(ensemble.run(alone), simulator, alone)


def test_instances_led_step_by_step_have_their_signals(system: System, device: Device | None) -> None:
    """What is read has the value of the present point, also that of a connection."""
    names = [REFERENCE, "plant.voltage[1]", "plant.roll", "plant.depth"]
    vary = {name: values for name, values in VARY.items() if name != CURRENT}
    without = replace(DIVE, signals={REFERENCE: Constant(0.0), "plant.roll": Cosine(0.1, 3.0)})
    with Ensemble(system, device=device) as ensemble:
        run = ensemble.start(instances(without, vary), [CURRENT])
        read = run.reader(*names)
        values = [read()]
        while not run.is_done:
            run.step()
            values.append(read())
        recorded = run.recording()
    for instance in (0, 3, 8, 18):
        own = replace(instances(without, vary)[instance], inputs={CURRENT: 0.0}, record=names)
        with Simulator(system) as simulator:
            one = simulator.run(own)
        assert (
            np.array([[on_host(v) for v in row] for row in values])[:, :, instance].tobytes()
            == one.values.tobytes()
        )
        assert on_host(recorded[REFERENCE][instance]).tobytes() == one[REFERENCE].tobytes()


@pytest.mark.parametrize(
    ("vary", "problem"),
    [
        ({REFERENCE: [KINDS[0], 0.3]}, f"instance 1: signal {REFERENCE}: TypeError"),
        ({"plant.pitch": KINDS}, "plant.pitch: expected a parameter"),
        (
            {REFERENCE: [KINDS[0], Constant(math.nan)]},
            f"instance 1: signal {REFERENCE} is nan at t = 0 s: expected a finite number",
        ),
        ({REFERENCE: [KINDS[0], lambda t: 1.0 / t]}, f"instance 1: signal {REFERENCE}: ZeroDivisionError"),
    ],
)
def test_what_is_no_signal_of_an_instance_is_refused(
    system: System, vary: dict[str, Any], problem: str, device: Device | None
) -> None:
    with Ensemble(system, device=device) as ensemble:
        with pytest.raises(SystemDefinitionError, match=re.escape(problem)):
            ensemble.run(instances(DIVE, vary))
        assert not ensemble.run(instances(DIVE, {REFERENCE: KINDS})).failures


def test_signals_count_as_memory(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    """8 instances of 52 points take 71.0 kB with one variable, and 3.3 kB more with each signal."""
    one = replace(DIVE, record=("plant.depth",))
    with Ensemble(system) as ensemble:
        monkeypatch.setattr(experiment_checks, "memory_size", lambda: 74_000)
        ensemble.run(instances(one, {"plant.inertia": INERTIAS[:8]}))
        with pytest.raises(SystemDefinitionError, match=r"8 instances of 52 .* of 1 variables and 2 signals"):
            ensemble.run(instances(one, {REFERENCE: SIGNALS[:8], CURRENT: SIGNALS[1:9]}))
