"""What the documentation of AdrcDepthController says besides its variables."""

from controller_fmu.depth_interface_guide import (
    ALLOCATION,
    CONVENTIONS,
    EXPERIMENT,
    HELD_CONTROL,
    LAGS,
    REFERENCE_RATES,
    TRIED_ON,
    VEHICLE_LIMIT,
)
from fmus.block.guide import Guide, Source

EQUATIONS = """\
z_1' = z_2 + 3 w_o (z - z_1)
z_2' = z_3 + u_d / M + 3 w_o^2 (z - z_1)
z_3' = w_o^3 (z - z_1)
u    = M (w_c^2 (r - z_1) + 2 w_c (r' - z_2) + r'' - z_3)
"""

GUIDE = Guide(
    equations=EQUATIONS + ALLOCATION,
    conventions=CONVENTIONS,
    tuning=(
        "control_bandwidth first, from the wanted speed of the loop; observer_bandwidth 3 to 5 times that,"
        " as far as noise and lags of the loop allow.",
        "model_inertia is the b_0 = 1 / M of the literature, the only number of the vehicle's dynamics.",
    ),
    limits=(
        "The extended state observer takes the place of the alpha-beta observer: the law uses the measured"
        " depth alone, not measured_depth_rate. estimated_depth_rate is its z_2.",
        "A step is exact for a measurement that is held, so it is stable for any step and any w_o.",
        "The observer is driven by the force that the thrusters deliver: while they saturate, z_3 is still"
        " the disturbance, and the estimate does not wind up.",
        HELD_CONTROL,
        REFERENCE_RATES,
        LAGS,
        TRIED_ON,
        VEHICLE_LIMIT,
    ),
    sources=(
        Source("J. Han: From PID to active disturbance rejection control, IEEE Transactions on Industrial"
               " Electronics 56, 2009."),
        Source("Z. Gao: Scaling and bandwidth-parameterization based controller tuning, American Control"
               " Conference, 2003."),
    ),
    experiment=EXPERIMENT,
)  # fmt: skip
