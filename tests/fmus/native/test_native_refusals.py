"""What the native FMU refuses, with which status, and what it says of it."""

import math
from typing import Any

import pytest
from fmpy.fmi2 import fmi2LastSuccessfulTime

from tests.shared_builds import Fmus


def test_a_value_out_of_range_is_discarded_and_the_old_one_stays(built: Fmus, load: Any) -> None:
    plant = load(built["RovDepthPlant"]).begin()
    inertia, damping = plant.references["inertia"], plant.references["linear_damping"]
    assert plant.status("setReal", [damping, inertia], [9.0, -1.0]) == "discard"
    assert plant.log == ["fmi2SetReal: inertia = -1: expected 0.1..1000000.0 kg"]
    assert plant.slave.getReal([damping, inertia]) == [2.5, 5.5]
    assert plant.status("setReal", [inertia], [math.nan]) == "discard"
    plant.slave.doStep(0.0, 0.02)


def test_an_enumeration_takes_its_items_only(built: Fmus, load: Any) -> None:
    controller = load(built["L1Controller"])
    order = controller.references["filter_order"]
    assert controller.status("setInteger", [order], [3]) == "ok"
    assert controller.status("setInteger", [order], [2]) == "error"
    assert controller.log[-1] == "fmi2SetInteger: filter_order = 2: expected one of 1 (first), 3 (third)"


@pytest.mark.parametrize("stage", ["instantiated", "initialization", "stepping"])
def test_a_start_value_out_of_range_is_an_error_whose_message_needs_no_logging(
    built: Fmus, load: Any, stage: str
) -> None:
    """An input in initialization mode is no start value any more: a solver may try others."""
    plant = load(built["RovDepthPlant"], logging=False)
    parameter, given = plant.references["inertia"], plant.references["thruster_efficiency[2]"]
    message = "fmi2SetReal: inertia = -3: expected 0.1..1000000.0 kg"
    if stage == "instantiated":
        assert plant.status("setReal", [given], [-2.0]) == "error"
        assert plant.log.pop().startswith("fmi2SetReal: thruster_efficiency[2] = -2: expected ")
        plant.slave.reset()
    if stage != "instantiated":
        plant.slave.setupExperiment(startTime=0.0)
        plant.slave.enterInitializationMode()
    if stage == "stepping":
        plant.slave.exitInitializationMode()
    if stage != "instantiated":
        assert plant.status("setReal", [given], [-2.0]) == "discard"
    assert plant.status("setReal", [parameter], [-3.0]) == ("discard" if stage == "stepping" else "error")
    assert plant.log == ([] if stage == "stepping" else [message])
    assert plant.slave.getReal([parameter, given]) == [5.5, 1.0]


def test_a_diverging_step_is_discarded_and_leaves_the_state(built: Fmus, load: Any) -> None:
    plant = load(built["ExamplePlant"]).begin()
    plant["control"] = 1.0
    plant.slave.doStep(0.0, 0.5)
    before, state = plant["output"], plant.slave.getFMUstate()
    plant["omega"], plant["control"] = 1e300, 1e300
    assert plant.status("doStep", 0.5, 1.0) == "discard"
    assert plant.log == ["fmi2DoStep at 0.5 s: state or outputs are not finite any more; take shorter steps"]
    assert plant.slave.getRealStatus(fmi2LastSuccessfulTime) == 0.5
    assert plant["output"] == before
    plant["omega"], plant["control"] = 1.0, 1.0
    plant.slave.doStep(0.5, 0.5)
    after = plant["output"]
    plant.slave.setFMUstate(state)
    plant.slave.doStep(0.5, 0.5)
    assert plant["output"] == after


@pytest.mark.parametrize(
    ("call", "arguments", "message"),
    [
        ("doStep", (0.5, 0.1), "communication point 0.5 s: expected 0 s, the current time"),
        ("doStep", (0.0, 0.0), "communication step size 0 s: expected more than 0"),
        ("doStep", (0.0, -0.1), "communication step size -0.1 s: expected more than 0"),
        ("doStep", (0.0, math.nan), "expected more than 0"),
        ("doStep", (0.0, 1.1), "step to 1.1 s: expected at most the stop time 1 s"),
        ("setReal", ([99], [0.0]), "value reference 99: expected 0..22 of ExamplePlant"),
        ("setReal", ([18], [0.0]), "output can not be set, it is calculated"),
        ("setReal", ([0], [0.1]), "internal_step is fixed, set it before the initialization ends"),
        ("getInteger", ([18],), "output is Real: expected Integer or Enumeration"),
        ("getString", ([18],), "ExamplePlant has no String variables"),
        ("enterInitializationMode", (), "is not allowed in the state 'step complete'"),
        ("setupExperiment", (), "is not allowed in the state 'step complete'"),
        ("cancelStep", (), "expected a step in progress"),
    ],
)
def test_an_illegal_call_is_an_error_that_changes_nothing(
    built: Fmus, load: Any, call: str, arguments: tuple, message: str
) -> None:
    """Afterwards FMI allows reading, restoring, resetting and freeing only."""
    plant = load(built["ExamplePlant"])
    plant.slave.setupExperiment(startTime=0.0, stopTime=1.0)
    plant.slave.enterInitializationMode()
    plant.slave.exitInitializationMode()
    saved, before = plant.slave.getFMUstate(), plant.slave.getReal(list(range(19)))
    assert plant.status(call, *arguments) == "error"
    assert message in plant.log[-1]
    assert plant.slave.getReal(list(range(19))) == before
    assert plant.status("doStep", 0.0, 0.1) == "error"
    assert "is not allowed in the state 'error'" in plant.log[-1]
    plant.slave.setFMUstate(saved)
    plant.slave.doStep(0.0, 1.0)


def test_a_communication_point_is_told_from_the_next_also_far_from_zero(built: Fmus, load: Any) -> None:
    """At 1.7e9 s, the time since 1970, where 1e-9 of the time would be hundreds of steps."""
    plant, start = load(built["ExamplePlant"]), 1.7e9
    plant.slave.setupExperiment(startTime=start, stopTime=start + 1.0)
    plant.slave.enterInitializationMode()
    plant.slave.exitInitializationMode()
    plant.slave.doStep(start, 0.01)
    saved = plant.slave.getFMUstate()
    for wrong in (start, start + 0.02):
        assert plant.status("doStep", wrong, 0.01) == "error"
        plant.slave.setFMUstate(saved)
    plant.slave.doStep(start + 0.01, 0.01)
