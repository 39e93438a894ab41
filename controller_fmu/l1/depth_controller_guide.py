"""What the documentation of L1DepthController says besides its variables."""

from controller_fmu.depth_interface_guide import (
    CONVENTIONS,
    EXPERIMENT,
    OBSERVER_AND_ALLOCATION,
    OBSERVER_SOURCE,
    OBSERVER_TUNING,
    VEHICLE_LIMIT,
)
from controller_fmu.l1.parameters import EQUATIONS
from fmus.block.guide import Guide, Source

PAPER = Source(
    "Maalouf, Chemori and Creuze: A new extension of the L1 adaptive controller to drastically reduce the"
    " tracking time lags, NOLCOS 2013. Numbers in brackets are its equations.",
    "https://hal-lirmm.ccsd.cnrs.fr/lirmm-00841558",
)

LAW_LIMITS = (
    "The L1-norm condition covers the law without the extension u_p and with perfect measurements; delays"
    " and the lag of an actuator are outside it. The paper proves nothing about the loop with the"
    " extension. This FMU checks neither.",
    "Where input_gain_uncertainty is not 0, omega_hat multiplies u_a + u_p but learns from u_a alone:"
    " another reason why the proof does not cover the extension. input_gain_regressor lets it learn from"
    " both, which restores the Lyapunov argument and not the accuracy.",
    "While the actuator saturates, the prediction is driven by what it delivers, and the states of the"
    " filter and the integral of the PI are held where their change would demand still more. Noise that"
    " touches the limit all the time therefore slows them: keep the limit some noise above the demand.",
    "The reference feedforward and the piecewise-constant law are not from the paper. The feedforward is"
    " exact for the assumed A_m and a reference whose derivatives are given; at a corner of the reference"
    " its acceleration is an impulse, which is left out. The piecewise-constant law estimates e^(A_s Ts)"
    " times the disturbance, and has no bounds.",
    "The prediction is driven by the control that this FMU put out, held from one communication point to"
    " the next: internal_step should not be shorter than a communication step. Where the inputs of a step"
    " are those of its end (Gauss-Seidel), set inputs_at_step_end.",
)

GUIDE = Guide(
    equations=EQUATIONS
    + """
x            = (z, z'),   A_m = [[0, 1], [-k_m1 / M_z, -(D_z + k_m2) / M_z]],   B_m = [0, 1 / M_z]   (13)
"""
    + OBSERVER_AND_ALLOCATION,
    conventions=CONVENTIONS,
    tuning=(
        "Begin with the vehicle: model_inertia with added mass, model_damping, thruster_gain (N/V,"
        " measured) and voltage_limit. What is wrong here, the adaptation has to make up for.",
        "depth_feedback_gain and rate_feedback_gain make A_m, the dynamics that the loop is given. On a"
        " ramp the plain law lags by about (model_damping + rate_feedback_gain) / depth_feedback_gain"
        " seconds, and the filter adds about 1 / filter_bandwidth.",
        "filter_bandwidth: more lets the adaptive control act faster, and lets more noise and less margin"
        " to delays into the loop.",
        "adaptation_gain: more makes the estimates faster and noisier. It needs no shorter step, but the"
        " margin to sensor delay is smaller at 1000 than at 100, and a little larger again at 1e4: watch"
        " sigma_hat and the voltages, not the depth alone.",
        "theta_bound and sigma_bound enclose what must be compensated, in N; sigma_hat has to reach the"
        " net buoyancy. An estimate that stays on its bound says that the bound is too small or the loop"
        " too fast.",
        "Against the lag, set augmentation to pi: proportional_gain first, then little integral_gain; or"
        " to nonlinear_p, with a_1 = a_2 where the control should not jump at |e| = delta.",
        "If the derivatives of the reference are known, drive depth_reference_rate and"
        " depth_reference_acceleration and set reference_feedforward: inside leaves the lag of the filter,"
        " outside none. It combines with augmentation, which then acts on what error is left.",
        "adaptation_law piecewise_constant needs no adaptation_gain and no bounds, and has no fast loop, but"
        " differentiates the depth rate over adaptation_period: its estimates are noisier. A slow"
        " prediction_error_matrix A_s leaves the smallest offset; a Ts below the period of the depth sensor"
        " adds noise alone.",
        OBSERVER_TUNING,
    ),
    limits=(
        *LAW_LIMITS,
        "The paper publishes no gain of its vehicle: those here were fitted to the nominal row of its"
        " Table 1, or are guesses, as the column Source says, and were tried on the vehicle of"
        " RovDepthPlant alone.",
        "Tried on that plant, holding 0.8 m: with adaptation_gain 100 a sensor delay of 200 ms is harmless;"
        " with 1000, 60 ms make the depth oscillate.",
        VEHICLE_LIMIT,
    ),
    sources=(
        PAPER,
        OBSERVER_SOURCE,
        Source("T. Benedict and G. Bordner: Synthesis of an optimal set of radar track-while-scan smoothing"
               " equations, IRE Transactions on Automatic Control, 1962 (beta of an alpha)."),
    ),
    experiment=EXPERIMENT,
)  # fmt: skip
