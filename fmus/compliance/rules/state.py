"""Saved states, as far as the FMU claims them, and reading that changes nothing."""

from collections.abc import Iterator
from functools import partial

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import OF_EXPERIMENT, ROUNDING, Row, differences, differential, starts
from fmus.compliance.fmu_file import ONLY_ONCE
from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.traces import paths
from fmus.fmi.binding import ERROR

_KEPT_ADDRESSES = 8  # of blocks of one size, for reuse: glibc keeps 7 of a thread
_SET_BACK = "in the state that was set back"
_saves, _serialises = values.unless_claimed(values.SAVES), values.unless_claimed(values.SERIALISES)
_rule_of_states = partial(differential, "2.1.8", condition=_saves)


def _restored(probe: Probe, tolerance: float | None) -> Row:
    """Returns the row of a state that is set back once."""
    end = do.read(probe.outputs, _SET_BACK), do.run(5)
    varied = do.start, do.step(2), do.save(), do.expect(*end), do.restore(), *end
    return Row("from the state that was set back", varied, (), "", tolerance)


@_rule_of_states()
def state_restores(probe: Probe) -> Iterator[Row]:
    """A state that is set back gives the same outputs at once and in the steps that follow, up to
    the tolerance of the default experiment: a solver may begin anew.
    """
    yield _restored(probe, OF_EXPERIMENT)
    if len(starts(probe)) > 1:
        first = do.begin, do.step(2), do.save()
        end = do.read(probe.outputs, _SET_BACK), do.run(2), do.leap(1), do.read(probe.outputs)
        varied = *first, do.expect(*end), do.ignore(do.leap(2, True)), do.restore(), *end
        yield Row("from a state of the begin, late in a run", varied, (), tolerance=OF_EXPERIMENT)


@_rule_of_states()
def state_restores_exactly(probe: Probe) -> Iterator[Row]:
    """A state that is set back gives exactly the same outputs, for model exchange up to rounding of times."""
    yield _restored(probe, ROUNDING if probe.fmu.is_model_exchange else 0.0)


@_rule_of_states()
def state_holds_the_mode(probe: Probe) -> Iterator[Row]:
    """A state holds internal status information: saved and set back when instantiated or in initialization
    mode, with what was set there; set back while stepping, one of initialization mode is in that mode.
    """
    state = "the state of initialization mode that was set back"
    read = do.read(probe.fmu.readable_in_initialization, f"in {state}")
    end = read, do.exit_initialization_mode, do.run(2)
    other = do.set_others(probe.fmu.settable_in_initialization[:1])
    varied = do.save(), do.restore(), do.initialise, do.save(1), other, do.restore(1), *end
    yield Row(f"from {state}", varied, (do.initialise, *end), "in the state {state!r}", OF_EXPERIMENT)
    first = do.initialise, do.save(), do.exit_initialization_mode, do.expect(do.run(3))
    again = do.restore(), do.exit_initialization_mode, do.run(3)
    failing = "after a state of initialization mode was set back"
    yield Row("from a state of initialization mode", (*first, *again), (), failing, OF_EXPERIMENT)


@_rule_of_states()
def state_restores_after_the_end(probe: Probe) -> Iterator[Row]:
    """A state can be set back after fmi2Terminate and after an error, and steps go on from it, up to the stop
    time.
    """
    last, end = (f"{probe.point(i):g} s" for i in (4, 5))
    past = f"a step to {end} {{reply.status_name}}: expected error beyond the stop time {last}"
    # few FMUs refuse such a step
    asked = do.played(probe, (*do.begin_until(4), do.step(4), do.error(do.step())))
    refuses = [do.error(do.step(), past)] if asked.replies[-1].status == ERROR else []
    for end, action in (
        ("fmi2Terminate", do.terminate),
        ("an error of fmi2GetReal", do.fail),
        ("a step beyond the stop time", do.error(do.step())),
    ):
        first = *do.begin_until(4), do.step(2), do.save(), do.expect(do.run(2))
        varied = *first, action, do.restore(), do.run(2), *refuses
        yield Row(f"from a state set back after {end}", varied, (), f"after {end}", OF_EXPERIMENT)


@_rule_of_states()
def state_can_be_saved_often(_: Probe) -> Iterator[Row]:
    """Several states are kept at a time, each its own; one that is given again is written over."""
    varied = (
        do.start, do.save(), do.expect(do.run(3)), do.save(1),
        do.restore(), do.run(3, "from the older of two states"),
        do.restore(), do.save(1), do.run(3, "after a state was written over"),
        do.restore(1), do.run(3, "from the state that was written over"),
        do.free_state(), do.restore(1), do.run(3, "after another state was freed"), do.free_state(1),
    )  # fmt: skip
    yield Row("with several states", varied, (), tolerance=OF_EXPERIMENT)


@behaviour_rule("2.1.8", condition=_saves)
def freed_state_is_null(probe: Probe) -> Iterator[str]:
    """fmi2FreeFMUstate returns NULL in its argument."""
    script = probe.script(do.begin, do.step(), do.save(), logging=True)
    freed = script.call("free_state", 0)
    script.play()
    if not freed.value:
        yield "fmi2FreeFMUstate left the state's address: expected NULL"


@_rule_of_states()
def free_of_null_state_is_ignored(_: Probe) -> Iterator[Row]:
    """fmi2FreeFMUstate of a NULL state does nothing."""
    yield Row("with a state that is NULL", (do.begin, do.run(1), do.free_state(7), do.run(2)))


@_rule_of_states()
def state_holds_every_value(probe: Probe) -> Iterator[Row]:
    """Set back after inputs, tunable parameters and derivatives of inputs went back to their start values, a
    state gives all variables again, at once and in the steps that follow, as if it had not been saved.
    """
    pairs = do.others_accepted(probe, probe.fmu.settable_while_stepping, do.begin, do.step())
    moving = do.start, do.step(), do.set_values(pairs), do.set_derivatives(), do.step(), do.set_derivatives()
    slopes = values.continuous_reals(probe, "output") if probe.fmu.output_derivative_order else []
    end = do.read_all(_SET_BACK), do.read_slopes(slopes, _SET_BACK), do.run_all(3)
    back = do.set_derivatives(0.0), do.set_values(values.start_values(v for v, _ in pairs)), do.step(2)
    varied = *moving, do.save(), *back, do.restore(), *end
    when = "from a state that was set back"
    yield Row(when, varied, (*moving, *end), tolerance=OF_EXPERIMENT, may_fail=True)
    yield from paths.rows(probe, paths.restored)


@behaviour_rule("2.1.8", condition=_serialises)
def serialised_state_restores(probe: Probe) -> Iterator[str]:
    """Bytes of a state with other values, that was freed, give all variables again in an instance with start
    values, which has another address; they are as many as fmi2SerializedFMUstateSize gives, and reading them
    changes nothing until the state is set.
    """
    size, to_bytes = do.call("state_size", 0), do.call("state_bytes", 0)
    first = do.set_values(do.others_accepted(probe, probe.fmu.settable_before)), do.begin, do.step()
    moved = do.set_values(do.others_accepted(probe, probe.fmu.settable_while_stepping, *first))
    saved = *first, moved, do.step(), do.save(), size
    strings = [v for v in probe.fmu.settable_while_stepping if v.base_kind == "String"]
    longer = [(v, text) for v in strings for text in values.far_values(v)[-1:]]
    others = do.set_values(do.accepted_together(probe, longer, *first))
    freed = others, size, to_bytes, do.free_state(), do.save(1), do.step()
    # set back, as a solver may begin anew there
    usual = *saved, to_bytes, do.restore(), do.read_all(), do.run_all(3), *freed
    source = do.played(probe, usual)
    count, again = (reply.value for reply in source.replies_of("fmi2SerializedFMUstateSize"))
    serialised = source.replies_of("fmi2SerializeFMUstate")
    if count != again:
        when = "after three steps and other strings"
        yield f"fmi2SerializedFMUstateSize of a saved state is {again} {when}: expected {count} again"
    if not all(reply.value[1] for reply in serialised):
        yield f"fmi2SerializeFMUstate writes more than the {count} bytes of its size"
    if not source.content:
        yield "a serialised state has no bytes"
        return
    still = "after fmi2DeSerializeFMUstate, before fmi2SetFMUstate"
    first = do.begin, do.step(), do.expect(do.read_all())
    varied = *first, do.read_bytes(source), do.read_all(still), do.restore(), do.read_all(), do.run_all(3)
    when = "from bytes in another instance"
    # instances that are created before take the addresses of those that were freed
    beside = () if probe.fmu.claims(ONLY_ONCE) else ((),) * _KEPT_ADDRESSES
    rows = [Row(when, (*varied, do.free_state()), usual, tolerance=OF_EXPERIMENT, beside=beside)]
    again = do.copy(0, 1), do.free_state(), do.step(), do.restore(1), do.read_all(), do.run_all(3)
    first = do.start, do.step(2), do.save(), do.restore()
    varied = *first, do.expect(do.read_all(), do.run_all(3)), *again
    rows += [Row("from bytes", varied, (), tolerance=OF_EXPERIMENT, beside=beside[:1])]
    rows += [*paths.rows(probe, paths.from_bytes)]
    messages = [*differences(probe, rows)]
    if messages and serialised[0].value != serialised[-1].value:
        yield (
            "fmi2SerializeFMUstate gives other bytes of a saved state after three steps than before them: "
            "expected the bytes of the saved state, not of the present one"
        )
    yield from messages


@_rule_of_states()
def state_can_be_set_after_reset(_: Probe) -> Iterator[Row]:
    """A state that was saved before fmi2Reset can be set after it, and the steps that follow are the same."""
    varied = do.start, do.step(2), do.save(), do.expect(do.run(3)), do.reset, do.restore(), do.run(3)
    failing = "with a state from before fmi2Reset"
    yield Row("from a state from before fmi2Reset", varied, (), failing, OF_EXPERIMENT)


@differential("4.2.2", condition=_saves)
def flag_keeps_the_states_of_the_present(_: Probe) -> Iterator[Row]:
    """After a step with noSetFMUStatePriorToCurrentPoint, a state of its beginning can be set."""
    varied = do.start, do.step(2), do.save(), do.step(no_going_back=True), do.restore(), do.step()
    yield Row("after noSetFMUStatePriorToCurrentPoint", varied)


@differential("2.1.7")
def questions_change_nothing(probe: Probe) -> Iterator[Row]:
    """Reading values and derivatives, or saving a state, changes nothing in the steps that follow."""
    yield from paths.rows(probe, paths.asked)
