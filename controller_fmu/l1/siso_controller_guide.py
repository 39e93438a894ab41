"""What the documentation of L1Controller says besides its variables."""

from controller_fmu.l1.depth_controller_guide import LAW_LIMITS, PAPER
from controller_fmu.l1.parameters import EQUATIONS
from fmus.block.guide import Experiment, Guide, Source

GUIDE = Guide(
    equations=EQUATIONS
    + """
y            = C x,   u saturated at +-control_limit
""",
    conventions=(
        "All quantities are in the units of the plant at hand, time in s; the description calls them"
        " dimensionless.",
        "tracking_error is e = y - r: positive when the output is above the reference.",
        "prediction_error is x_hat - x, both of the time of the last measurement.",
    ),
    tuning=(
        "state_matrix (A_m, Hurwitz), input_vector (B_m) and output_vector (C) are the dynamics wanted,"
        " with feedback_gain k_m already in A_m: A_m = A - B_m k_m.",
        "theta_bound, sigma_bound and input_gain_uncertainty enclose what is unknown; a bound of 0 holds"
        " the estimate where it is.",
        "filter_bandwidth: the L1-norm condition asks for a least one, 44.5 rad/s for the start values"
        " with the first-order filter and 36.4 rad/s with the third-order one.",
        "adaptation_gain may be large: a step turns prediction error and estimates by the angle of their"
        " oscillation, exactly and however large.",
        "The lag of the plain law is that of A_m, not of the filter; augmentation takes it away. With"
        " nonlinear_p, a_1 = a_2 avoids a jump at |e| = delta; threshold_floor keeps delta from vanishing"
        " where the reference crosses zero.",
        "If the derivatives of the reference are known, drive reference_rate and reference_acceleration and"
        " set reference_feedforward: inside leaves the lag of the filter, outside none. It needs C B_m = 0.",
        "adaptation_law piecewise_constant has no fast loop and needs no gain or bounds; set"
        " adaptation_period to the communication step, and prediction_error_matrix A_s so slow that"
        " e^(A_s Ts) is near I.",
    ),
    limits=(
        *LAW_LIMITS,
        "Second order, one input, one output, the whole state measured.",
        "Start values are the paper's illustrative example, a_1 and a_2 as printed: u_p then jumps by a"
        " factor of 4 at |e| = delta.",
    ),
    sources=(
        PAPER,
        Source("N. Hovakimyan and C. Cao: L1 Adaptive Control Theory, SIAM, 2010 (the example, page 29)."),
    ),
    experiment=Experiment(
        stop_time=4.0,
        stimuli=(
            ("reference", ((0.0, 1.175), (2.0, 1.425), (2.1, 1.5), (2.4, 1.5), (4.0, 1.675))),
            ("measured_state[1]", ((0.0, 1.0), (4.0, 1.5))),
            ("measured_state[2]", ((0.0, 0.125), (3.0, 0.125), (3.2, 0.13))),
        ),
    ),
)
