"""What the documentation of L1DepthController says besides its variables."""

from fmus.guide import Experiment, Guide, Source

PAPER = Source(
    "Maalouf, Chemori and Creuze: A new extension of the L1 adaptive controller to drastically reduce the"
    " tracking time lags, NOLCOS 2013. Numbers in brackets are its equations.",
    "https://hal-lirmm.ccsd.cnrs.fr/lirmm-00841558",
)

LAW = """\
u            = u_m + u_a + u_p,   u_m = -k_m x
x_hat'       = A_m x_hat + B_m (omega_hat (u_a + u_p) + theta_hat^T phi + sigma_hat)      (5)
theta_hat_i' = Gamma Proj(theta_hat_i, -(x_tilde^T P B_m) phi_i),   x_tilde = x_hat - x   (4)
sigma_hat'   = Gamma Proj(sigma_hat, -(x_tilde^T P B_m))
omega_hat'   = Gamma Proj(omega_hat, -(x_tilde^T P B_m) u_a)
u_a(s)       = -k D(s) (omega_hat u_a + theta_hat^T phi + sigma_hat - k_g r)              (6)
A_m^T P + P A_m = -Q,   k_g = -1 / (C A_m^-1 B_m)

phi          = (|x|_inf, 0)   regressor infinity_norm
               x              regressor state
C(s)         = w / (s + w)                         filter_order first
               (3 w^2 s + w^3) / (s + w)^3         filter_order third

u_p          = 0                                   augmentation none
               -K_P e - K_I int e dt,   e = y - r  augmentation pi            (7)
               -a_1 |e|^alpha sgn(e)               augmentation nonlinear_p   (8), |e| > delta
               -a_2 e / delta^(1 - alpha)                                     (8), elsewhere
"""

LAW_LIMITS = (
    "The L1-norm condition covers the law without the extension u_p and with perfect measurements; delays"
    " and the lag of an actuator are outside it. The paper proves nothing about the loop with the"
    " extension. This FMU checks neither.",
    "Where input_gain_uncertainty is not 0, omega_hat multiplies u_a + u_p but learns from u_a alone:"
    " another reason why the proof does not cover the extension.",
    "While the actuator saturates, the predictor is told what was delivered, and the states of the filter"
    " and the integral of the PI are held where their change would demand still more.",
)

GUIDE = Guide(
    equations=LAW
    + """
x            = (z, z'),   A_m = [[0, 1], [-k_m1 / M_z, -(D_z + k_m2) / M_z]],   B_m = [0, 1 / M_z]   (13)
voltage_i    = J u / (2 K_i), saturated,   J = cos(roll) cos(pitch)                                  (11)
observer     z_p = z_hat + T v_hat,   z_hat = z_p + alpha (z - z_p),   v_hat = v_hat + beta / T (z - z_p)
""",
    conventions=(
        "Depth is positive down, and so is every force; a positive demand pushes the vehicle down.",
        "A positive voltage gives a force along the body's z axis, downwards when the vehicle is upright;"
        " each thruster takes half of the demand.",
        "tracking_error is measured depth minus reference: positive when the vehicle is too deep.",
        "Angles are in rad; roll and pitch may stay at 0 where they are not measured.",
    ),
    tuning=(
        "Begin with the vehicle: model_inertia with added mass, model_damping, thruster_gain (N/V,"
        " measured) and voltage_limit. What is wrong here, the adaptation has to make up for.",
        "depth_feedback_gain and rate_feedback_gain make A_m, the dynamics that the loop is given. On a"
        " ramp the plain law lags by about (model_damping + rate_feedback_gain) / depth_feedback_gain"
        " seconds, and the filter adds about 1 / filter_bandwidth.",
        "filter_bandwidth: more lets the adaptive control act faster, and lets more noise and less margin"
        " to delays into the loop.",
        "adaptation_gain: more makes the estimates faster and noisier. It needs no shorter step, but the"
        " margin to sensor delay shrinks: watch sigma_hat and the voltages, not the depth alone.",
        "theta_bound and sigma_bound enclose what must be compensated, in N; sigma_hat has to reach the"
        " net buoyancy. An estimate that stays on its bound says that the bound is too small or the loop"
        " too fast.",
        "Against the lag, set augmentation to pi: proportional_gain first, then little integral_gain; or"
        " to nonlinear_p, with a_1 = a_2 where the control should not jump at |e| = delta.",
        "observer_period is the sampling period of the depth sensor; beta = alpha^2 / (2 - alpha) goes"
        " with an alpha. With a measured depth rate, set velocity_source to measured.",
    ),
    limits=(
        *LAW_LIMITS,
        "The paper publishes no gain of its vehicle: those here were fitted to the nominal row of its"
        " Table 1, or are guesses, as the column Source says, and were tried on the vehicle of"
        " RovDepthPlant alone.",
        "Tried on that plant, holding 0.8 m with augmentation pi: with adaptation_gain 100 a sensor delay"
        " of 100 ms is harmless; with 1000, 60 ms make the depth oscillate.",
        "A vehicle that lies on its side (J near 0) cannot push vertically, and nothing here tries to.",
    ),
    sources=(
        PAPER,
        Source("R. Penoyer: The alpha-beta filter, C User's Journal 11(7), 1993 (the observer)."),
        Source("T. Benedict and G. Bordner: Synthesis of an optimal set of radar track-while-scan smoothing"
               " equations, IRE Transactions on Automatic Control, 1962 (beta of an alpha)."),
    ),
    experiment=Experiment(
        stop_time=20.0,
        stimuli=(
            ("depth_reference", ((1.0, 0.0), (9.0, 0.4))),
            ("measured_depth", ((3.0, 0.0), (12.0, 0.36), (18.0, 0.4))),
            ("roll", ((5.0, 0.0), (10.0, 0.2), (15.0, 0.0))),
        ),
    ),
)  # fmt: skip
