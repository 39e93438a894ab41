"""The smallest block with all that functions of FMI get and set: a parameter, an input, an array, a state."""

from dataclasses import dataclass

from fmus.block import Block, variable


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(0.1, "Longest internal step", unit="s", min=1e-6, max=1.0)


@dataclass(frozen=True)
class Inputs:
    rate: float = variable(0.0, "Rate")


@dataclass(frozen=True)
class Continuous:
    level: float = variable(1.0, "Level")


@dataclass(frozen=True)
class Outputs:
    both: tuple[float, float] = variable((0.0, 0.0), "Level, and its double")


SMALLEST = Block(
    "Smallest", "An integrator",
    parameters=Parameters, inputs=Inputs, continuous=Continuous, outputs=Outputs, step_size=0.1,
    derivative=lambda t, state, u, p, c: Continuous(u.rate),
    output=lambda t, state, p, c: Outputs((state.level, 2.0 * state.level)),
)  # fmt: skip
