"""Mutants of a second slave that runs (oscillator.c): one compiled library, which misbehaves by a name."""

from functools import partial

from tests.mutants.behaviour import ASYNCHRONOUS, write_slave
from tests.mutants.mutant import Mutant

_LISTED = '<Unknown index="14" dependencies="8 12"/>\n      <Unknown index="15" dependencies="10" dep'


def _listed_as(kinds: str) -> tuple[tuple[str, str], ...]:
    return ((_LISTED, _LISTED.replace('8 12"/>', f'8 12" dependenciesKind="{kinds}"/>')),)


_CHANGES = {  # mutation or flags -> changes of the model description
    "asynchronous": ASYNCHRONOUS,
    "runs begin at 0": (('startTime="1.5"', 'startTime="0"'),),
    "a constant factor is none": _listed_as("constant dependent"),
    "a fixed factor changes": _listed_as("fixed dependent"),
    "a state acts undeclared": (('"13" dependencies="8 9 10 11"', '"13" dependencies="8 9 10"'),),
}


def _mutant(name: str, clause: str, rules: str, flags: str) -> Mutant:
    changes = _CHANGES.get(name, _CHANGES.get(flags, ()))
    write = partial(write_slave, mutation=name, flags=flags, changes=changes, slave="Oscillator")
    return Mutant(name, clause, frozenset(rules.split()), write, is_static=False)


_ROWS = [
    ("tunable calculated parameters stay", "2.2.7", "tunable-values-are-computed-anew", ""),
    ("a fixed parameter follows a tunable one", "2.2.7", "fixed-values-follow-nothing", ""),
    ("a fixed local follows an input", "2.2.7", "fixed-values-follow-nothing", ""),
    ("a constant string changes", "2.2.7", "constants-have-their-value", ""),
    ("an undeclared input acts in step mode", "2.2.8", "outputs-follow-declared-inputs-alone", ""),
    ("a declared input does not act in step mode", "2.2.8", "output-derivatives-are-right", ""),
    ("time acts although it is not listed", "2.2.8", "dependencies-on-time-are-declared", ""),
    ("a constant factor is none", "2.2.8", "constant-factors-are-constant directional-derivatives", ""),
    ("steps of a grid", "4.2.2", "derivatives-are-slopes two-steps-are-one-of-twice-the-size", ""),
    ("the first step size stays", "4.2.2", "two-steps-are-one-of-twice-the-size", ""),
    ("second derivatives of outputs are wrong", "4.2.1", "higher-output-derivatives-are-right", ""),
    ("directional derivatives at the start", "2.1.9", "directional-derivatives-in-step-mode", ""),
    ("only the first directional derivative", "2.1.9", "directional-derivatives", ""),
    ("no derivatives of calculated parameters", "2.1.9", "directional-derivatives", ""),
    ("a second set-up is refused", "2.1.6", "set-up-can-be-repeated", ""),
    ("an undefined tolerance counts", "2.1.6", "steps-and-terminates", ""),
    ("exact states move when initialisation ends", "2.2.7", "exact-values-remain-after-initialization", ""),
    ("only the first value of a call is set", "2.1.7", "values-are-set-together", ""),
    ("only the first value of a call is set", "2.1.7", "values-are-set-together", "other values are refused"),
    ("long strings are cut", "2.1.7", "far-values-are-read", ""),
    ("inputs are clipped", "2.1.7", "far-values-are-read", ""),
    ("free of one ends the others", "2.1.5", "freed-instance-changes-no-other", ""),
    ("free crashes when terminated", "2.1.5", "steps-and-terminates", ""),
    ("a message that is not UTF-8", "2.1.2", "messages-are-utf-8", ""),
    ("a percent sign at the end", "2.1.5", "formats-of-messages-are-legal", ""),
    ("a single percent sign", "2.1.5", "percent-signs-before-words-are-doubled", ""),
    ("a message of NULL", "2.1.5", "messages-have-a-text", ""),
    ("an empty category", "2.1.5", "log-categories-are-declared", ""),
    ("a refusal without environment", "2.1.5", "messages-of-a-refusal-are-complete", ""),
    ("debug logging off is for all", "2.1.5", "disabled-categories-alone-are-disabled", ""),
    ("debug logging is refused after an error", "4.2.4", "debug-logging-is-allowed-after-an-error", ""),
    (
        "the pointer to a category is kept",
        "2.1.5",
        "chosen-categories-are-logged disabled-categories-alone-are-disabled",
        "",
    ),
    ("reset keeps inputs", "2.1.6", "reset-ends-all-that-was-set", ""),
    ("reset keeps strings", "2.1.6", "reset-gives-the-start-values", ""),
    ("states without Strings", "2.1.8", "state-holds-inputs-and-parameters", ""),
    ("states without Strings", "2.1.8", "state-holds-inputs-and-parameters", "other values are refused"),
    ("states without derivatives of inputs", "2.1.8", "state-holds-every-value", ""),
    ("bytes of the present", "2.1.8", "bytes-hold-every-value", ""),
    ("reading bytes acts at once", "2.1.8", "bytes-hold-every-value", ""),
    ("reset frees states", "2.1.8", "state-can-be-set-after-reset", ""),
    ("the flag ends all states", "4.2.2", "flag-keeps-the-states-of-the-present", ""),
    ("reading counts", "2.1.7", "questions-change-nothing", ""),
    ("directional derivatives move the state", "2.1.9", "questions-change-nothing", ""),
    ("another kind is discarded", "2.1.3", "refusals-have-legal-statuses", ""),
    ("reading writes references", "2.1.7", "arguments-are-not-written", ""),
    ("reading writes one more", "2.1.7", "arguments-are-not-written", ""),
    ("no reading after a discarded step", "4.2.4", "discarded-steps-can-be-left", "discards"),
    ("a Boolean status of 3", "4.2.3", "discarded-steps-have-a-last-time", "discards"),
    ("derivatives of inputs are halved", "4.2.1", "input-derivatives-are-slopes", ""),
    ("a string of NULL before the first step", "2.1.2", "variables-can-be-read", ""),
    ("types in memory of their own", "2.1.4", "library-version", ""),
    ("a late step ends all states", "2.1.8", "state-restores-after-the-end", ""),
    ("only the first derivative of a call is set", "4.2.1", "input-derivatives-are-set-together", ""),
    ("a late step ends reset", "2.1.3", "step-beyond-the-stop-time-is-an-error", ""),
    ("long names are cut", "2.1.5", "arguments-of-instantiation-are-copied", ""),
    ("an alarm", "2.1", "process-settings-are-restored", ""),
    ("Integers of a byte", "2.1.7", "far-values-are-read", ""),
    ("one processor alone", "2.1", "process-settings-are-restored", ""),
    ("a fixed factor changes", "2.2.8", "factors-change-as-declared", ""),
    ("a state acts undeclared", "2.2.8", "directional-derivatives-are-zero-without-dependency", ""),
    ("an Integer status", "4.2.3", "statuses-have-their-types", ""),
    ("half a step without a last time", "4.2.3", "discarded-steps-have-a-last-time", "discards"),
    ("stepFinished with pending", "2.1.5", "step-finished-is-called", "asynchronous"),
    ("a pending status of NULL", "4.2.3", "status-of-a-pending-step-is-given", "asynchronous"),
    ("cancelling goes on", "4.2.2", "cancelled-step-ends-stepping", "asynchronous"),
    ("visible instances fail", "2.1.5", "visible-instances-run", ""),
    ("GUID without case", "2.1.5", "wrong-guid-is-refused", ""),
    ("a changed environment variable", "2.1", "process-settings-are-restored", ""),
    ("a removed environment variable", "2.1", "process-settings-are-restored", ""),
    ("a blocked signal", "2.1", "process-settings-are-restored", ""),
    ("standard output is closed", "2.1", "process-settings-are-restored", ""),
    ("reset leaks", "2.1.5", "memory-does-not-grow", ""),
    ("fails before its own stop time", "2.2.5", "default-experiment-runs", ""),
    ("only the first input has derivatives", "4.2.1", "each-input-derivative-has-an-effect", ""),
    ("derivatives of any variable", "2.1.2", "wrong-references-of-derivatives-are-refused", ""),
    ("a reference twice in a call", "2.1.7", "values-belong-to-references", ""),
    ("not a number later", "2.1.7", "outputs-are-finite", ""),
    ("any first communication point", "4.2.2", "forbidden-calls-are-refused", ""),
    ("outputs can be set at communication points", "4.2.4", "forbidden-calls-are-refused", ""),
    ("messages go to the latest instance", "2.1.5", "messages-have-the-instance-name", ""),
    ("messages carry the latest name", "2.1.5", "messages-have-the-instance-name", ""),
    ("derivatives of outputs of the step's begin", "4.2.1", "output-derivatives-are-right", ""),
    ("values are not written", "2.1.7", "values-are-written", ""),
    (
        "warns in each step",
        "2.1.5",
        "no-messages-with-logging-off only-chosen-categories-are-logged "
        "disabled-categories-alone-are-disabled",
        "",
    ),
    ("runs begin at 0", "2.1.6", "time-is-the-communication-point", ""),
    ("time of equal steps", "2.2.7", "time-is-the-communication-point", ""),
    ("whole internal steps alone", "4.2.2", "two-steps-are-one-of-twice-the-size", ""),
    ("the last parameter alone has a derivative", "2.1.9", "directional-derivatives-are-linear", ""),
    ("a blank of a text", "2.1.5", "formats-of-messages-are-legal", ""),
    ("the instance name is part of the format", "2.1.5", "formats-of-messages-are-legal", ""),
    ("errors are information", "2.1.5", "refusals-are-logged", ""),
    ("writes to standard error", "2.1", "nothing-is-printed", ""),
    ("tunable parameters are clipped", "2.1.7", "far-values-are-read", ""),
    ("parameters below their minimum are dropped", "2.2.3", "values-out-of-range-are-not-dropped", ""),
    ("states without the stop time", "2.1.8", "state-restores-after-the-end", ""),
    ("states with the start value of a parameter", "2.1.8", "state-holds-every-value", ""),
    ("bytes without a fixed parameter", "2.1.8", "bytes-hold-every-value", ""),
    ("a second state crashes", "2.1.8", "state-can-be-saved-often", ""),
    ("resources are read in steps", "2.3", "resources-are-read-in-initialization", ""),
]
OSCILLATOR_MUTANTS = tuple(_mutant(*row) for row in _ROWS)
