"""Block DepthReference: the depth reference as ramps through given points, and its derivatives.

Straight or quintic lines through (point_time, point_depth), held before the first and after the last
point. For an importer without other means to give the controller its reference.
"""

from dataclasses import dataclass

from controller_fmu import shared_guide
from fmus.block import Block, NoValues, variable
from fmus.block.guide import Experiment, Guide
from fmus.numerics import ramp_rates, ramps

# spare points come later than the last wanted one, at the same depth: an FMU's vectors have a fixed size
POINTS = 12

_SHIPPED = "published: Maalouf et al. (2013), section 5.2; straight ramps are assumed"


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(
        10.0,
        "Longest internal step; without effect, the reference follows from the time alone",
        unit="s",
        min=1e-7,
        max=1e6,
        variability="fixed",
    )
    smooth: bool = variable(
        False,
        "Quintic ramps, with zero speed and acceleration at both ends of each, instead of straight ones",
    )
    point_time: tuple[float, ...] = variable(
        (0.0, 40.0, 140.0, 180.0, 250.0, 310.0, 320.0, 330.0, 340.0, 350.0, 360.0, 370.0),
        "Time of a point, later than the time of the point before",
        unit="s",
        min=-1e9,
        max=1e9,
        source=_SHIPPED,
    )
    point_depth: tuple[float, ...] = variable(
        (0.0, 0.8, 0.8, 0.4, 0.4, 0.6, 0.6, 0.6, 0.6, 0.6, 0.6, 0.6),
        "Depth at a point, positive down",
        unit="m",
        min=-1e4,
        max=1e4,
        source=_SHIPPED,
    )


@dataclass(frozen=True)
class Outputs:
    depth_reference: float = variable(0.0, "Depth reference r, positive down", unit="m")
    depth_reference_rate: float = variable(0.0, "Its derivative r'", unit="m/s")
    depth_reference_acceleration: float = variable(
        0.0, "Its second derivative r'', 0 of straight ramps", unit="m/s2"
    )


def requirements(p: Parameters, calculated: NoValues) -> tuple:
    return tuple(
        (p.point_time[i] < p.point_time[i + 1], f"point_time[{i + 2}] later than point_time[{i + 1}]")
        for i in range(POINTS - 1)
    )


def output(t: float, state: NoValues, p: Parameters, calculated: NoValues) -> Outputs:
    rate, acceleration = ramp_rates(t, p.point_time, p.point_depth, p.smooth)
    return Outputs(ramps(t, p.point_time, p.point_depth, p.smooth), rate, acceleration)


GUIDE = Guide(
    equations="""\
z(t) = z_i + (z_i+1 - z_i) f(s),   s = (t - t_i) / (t_i+1 - t_i)   between two points
f(s) = s                            smooth false
       10 s^3 - 15 s^4 + 6 s^5      smooth true: no speed and no acceleration at the points
z'(t)  = (z_i+1 - z_i) f'(s) / (t_i+1 - t_i),   z''(t) = (z_i+1 - z_i) f''(s) / (t_i+1 - t_i)^2
""",
    conventions=(
        "Depth is positive down and 0 at the surface.",
        "The first depth holds before the first point, the last one after the last.",
        "At a point the derivatives belong to the ramp after it. Straight ramps have an acceleration of 0"
        " everywhere: the impulse by which the speed jumps at a point is left out.",
    ),
    tuning=(
        "Set point_time[i] and point_depth[i]; all twelve times must increase. Put unused points after the"
        " last used one, at its depth.",
        "Connect depth_reference_rate and depth_reference_acceleration to a controller that uses them.",
        "smooth removes the kinks, where the demand of a controller jumps. The largest speed of a smooth ramp"
        " is 1.875 times the speed of the straight ramp.",
    ),
    limits=(
        "There are twelve points, and no repetition.",
        "Times and levels of the start values are published, straight ramps between them are assumed.",
    ),
    sources=(shared_guide.PAPER,),
    experiment=Experiment(stop_time=320.0, step_size=0.8),
)


BLOCK = Block.of_module(
    __name__,
    "DepthReference",
    "Depth reference as ramps through given points, with its derivatives",
    stop_time=310.0,
    step_size=0.02,
    license="MIT",
)
