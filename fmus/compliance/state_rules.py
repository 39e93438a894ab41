"""Behaviour of saved states: FMI 2.0.5, 2.1.8, as far as the FMU claims it."""

from collections.abc import Iterator
from typing import Any

from fmus.compliance.lifecycle_rules import differing, unless_claimed
from fmus.compliance.rule import Stage, rule

_CLAUSE = "2.1.8 Getting and Setting the Complete FMU State"
_STEPS = 5


@rule(_CLAUSE, Stage.BEHAVIOUR, condition=unless_claimed("canGetAndSetFMUstate"))
def state_restores(probe: Any) -> Iterator[str]:
    """A state that is set back gives the same outputs at once and in the steps that follow, exactly."""
    with probe.instance() as slave:
        slave.begin(probe.start_time)
        probe.run(slave, 2)
        state, outputs = slave.save(), slave.get(probe.outputs)
        expected = probe.run(slave, _STEPS, 2)
        slave.call("SetFMUstate", state)
        yield from differing([outputs], [slave.get(probe.outputs)], "in the state that was set back")
        yield from differing(expected, probe.run(slave, _STEPS, 2), "from the state that was set back")
        slave.free_state(state)
        if state.value is not None:
            yield "fmi2FreeFMUstate left the state's address: expected NULL"


@rule(_CLAUSE, Stage.BEHAVIOUR, condition=unless_claimed("canGetAndSetFMUstate"))
def state_can_be_saved_often(probe: Any) -> Iterator[str]:
    """Several states are kept at a time, each its own; one that is given again is written over."""
    import ctypes

    with probe.instance() as slave:
        slave.begin(probe.start_time)
        first = slave.save()
        expected = probe.run(slave, 3)
        second = slave.save()
        slave.call("SetFMUstate", first)
        yield from differing(expected, probe.run(slave, 3), "from the older of two states")
        slave.call("SetFMUstate", first)
        slave.call("GetFMUstate", ctypes.byref(second))
        yield from differing(expected, probe.run(slave, 3), "after a state was written over")
        slave.call("SetFMUstate", second)
        yield from differing(expected, probe.run(slave, 3), "from the state that was written over")
        slave.free_state(first)
        slave.free_state(second)


@rule(_CLAUSE, Stage.BEHAVIOUR, condition=unless_claimed("canSerializeFMUstate"))
def serialised_state_restores(probe: Any) -> Iterator[str]:
    """A state as bytes gives the same outputs in an instance of its own, where several are allowed."""
    with probe.instance() as slave:
        slave.begin(probe.start_time)
        probe.run(slave, 2)
        state = slave.save()
        content = slave.serialised(state)
        slave.free_state(state)
        expected = probe.run(slave, _STEPS, 2)
        if not probe.fmu.claims("canBeInstantiatedOnlyOncePerProcess"):
            with probe.instance() as other:
                other.begin(probe.start_time)
                yield from _continued(probe, other, content, expected)
        yield from _continued(probe, slave, content, expected)


def _continued(probe: Any, slave: Any, content: bytes, expected: list[dict[str, Any]]) -> Iterator[str]:
    state = slave.deserialised(content)
    slave.call("SetFMUstate", state)
    yield from differing(expected, probe.run(slave, _STEPS, 2), "from a state read from bytes")
    slave.free_state(state)
