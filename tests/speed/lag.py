"""A small block, of which two drive each other, or many are a chain.

    dx/dt = 0.1 + (signal - x) / 3, x(0) = 0

Explicit Euler, a step of 2^-7 s: every time and step is exact in binary, and in nanoseconds, so that all
importers do the same arithmetic. Two that drive each other rise alike and never come to rest: a step too many
or too few shows at any time, and so does a signal that is not passed on.
"""

from dataclasses import dataclass

from fmus.block import Block, NoValues, variable

STEP_SIZE = 2.0**-7


@dataclass(frozen=True)
class Inputs:
    signal: float = variable(0.0, "What the level follows")


@dataclass(frozen=True)
class State:
    level: float = 0.0


@dataclass(frozen=True)
class Outputs:
    level: float = variable(0.0, "Level")


def step(
    t: float, h: float, state: State, inputs: Inputs, parameters: NoValues, calculated: NoValues
) -> State:
    return State(state.level + h * (0.1 + (inputs.signal - state.level) / 3.0))


def output(t: float, state: State, parameters: NoValues, calculated: NoValues) -> Outputs:
    return Outputs(state.level)


BLOCK = Block.of_module(__name__, "Lag", "A lag of first order that is driven", step_size=STEP_SIZE)
