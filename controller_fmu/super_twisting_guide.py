"""What the documentation of SuperTwistingDepthController says besides its variables."""

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
s = e' + lambda e,   e = z - r,   e' = v - r',   g = s / (|s| + eps)
u = M (r'' - lambda e') + D v - k_1 sqrt(|s|) g + nu,   nu' = -k_2 g
g = s / max(|s| + eps, (h / M) (k_1 sqrt(|s|) + h k_2))   in a step of h s
"""

GUIDE = Guide(
    equations=EQUATIONS + OBSERVER_AND_ALLOCATION,
    conventions=CONVENTIONS,
    tuning=(
        "For disturbances that change by L at most, in N/s: root_gain 1.5 sqrt(L M), twisting_gain 1.1 L.",
        "Estimate: a loop that is late by T s oscillates where |s| is below about (k_2 T / k_1)^2, as there"
        " the damping by k_1 is less than the delay takes. Smaller gains make it quieter, and slower against"
        " disturbances.",
        "smoothing: of the order of the noise of the depth rate.",
        OBSERVER_TUNING,
    ),
    limits=(
        "Finite time is that of eps = 0 and an ideal loop; with eps, noise and lags the error stays in a"
        " neighbourhood of 0.",
        REFERENCE_RATES,
        "nu holds while the thrusters saturate and it would demand still more.",
        LAGS,
        TRIED_ON,
        VEHICLE_LIMIT,
    ),
    sources=(
        Source("A. Levant: Sliding order and sliding accuracy in sliding mode control, Int. J. Control 58,"
               " 1993; Robust exact differentiation via sliding mode technique, Automatica 34, 1998."),
        Source("J. Moreno and M. Osorio: Strict Lyapunov functions for the super-twisting algorithm, IEEE"
               " Transactions on Automatic Control 57, 2012."),
        Source("B. Brogliato, A. Polyakov and D. Efimov: The implicit discretization of the supertwisting"
               " sliding-mode control algorithm, IEEE Transactions on Automatic Control 65, 2020."),
        OBSERVER_SOURCE,
    ),
    experiment=EXPERIMENT,
)  # fmt: skip
