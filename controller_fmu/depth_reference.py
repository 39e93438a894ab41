"""Block DepthReference: the depth that is wanted, as ramps through given points.

Straight or quintic lines through (point_time, point_depth), held before the first and after the last
point. A system that is handed on without its scenario, such as an SSP package, carries its reference in it.
"""

from dataclasses import dataclass
from itertools import pairwise

from controller_fmu.depth_reference_guide import GUIDE
from fmus.block import Block, NoValues, variable
from fmus.numerics import where

POINTS = 12  # spare ones come later than the last wanted one, at the same depth

_SHIPPED = "published: Maalouf et al. (2013), section 5.2; straight ramps are assumed"


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(
        10.0, "Longest internal step; without effect, the reference follows from the time alone",
        unit="s", min=1e-7, max=1e6, variability="fixed",
    )  # fmt: skip
    smooth: bool = variable(
        False,
        "Quintic ramps, with zero speed and acceleration at both ends of each, instead of straight ones",
    )
    point_time: tuple[float, ...] = variable(
        (0.0, 40.0, 140.0, 180.0, 250.0, 310.0, 320.0, 330.0, 340.0, 350.0, 360.0, 370.0),
        "Time of a point, later than that of the one before", unit="s", min=-1e9, max=1e9,
        source=_SHIPPED,
    )  # fmt: skip
    point_depth: tuple[float, ...] = variable(
        (0.0, 0.8, 0.8, 0.4, 0.4, 0.6, 0.6, 0.6, 0.6, 0.6, 0.6, 0.6),
        "Depth at a point, positive down", unit="m", min=-1e4, max=1e4, source=_SHIPPED,
    )  # fmt: skip


@dataclass(frozen=True)
class Outputs:
    depth_reference: float = variable(0.0, "Depth reference, positive down", unit="m")


def requirements(p: Parameters, calculated: NoValues) -> tuple:
    return tuple(
        (p.point_time[i] < p.point_time[i + 1], f"point_time[{i + 2}] later than point_time[{i + 1}]")
        for i in range(POINTS - 1)
    )


def initial_state(t: float, inputs: NoValues, p: Parameters, calculated: NoValues) -> NoValues:
    return NoValues()


def step(
    t: float, h: float, state: NoValues, inputs: NoValues, p: Parameters, calculated: NoValues
) -> NoValues:
    return state


def output(t: float, state: NoValues, p: Parameters, calculated: NoValues) -> Outputs:
    points = list(zip(p.point_time, p.point_depth, strict=True))
    depth = points[-1][1]
    for (t_0, z_0), (t_1, z_1) in reversed(list(pairwise(points))):
        s = (t - t_0) / (t_1 - t_0)
        depth = where(t <= t_1, z_0 + (z_1 - z_0) * where(p.smooth, _quintic(s), s), depth)
    return Outputs(depth_reference=where(t <= points[0][0], points[0][1], depth))


def _quintic(s: float) -> float:
    """0 to 1 with zero first and second derivatives at both ends."""
    return s**3 * (10.0 + s * (6.0 * s - 15.0))


BLOCK = Block(
    name="DepthReference",
    description="Depth reference as ramps through given points",
    parameters=Parameters,
    inputs=NoValues,
    state=NoValues,
    outputs=Outputs,
    requirements=requirements,
    initial_state=initial_state,
    step=step,
    output=output,
    stop_time=310.0,
    step_size=0.02,
    guide=GUIDE,
)
