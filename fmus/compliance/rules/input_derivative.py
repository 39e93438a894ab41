"""Derivatives of inputs, as far as the FMU claims to interpolate."""

from collections.abc import Iterator

from fmus.compliance.comparison import RESTARTED, differing
from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.script import Reading, Script
from fmus.compliance.values import (
    INTERPOLATES,
    continuous_reals,
    other_value,
    references_of,
    set_input_derivatives,
    start_value,
    unless_claimed,
)
from fmus.compliance.variable import Variable

_TRANSFER = "4.2.1 Transfer of Input / Output Values and Parameters"
_ROUGH = 0.1  # relative: of an effect over a step


def derive(script: Script, v: Variable, value: float) -> None:
    script.call("set_input_derivatives", references_of([v]), [1], [value])


@behaviour_rule(_TRANSFER, condition=unless_claimed(INTERPOLATES), needs="allowed-calls-succeed")
def input_derivatives(probe: Probe) -> Iterator[str]:
    """The first derivative of every continuous Real input can be set before a step; zero, also after
    another value, changes nothing."""
    usual, script = probe.script().begin(), probe.script(logging=True).begin()
    expected = usual.run(2)
    for v in continuous_reals(probe, "input"):
        derive(script, v, 1.0)
        derive(script, v, 0.0)
    got = script.run(2)
    usual.play()
    script.play()
    yield from differing(expected, got, "where derivatives of inputs were set to 0", RESTARTED)


@behaviour_rule(_TRANSFER, condition=unless_claimed(INTERPOLATES), needs="input-derivatives")
def input_derivatives_have_an_effect(probe: Probe) -> Iterator[str]:
    """The derivative of an input that outputs follow moves them, in the direction of the input itself."""
    verdicts = probe.once("effects of derivatives", lambda: input_effects(probe))
    backwards = [name for name, verdict in verdicts if verdict == "backwards"]
    without = [name for name, verdict in verdicts if verdict == "not"]
    if backwards:
        yield f"the derivative of {backwards[0]} moves outputs against the input in a step"
    elif without and not any(verdict == "right" for _, verdict in verdicts):
        yield f"the derivative of {without[0]} has no effect in a step, as canInterpolateInputs says it has"


@behaviour_rule(_TRANSFER, condition=unless_claimed(INTERPOLATES), needs="input-derivatives-have-an-effect")
def each_input_derivative_has_an_effect(probe: Probe) -> Iterator[str]:
    """If the derivative of one continuous input has an effect, that of each that outputs follow has one."""
    for name, verdict in probe.once("effects of derivatives", lambda: input_effects(probe)):
        if verdict == "not":
            yield f"the derivative of {name} has no effect in a step, where those of other inputs have one"


def input_effects(probe: Probe) -> list[tuple[str, str]]:
    """Continuous inputs that take another value, each with what its derivative does to outputs."""
    verdicts = []
    for v in continuous_reals(probe, "input"):
        value = other_value(v)
        if value is None:
            continue
        change, held = value - start_value(v), probe.script().begin().step()
        raised, moving = probe.script().begin().step(), probe.script().begin().step()
        for script in (held, raised, moving):
            script.set(v, value if script is raised else start_value(v))
        derive(moving, v, change / probe.step_size)
        readings = [script.step().read(probe.outputs) for script in (held, raised, moving)]
        probe.play_each([held, raised, moving])
        if not (held.failure or raised.failure or moving.failure):
            verdicts.append((v.name, _moved(*readings)))
    return verdicts


def _moved(held: Reading, raised: Reading, moving: Reading) -> str:
    """Whether outputs that follow an input follow its derivative: right, not, backwards, or unknown."""
    pairs = [
        (raised.values[name] - value, moving.values[name] - value)
        for name, value in held.values.items()
        if isinstance(value, float) and raised.values[name] != value
    ]
    if not pairs:
        return "unknown"
    if all(moved == 0.0 for _, moved in pairs):
        return "not"
    largest = max(pairs, key=lambda pair: abs(pair[0]))
    return (
        "backwards"
        if largest[0] * largest[1] < 0.0 and abs(largest[1]) > _ROUGH * abs(largest[0])
        else "right"
    )


@behaviour_rule(
    "4.2.4 State Machine of Calling Sequence from Master to Slave",
    condition=unless_claimed(INTERPOLATES),
    needs="allowed-calls-succeed",
)
def input_derivatives_when_instantiated(probe: Probe) -> Iterator[str]:
    """Derivatives of inputs can be set when instantiated: 4.2.4 allows it, although 4.2.1 gives them the
    restrictions of fmi2SetReal, which cannot set inputs there.
    """
    script = probe.script(logging=True)
    set_input_derivatives(probe, script, 0.0)
    script.begin().step().play(keep_going=True)
    if script.failure:
        when = "when instantiated, which 4.2.4 allows and 4.2.1 does not"
        yield f"where derivatives of inputs were set {when}: {script.failure.problem}"
