"""Instances that are led step by step have the bits of a simulator that is led so."""

from dataclasses import replace

import numpy as np
import pytest

from orchestration import Ensemble, Event, Experiment, Ramps, Simulator, System
from orchestration.errors import OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.many.ensemble_loop import Device
from tests.orchestration.many.instances import CURRENT, instances

EFFICIENCY = "plant.thruster_efficiency[1]"
INERTIA = "plant.inertia"
DIVE = Experiment(
    stop_time=0.99,  # the last step is a shorter one
    step_size=0.02,
    signals={"controller.depth_reference": Ramps([(0.0, 0.0), (0.5, 0.4), (1.0, 0.4)], smooth=False)},
    events=(Event(0.3, {"controller.depth_feedback_gain": 3.0}), Event(0.99, {"plant.linear_damping": 9.0})),
    record=(
        "plant.depth",
        "controller.voltage[1]",
        CURRENT,
        "controller.depth_reference",
        "plant.linear_damping",
    ),
    open_inputs="start",
)
READ = ["plant.depth", "controller.voltage[2]", CURRENT, INERTIA]
INERTIAS = [5.0, 5.5, 7.0]


@pytest.mark.parametrize("inputs", [{}, {CURRENT: 0.1}])
def test_every_step_has_the_bits_of_a_simulator(
    system: System, inputs: dict[str, float], device: Device | None
) -> None:
    """Three instances, another inertia of each and another current at each step."""
    experiment, currents = replace(DIVE, inputs=inputs), np.random.default_rng(2).normal(0.0, 0.1, (60, 3))
    with Ensemble(system, device=device) as ensemble:
        run = ensemble.start(instances(experiment, {INERTIA: INERTIAS}), [CURRENT])
        read_all, write = run.reader(*READ), run.writer(CURRENT)
        read, points, until_then = [read_all()], [run.time], run.recording()
        while not run.is_done:
            if run.point:  # the first step has the first value
                write(currents[run.point])
            run.step()
            if run.point == 25:
                until_then = run.recording()
            read.append(read_all())
            points.append(run.time)
        recorded = run.recording()
        half = [until_then.run(i).values.tobytes() for i in range(3)]  # later steps did not change it
    for instance, inertia in enumerate(INERTIAS):
        with Simulator(system) as simulator:
            own = replace(experiment, parameters={INERTIA: inertia})
            run = simulator.start(own, external=[CURRENT])
            values = run.reader(*READ[:2], READ[3])
            for point in range(len(points) - 1):
                if point == 25:
                    assert run.recording().values.tobytes() == half[instance]
                if point:
                    run.set(CURRENT, currents[point, instance])
                assert values() == tuple(read[point][i][instance] for i in (0, 1, 3))
                assert run.time == points[point]
                run.step()
            one, of_ensemble = run.recording(), recorded.run(instance)
            assert of_ensemble.values.tobytes() == one.values.tobytes()
            assert of_ensemble.time.tolist() == one.time.tolist() == points


def test_what_is_set_has_the_range_of_the_input(system: System, device: Device | None) -> None:
    with Ensemble(system, device=device) as ensemble:
        run = ensemble.start([DIVE] * 9, [EFFICIENCY])
        read, write = run.reader(EFFICIENCY), run.writer(EFFICIENCY)
        for wrong in (np.nan, 1.5):
            with pytest.raises(SystemDefinitionError, match=r"plant\.thruster_efficiency\[1\] = .*expected"):
                write(np.array([*[0.5] * 8, wrong]))
        assert read().tolist() == [1.0] * 9
        values = np.linspace(0.0, 1.0, 9)
        write(values)
        assert read().tolist() == values.tolist()


def test_a_refused_write_sets_nothing(system: System) -> None:
    halves = np.array([0.5, 0.5])
    with Ensemble(system) as ensemble:
        run = ensemble.start([DIVE] * 2, [CURRENT, EFFICIENCY])
        read, write = run.reader(CURRENT, EFFICIENCY), run.writer(CURRENT, EFFICIENCY)
        before = np.array(read()).tolist()
        for wrong, message in (
            (np.array([0.5, 7.0]), "= 7.0: expected"),
            (np.array([0.5]), r"efficiency\[1\]: shape \(1,\): expected \(instances,\) = \(2,\)"),
        ):
            with pytest.raises(SystemDefinitionError, match=message):
                write(halves, wrong)
            assert np.array(read()).tolist() == before
        write(np.array([0.1, 0.2]), np.array([0.3, 0.4]))
        assert np.array(read()).tolist() == [[0.1, 0.2], [0.3, 0.4]]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (INERTIA, "inertia: expected an external input: plant.current_velocity"),
        ("plant.depth", "writer: plant.depth: expected an external input"),
        ("plant.inertai", "no variable 'plant.inertai'; nearest is 'plant.inertia'"),
    ],
)
def test_only_external_inputs_are_set(system: System, name: str, message: str) -> None:
    with Ensemble(system) as ensemble:
        run = ensemble.start([DIVE], [CURRENT])
        with pytest.raises(SystemDefinitionError, match=message):
            run.writer(CURRENT, name)
        with pytest.raises(SystemDefinitionError, match=r"reader: no variable 'plant\.dept'; nearest is"):
            run.reader("plant.dept")


def test_there_is_no_step_beyond_the_end(system: System) -> None:
    with Ensemble(system) as ensemble:
        run = ensemble.start([replace(DIVE, stop_time=0.02, events=())], [CURRENT])
        run.step()
        with pytest.raises(OrchestrationError, match=r"at its stop time, 0\.02 s: expected no further step"):
            run.step()


def test_an_instance_that_cannot_begin_or_go_on_is_named(system: System) -> None:
    weights = {"plant.weight": [29.5, 29.0, 29.43]}
    with Ensemble(system) as ensemble:
        light = replace(DIVE, parameters={"plant.net_weight": 29.2})
        with pytest.raises(OrchestrationError, match=r"instance 1 cannot begin: .*net_weight"):
            ensemble.start(instances(light, weights), [CURRENT])
        far = {"plant.initial_depth": [0.0, 1e300]}
        without_noise = replace(DIVE, parameters={"plant.sensor_noise": 0.0})
        run = ensemble.start(instances(without_noise, far), [CURRENT])
        with pytest.raises(SimulationError, match="instance 1: ") as error:
            [run.step() for _ in range(9)]
    assert error.value.recording.values[0, 0] == 1e300
