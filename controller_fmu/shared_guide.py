"""Sentences and sources that the guides of several blocks share."""

from fmus.block.guide import Experiment, Guide, Source

PAPER = Source(
    "Maalouf, Chemori and Creuze: A new extension of the L1 adaptive controller to drastically reduce the"
    " tracking time lags, NOLCOS 2013. Numbers in brackets are its equations.",
    "https://hal-lirmm.ccsd.cnrs.fr/lirmm-00841558",
)
CONVENTIONS = (
    "Depth and every force are positive down.",
    "A positive voltage gives a force along the body's z axis, downwards when the vehicle is upright;"
    " each thruster takes half of the demand.",
    "tracking_error is measured depth minus reference: positive when the vehicle is too deep.",
    "Angles are in rad; roll and pitch may stay at 0 if they are not measured.",
    "With thruster_tabulated, voltages are interpolated linearly over thruster_table_force. thruster_scale n"
    " is the number of thrusters that a voltage drives. Table and n describe the vehicle. A force of"
    " exactly 0 gives 0 V.",
)
ALLOCATION = """\
voltage_i    = J u / (2 K_i), saturated,   J = cos(roll) cos(pitch)   Maalouf et al. (2013), (11)
             or table^-1(J u / (2 n_i)), which jumps over the dead band where the sign changes
"""
OBSERVER = """\
observer     z_p = z_hat + T_o v_hat, z_hat = z_p + alpha_o (z - z_p), v_hat = v_hat + beta_o (z - z_p) / T_o
"""
OBSERVER_TUNING = (
    "observer_period is the sampling period of the depth sensor. For each observer_alpha, set"
    " observer_beta = observer_alpha^2 / (2 - observer_alpha). With a measured depth rate, set"
    " velocity_source to measured."
)
VEHICLE_LIMIT = "A vehicle on its side (J near 0) cannot push vertically: its thrust for the depth is near 0."
REFERENCE_RATES = (
    "depth_reference_rate and depth_reference_acceleration may stay at 0 if only the depth is given."
    " The loop then follows a ramp with a lag, as the equations say."
)
HELD_CONTROL = (
    "A communication step should not be longer than internal_step: the controller takes its newest voltages"
    " as applied, the plant gets them at the end of the communication step."
)
OBSERVER_SOURCE = Source("R. Penoyer: The alpha-beta filter, C User's Journal 11(7), 1993 (the observer).")

EXPERIMENT = Experiment(
    stop_time=20.0,
    stimuli=(
        ("depth_reference", ((1.0, 0.0), (9.0, 0.4))),
        ("measured_depth", ((3.0, 0.0), (12.0, 0.36), (18.0, 0.4))),
        ("roll", ((5.0, 0.0), (10.0, 0.2), (15.0, 0.0))),
    ),
)
"""A reference that the measured depth follows late."""

_OF_BASELINES = (
    "The stated poles and proofs hold for ideal measurements and thrusters. Observer, sensor, thrusters and"
    " the held control delay the loop by about 0.2 s with the start values: a loop several times as fast"
    " oscillates.",
    "The gains follow from the inertia (an estimate) and the damping (a guess) of RovDepthPlant. They were"
    " tried on that plant alone.",
    VEHICLE_LIMIT,
)


def depth_guide(
    equations: str,
    tuning: tuple[str, ...],
    limits: tuple[str, ...],
    sources: tuple[Source, ...],
    has_observer: bool = True,
) -> Guide:
    """Returns the guide of a depth controller without the L1 law, with the sentences for all of them.

    has_observer: whether the depth rate comes from the alpha-beta observer
    """
    equations, limits = equations + ALLOCATION, limits + _OF_BASELINES
    if has_observer:
        equations, tuning = equations + OBSERVER, (*tuning, OBSERVER_TUNING)
        sources = (*sources, OBSERVER_SOURCE)
    return Guide(equations, CONVENTIONS, tuning, limits, sources, EXPERIMENT)
