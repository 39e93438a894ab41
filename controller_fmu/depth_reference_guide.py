"""What the documentation of DepthReference says besides its variables."""

from controller_fmu.l1.depth_controller_guide import PAPER
from fmus.block.guide import Experiment, Guide

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
        "At a point the derivatives are those of the time after it. Straight ramps have an acceleration of 0"
        " everywhere: the impulse by which the speed jumps at a point is left out.",
    ),
    tuning=(
        "Set point_time[i] and point_depth[i]; all twelve times must increase. Points that are not needed"
        " come after the last wanted one, at its depth.",
        "Connect depth_reference_rate and depth_reference_acceleration to a controller that has a reference"
        " feedforward; others need neither.",
        "smooth removes the kinks, which a controller answers with a jump in its demand; the greatest"
        " speed of a ramp then is 1.875 times that of the straight one.",
    ),
    limits=(
        "Twelve points, one trajectory; nothing is repeated.",
        "Times and levels of the start values are published, straight ramps between them are assumed.",
    ),
    sources=(PAPER,),
    experiment=Experiment(stop_time=320.0, step_size=0.8),
)
