"""Behaviour of saved states: FMI 2.0.5, 2.1.8, as far as the FMU claims it."""

from collections.abc import Iterator
from typing import Any

from fmus.compliance.lifecycle_rules import differing, unless_claimed
from fmus.compliance.probe import Instance, Probe
from fmus.compliance.rule import Stage, rule

_CLAUSE = "2.1.8 Getting and Setting the Complete FMU State"
_STEPS = 5


@rule(_CLAUSE, Stage.BEHAVIOUR, condition=unless_claimed("canGetAndSetFMUstate"))
def state_restores(probe: Probe) -> Iterator[str]:
    """A state that is set back gives the same outputs at once and in the steps that follow, exactly."""
    with probe.instance() as instance:
        instance.enter_step_mode(probe.start_time)
        probe.run(instance, 2)
        state, outputs = instance.get_fmu_state(), instance.get(probe.outputs)
        expected = probe.run(instance, _STEPS, 2)
        instance.set_fmu_state(state)
        yield from differing([outputs], [instance.get(probe.outputs)], "in the state that was set back")
        yield from differing(expected, probe.run(instance, _STEPS, 2), "from the state that was set back")
        if instance.free_fmu_state(state) is not None:
            yield "fmi2FreeFMUstate left the state's address: expected NULL"


@rule(_CLAUSE, Stage.BEHAVIOUR, condition=unless_claimed("canGetAndSetFMUstate"))
def state_can_be_saved_often(probe: Probe) -> Iterator[str]:
    """Several states are kept at a time, each its own; one that is given again is written over."""
    with probe.instance() as instance:
        instance.enter_step_mode(probe.start_time)
        first = instance.get_fmu_state()
        expected = probe.run(instance, 3)
        second = instance.get_fmu_state()
        instance.set_fmu_state(first)
        yield from differing(expected, probe.run(instance, 3), "from the older of two states")
        instance.set_fmu_state(first)
        second = instance.get_fmu_state(second)
        yield from differing(expected, probe.run(instance, 3), "after a state was written over")
        instance.set_fmu_state(second)
        yield from differing(expected, probe.run(instance, 3), "from the state that was written over")
        instance.free_fmu_state(first)
        instance.free_fmu_state(second)


@rule(_CLAUSE, Stage.BEHAVIOUR, condition=unless_claimed("canSerializeFMUstate"))
def serialised_state_restores(probe: Probe) -> Iterator[str]:
    """A state as bytes gives the same outputs in an instance of its own, where several are allowed."""
    with probe.instance() as instance:
        instance.enter_step_mode(probe.start_time)
        probe.run(instance, 2)
        state = instance.get_fmu_state()
        content = instance.serialize_fmu_state(state)
        instance.free_fmu_state(state)
        expected = probe.run(instance, _STEPS, 2)
        if not probe.fmu.claims("canBeInstantiatedOnlyOncePerProcess"):
            with probe.instance() as other:
                other.enter_step_mode(probe.start_time)
                yield from _continued(probe, other, content, expected)
        yield from _continued(probe, instance, content, expected)


def _continued(
    probe: Probe, instance: Instance, content: bytes, expected: list[dict[str, Any]]
) -> Iterator[str]:
    state = instance.deserialize_fmu_state(content)
    instance.set_fmu_state(state)
    yield from differing(expected, probe.run(instance, _STEPS, 2), "from a state read from bytes")
    instance.free_fmu_state(state)
