"""What the documentation of SlidingModeDepthController says besides its variables."""

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
s = e' + 2 lambda e + lambda^2 int e dt,   e = z - r,   e' = v - r'
u = M (r'' - 2 lambda e' - lambda^2 e) + D v - K sat(s / phi)
"""

GUIDE = Guide(
    equations=EQUATIONS + OBSERVER_AND_ALLOCATION,
    conventions=CONVENTIONS,
    tuning=(
        "switching_gain: above the largest disturbance, buoyancy included, and below what both thrusters"
        " give.",
        "boundary_layer: K / (M phi) is the third pole inside the layer; a thinner layer makes it as fast as"
        " the lags of the loop, and the voltages chatter.",
        "error_bandwidth is both other poles.",
        OBSERVER_TUNING,
    ),
    limits=(
        "Inside the boundary layer the law is a PID with k_p = M lambda^2 + 2 lambda K / phi,"
        " k_i = lambda^2 K / phi and k_d = 2 lambda M + K / phi - D; it differs from one only where the error"
        " leaves the layer.",
        REFERENCE_RATES,
        "The integral holds while the thrusters saturate and it would demand still more.",
        LAGS,
        TRIED_ON,
        VEHICLE_LIMIT,
    ),
    sources=(
        Source("J.-J. Slotine and W. Li: Applied Nonlinear Control, Prentice Hall, 1991, chapter 7."),
        Source("V. Utkin, J. Guldner and J. Shi: Sliding Mode Control in Electro-Mechanical Systems, 2009."),
        OBSERVER_SOURCE,
    ),
    experiment=EXPERIMENT,
)
