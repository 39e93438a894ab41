"""What the documentation of MracDepthController says besides its variables."""

from controller_fmu.depth_interface_guide import (
    CONVENTIONS,
    EXPERIMENT,
    HELD_CONTROL,
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
u          = -k_m x + f - theta_hat |x|_inf - sigma_hat,   x = (z, v)
f          = M r'' + (D + k_m2) r' + k_m1 r                which is k_g r where r' and r'' are 0
x_m'       = A_m x_m + B_m (f + u_d - u)                   u_d - u: what saturation withholds
theta_hat' = Gamma Proj(theta_hat, (x - x_m)^T P B_m |x|_inf)
sigma_hat' = Gamma Proj(sigma_hat, (x - x_m)^T P B_m),     A_m^T P + P A_m = -Q
"""

GUIDE = Guide(
    equations=EQUATIONS + OBSERVER_AND_ALLOCATION,
    conventions=CONVENTIONS,
    tuning=(
        "depth_gain and rate_gain make A_m, the dynamics that the loop is given: M w^2 and 2 M w - D for two"
        " poles at w.",
        "estimate_gain: with Q = I and both poles of A_m at 1 rad/s, Gamma = M^2 puts the poles of the loop"
        " of sigma_hat at -1 and -0.5 +- 0.5j rad/s. More is faster and less damped: the vehicle itself, with"
        " all its lags, closes that loop, so the very high Gamma of the L1 law is out of reach here.",
        "theta_bound and sigma_bound enclose what must be compensated, in N; sigma_hat has to reach the net"
        " buoyancy.",
        OBSERVER_TUNING,
    ),
    limits=(
        "There is no low-pass filter between estimates and control: Gamma trades robustness for speed.",
        "While the thrusters saturate, the reference model is driven by what they deliver, so the estimates"
        " do not learn it.",
        HELD_CONTROL,
        REFERENCE_RATES,
        LAGS,
        TRIED_ON,
        VEHICLE_LIMIT,
    ),
    sources=(
        Source("P. Ioannou and J. Sun: Robust Adaptive Control, Prentice Hall, 1996, chapter 6."),
        Source("E. Lavretsky and K. Wise: Robust and Adaptive Control, Springer, 2013."),
        OBSERVER_SOURCE,
    ),
    experiment=EXPERIMENT,
)
