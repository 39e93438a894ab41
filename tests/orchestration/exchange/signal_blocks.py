"""Blocks of the signals in packages of others: a sine, a step, a gain, a weighted sum, a product.

Their names, inputs, outputs and parameters are those of the Modelica library's blocks of these kinds. In step
mode an output depends on the inputs of the step before, as those of every block do.
"""

from dataclasses import dataclass

from fmus.block import Block, NoValues, variable
from fmus.numerics import sin, where

PI = 3.141592653589793


@dataclass(frozen=True)
class SineParameters:
    amplitude: float = variable(1.0, "Amplitude")
    f: float = variable(1.0, "Frequency", unit="Hz")
    phase: float = variable(0.0, "Phase", unit="rad")
    offset: float = variable(0.0, "Offset")
    startTime: float = variable(0.0, "Time before which the output is the offset", unit="s")  # noqa: N815


@dataclass(frozen=True)
class StepParameters:
    height: float = variable(1.0, "Height")
    offset: float = variable(0.0, "Offset")
    startTime: float = variable(0.0, "Time of the step", unit="s")  # noqa: N815


@dataclass(frozen=True)
class GainParameters:
    k: float = variable(1.0, "Gain")


@dataclass(frozen=True)
class AddParameters:
    k1: float = variable(1.0, "Gain of u1")
    k2: float = variable(1.0, "Gain of u2")


@dataclass(frozen=True)
class OneInput:
    u: float = variable(0.0, "Input")


@dataclass(frozen=True)
class TwoInputs:
    u1: float = variable(0.0, "First input")
    u2: float = variable(0.0, "Second input")


@dataclass(frozen=True)
class Outputs:
    y: float = variable(0.0, "Output")


def _sine(t, s, p, c):
    angle = 2.0 * PI * p.f * (t - p.startTime) + p.phase
    return Outputs(p.offset + where(t < p.startTime, 0.0, lambda: p.amplitude * sin(angle)))


def _step(t, s, p, c):
    return Outputs(p.offset + where(t < p.startTime, 0.0, p.height))


def _of_inputs(name, inputs, parameters, output):
    """Returns a block whose output depends on its inputs: they are its state."""
    return Block(
        name,
        f"{name} of inputs",
        parameters=parameters,
        inputs=inputs,
        state=inputs,
        outputs=Outputs,
        initial_state=lambda t, u, p, c: u,
        step=lambda t, h, s, u, p, c: u,
        output=lambda t, s, p, c: Outputs(output(s, p)),
    )


BLOCKS = {
    block.name: block
    for block in (
        Block("Sine", "A sine", parameters=SineParameters, outputs=Outputs, output=_sine),
        Block("Step", "A step", parameters=StepParameters, outputs=Outputs, output=_step),
        _of_inputs("Gain", OneInput, GainParameters, lambda s, p: p.k * s.u),
        _of_inputs("Add", TwoInputs, AddParameters, lambda s, p: p.k1 * s.u1 + p.k2 * s.u2),
        _of_inputs("Product", TwoInputs, NoValues, lambda s, p: s.u1 * s.u2),
    )
}
