"""Instances that are led step by step have the bits of a simulator that is led so."""

from dataclasses import replace

import numpy as np
import pytest

from orchestration import Ensemble, Event, Experiment, Ramps, Simulator, System
from orchestration.errors import OrchestrationError, SimulationError, SystemDefinitionError
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
def test_every_step_has_the_bits_of_a_simulator(system: System, inputs: dict[str, float]) -> None:
    """Three instances, another inertia of each and another current at each step."""
    experiment, currents = replace(DIVE, inputs=inputs), np.random.default_rng(2).normal(0.0, 0.1, (60, 3))
    with Ensemble(system) as ensemble:
        run = ensemble.start(instances(experiment, {INERTIA: INERTIAS}), [CURRENT])
        read, half, points = [run.read(READ)], [], [run.time]
        while not run.is_done:
            if run.point:  # the first step has the first value
                run.write([CURRENT], currents[run.point][None])
            run.step()
            if run.point == 25:
                half = [run.recordings().run(i).values.tobytes() for i in range(3)]
            read.append(run.read(READ))
            points.append(run.time)
        recorded = run.recordings()
    for instance, inertia in enumerate(INERTIAS):
        with Simulator(system) as simulator:
            own = replace(experiment, parameters={INERTIA: inertia})
            simulator.start(own, external=[CURRENT])
            values = simulator.reader(*READ[:2], READ[3])
            for point in range(len(points) - 1):
                if point == 25:
                    assert simulator.recording().values.tobytes() == half[instance]
                if point:
                    simulator.set(CURRENT, currents[point, instance])
                assert values() == (*read[point][:2, instance], read[point][3, instance])
                assert simulator.time == points[point]
                simulator.step()
            one, of_ensemble = simulator.recording(), recorded.run(instance)
            assert of_ensemble.values.tobytes() == one.values.tobytes()
            assert of_ensemble.time.tolist() == one.time.tolist() == points


def test_what_is_set_has_the_range_of_the_input(system: System) -> None:
    with Ensemble(system) as ensemble:
        run = ensemble.start([DIVE] * 9, [EFFICIENCY])
        for wrong in (np.nan, 1.5):
            with pytest.raises(SystemDefinitionError, match=r"plant\.thruster_efficiency\[1\] = .*expected"):
                run.write([EFFICIENCY], np.array([[*[0.5] * 8, wrong]]))
        assert run.read([EFFICIENCY])[0].tolist() == [1.0] * 9
        values = np.linspace(0.0, 1.0, 9)
        run.write([EFFICIENCY], values[None])
        assert run.read([EFFICIENCY])[0].tolist() == values.tolist()


def test_a_refused_write_sets_nothing(system: System) -> None:
    halves = np.array([[0.5, 0.5], [0.5, 0.5]])
    with Ensemble(system) as ensemble:
        run = ensemble.start([DIVE] * 2, [CURRENT, EFFICIENCY])
        before = run.read([CURRENT, EFFICIENCY, INERTIA]).tolist()
        for names, values, message in (
            ([CURRENT, EFFICIENCY], np.array([[0.5, 0.5], [0.5, 7.0]]), "= 7.0: expected"),
            ([CURRENT, INERTIA], halves, "inertia: expected an external input: plant.current_velocity, pl"),
            ([CURRENT, "plant.depth"], halves, "write: plant.depth: expected an external input"),
            ([CURRENT, "plant.inertai"], halves, "no variable 'plant.inertai'; nearest is 'plant.inertia'"),
            ([CURRENT], np.array([[0.5]]), r"shape \(1, 1\): expected \(names, instances\) = \(1, 2\)"),
            ([CURRENT, EFFICIENCY], halves[:1], r"shape \(1, 2\): expected .* = \(2, 2\)"),
        ):
            with pytest.raises(SystemDefinitionError, match=message):
                run.write(names, values)
            assert run.read([CURRENT, EFFICIENCY, INERTIA]).tolist() == before
        run.write([CURRENT, EFFICIENCY], np.array([[0.1, 0.2], [0.3, 0.4]]))
        assert run.read([EFFICIENCY, CURRENT]).tolist() == [[0.3, 0.4], [0.1, 0.2]]


def test_driven_inputs_are_read_at_the_present_point(system: System) -> None:
    reference = "controller.depth_reference"
    with Ensemble(system) as ensemble:
        run = ensemble.start([DIVE], [CURRENT])
        read = []
        for _ in range(3):
            read.append(run.read([reference])[0, 0])
            run.step()
        assert read == run.recordings()[reference][0, :3].tolist() == pytest.approx([0.0, 0.016, 0.032])
        arriving, commanded = run.read(["plant.voltage[1]", "controller.voltage[1]"])
        assert arriving == commanded
        with pytest.raises(SystemDefinitionError, match=r"read: no variable 'plant\.dept'; nearest is"):
            run.read(["plant.dept"])


def test_recordings_are_those_of_the_point_at_which_they_are_made(system: System) -> None:
    with Ensemble(system) as ensemble:
        run = ensemble.start([DIVE] * 2, [CURRENT])
        run.step()
        recorded = run.recordings()
        run.write([CURRENT], np.array([[0.9, 0.9]]))
        run.step()
    assert recorded[CURRENT].tolist() == [[0.0, 0.0], [0.0, 0.0]]
    assert recorded.time.tolist() == recorded.recordings().time.tolist() == [0.0, 0.02]


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
