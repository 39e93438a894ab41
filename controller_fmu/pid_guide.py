"""What the documentation of PidDepthController says besides its variables."""

from controller_fmu.depth_interface_guide import (
    CONVENTIONS,
    EXPERIMENT,
    LAGS,
    OBSERVER_AND_ALLOCATION,
    OBSERVER_SOURCE,
    OBSERVER_TUNING,
    REFERENCE_RATES,
    TRIED_ON,
    VEHICLE_LIMIT,
)
from fmus.block.guide import Guide, Source

EQUATIONS = """\
u     = -k_p e - k_i int e dt - k_d (v - beta r') + beta D r',   e = z - r
z / r = (beta (k_d + D) s^2 + k_p s + k_i) / (M s^3 + (D + k_d) s^2 + k_p s + k_i)
"""

GUIDE = Guide(
    equations=EQUATIONS + OBSERVER_AND_ALLOCATION,
    conventions=CONVENTIONS,
    tuning=(
        "Poles of M s^3 + (D + k_d) s^2 + k_p s + k_i: three at w for k_p = 3 M w^2, k_i = M w^3 and"
        " k_d = 3 M w - D.",
        "beta = 1 follows a ramp of known rate without error; beta = 0 takes the rate of the reference out of"
        " the law. It moves zeros, no pole.",
        OBSERVER_TUNING,
    ),
    limits=(
        REFERENCE_RATES,
        "The integral holds while the thrusters saturate and it would demand still more.",
        LAGS,
        TRIED_ON,
        VEHICLE_LIMIT,
    ),
    sources=(
        Source("K. J. Astrom and T. Hagglund: Advanced PID Control, ISA, 2006."),
        OBSERVER_SOURCE,
    ),
    experiment=EXPERIMENT,
)
