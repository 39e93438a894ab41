"""A block without inputs whose output follows ramps through given points, in any unit.

It takes the place of a signal in a system that is handed on without its scenario, such as an SSP package.
"""

from dataclasses import dataclass, make_dataclass

from fmus.block import Block, NoValues, variable
from fmus.block.guide import Experiment, Guide
from fmus.numerics import ramps


def ramp_source(name: str, output: str, unit: str | None, points: int) -> Block:
    """A block `name` with the output `output` and the parameters smooth, point_time[i] and point_value[i].

    output: an identifier
    unit: of the output and of point_value, one that `fmus.block.units` knows; None for no unit
    points: how many, at least 2; their times start at 0, 1, 2, ... s, their values at 0
    """

    @dataclass(frozen=True)
    class Parameters:
        internal_step: float = variable(
            10.0, "Longest internal step; without effect, the output follows from the time alone",
            unit="s", min=1e-7, max=1e6, variability="fixed",
        )  # fmt: skip
        smooth: bool = variable(
            False, "Quintic ramps, with zero first and second derivatives at both ends, not straight ones"
        )
        point_time: tuple[float, ...] = variable(
            tuple(float(i) for i in range(points)), "Time of a point, later than that of the one before",
            unit="s", min=-1e9, max=1e9,
        )  # fmt: skip
        point_value: tuple[float, ...] = variable((0.0,) * points, "Value at a point", unit=unit)

    value = variable(0.0, "Value of the ramps at this time", unit=unit)
    outputs = make_dataclass("Outputs", [(output, float, value)], frozen=True)

    def requirements(p: Parameters, calculated: NoValues) -> tuple:
        return tuple(
            (p.point_time[i] < p.point_time[i + 1], f"point_time[{i + 2}] later than point_time[{i + 1}]")
            for i in range(points - 1)
        )

    return Block(
        name=name,
        description=f"Ramps through {points} points",
        parameters=Parameters,
        inputs=NoValues,
        state=NoValues,
        outputs=outputs,
        requirements=requirements,
        initial_state=lambda t, inputs, p, calculated: NoValues(),
        step=lambda t, h, state, inputs, p, calculated: state,
        output=lambda t, state, p, calculated: outputs(ramps(t, p.point_time, p.point_value, p.smooth)),
        stop_time=float(points - 1),
        step_size=0.1,
        guide=_GUIDE,
    )


_GUIDE = Guide(
    equations="""\
y(t) = y_i + (y_i+1 - y_i) f(s),   s = (t - t_i) / (t_i+1 - t_i)   between two points
f(s) = s                            smooth false
       10 s^3 - 15 s^4 + 6 s^5      smooth true
""",
    conventions=("The first value holds before the first point, the last one after the last.",),
    tuning=("Points that are not needed come after the last one that is, with its value.",),
    experiment=Experiment(step_size=0.1),
)
