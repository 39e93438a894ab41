"""Block L1HeavePitchController: the law of L1DepthController for the depth and, a second time, for the pitch.

The pitch is an axis like the depth, with its moment in place of the force, its measurement and its gains:

    I q' = M - K theta - D q,   theta' = q    assumed;   A_m = [[0, 1], [-(K + k_m1) / I, -(D + k_m2) / I]]

The adaptation of each axis compensates the effect of the other: no published law of both axes was found.
Depth is positive down, pitch theta and moment M are positive bow up.
"""

from dataclasses import asdict, dataclass, fields, replace
from enum import IntEnum

from controller_fmu import allocation, depth_interface, shared_guide
from controller_fmu.depth_interface import Delivery, DepthInputs, Vector
from controller_fmu.depth_model import depth_matrices
from controller_fmu.l1 import depth_controller as axis
from controller_fmu.l1.depth_controller import State as AxisState
from controller_fmu.l1.law import Control
from controller_fmu.l1.matrices import Matrix, is_hurwitz, sampled_prediction
from controller_fmu.l1.parameters import LARGEST_BOUND, Augmentation, ReferenceFeedforward
from fmus.block import variable
from fmus.block.guide import Experiment, Guide

_POLES = "both poles of A_m at w = 3 rad/s: "
_GUESS = "guess: a small vehicle as in RovHeavePitchPlant"


class Priority(IntEnum):
    """Axis that keeps its demand where the thrusters cannot give both."""

    HEAVE = 1
    PITCH = 2


@dataclass(frozen=True)
class Parameters(axis.Parameters):
    """Parameters of the depth, and own parameters of the pitch."""

    thruster_lever: Vector = variable(
        (0.06, -0.06),
        "Lever x of each thruster, forward of the centre of gravity",
        unit="m",
        min=(1e-3, -1e3),
        max=(1e3, -1e-3),
        source=_GUESS,
    )
    priority: Priority = variable(
        Priority.HEAVE, "Axis that keeps its demand at the limit of the thrusters", variability="fixed"
    )
    pitch_model_inertia: float = variable(
        0.026,
        "Pitch inertia with added mass I that the design assumes",
        unit="kg.m2",
        min=1e-6,
        max=1e6,
        source=_GUESS,
    )
    pitch_model_damping: float = variable(
        0.02,
        "Linear pitch damping D that the design assumes",
        unit="N.m.s/rad",
        min=0.0,
        max=1e6,
        source=_GUESS,
    )
    pitch_model_stiffness: float = variable(
        0.147,
        "Righting moment K of a radian that the design assumes",
        unit="N.m/rad",
        min=0.0,
        max=1e6,
        source="guess: a weight of 29.43 N (published: 3 kg) 5 mm below the centre of buoyancy",
    )
    pitch_feedback_gain: float = variable(
        0.087, "k_m of the pitch", unit="N.m/rad", min=-1e6, max=1e6, source=_POLES + "I w^2 - K"
    )
    pitch_rate_feedback_gain: float = variable(
        0.136, "k_m of the pitch rate", unit="N.m.s/rad", min=-1e6, max=1e6, source=_POLES + "2 I w - D"
    )
    pitch_adaptation_gain: float = variable(
        0.1,
        "Adaptation gain Gamma of the pitch",
        min=0.0,
        max=1e9,
        source="guess: the loop of sigma_hat at sqrt(Gamma (P B)_2 B_2) = 3.7 rad/s, near A_m",
    )
    pitch_filter_bandwidth: float = variable(
        1.0,
        "Bandwidth w of the filter C(s) of the pitch",
        unit="rad/s",
        min=1e-6,
        max=1e6,
        source="guess: a third of the poles of A_m",
    )
    pitch_theta_bound: Vector = variable(
        (0.05, 0.05),
        "Bound of |theta_hat| of the pitch",
        unit="N.m",
        min=0.0,
        max=LARGEST_BOUND,
        source="guess; N.m per SI unit of the regressor",
    )
    pitch_sigma_bound: float = variable(
        0.3,
        "Bound of |sigma_hat| of the pitch",
        unit="N.m",
        min=0.0,
        max=1e6,
        source="guess: below the largest moment of both thrusters, 0.36 N.m",
    )
    pitch_augmentation: Augmentation = variable(
        Augmentation.NONE, "Extension u_p of the pitch: none or pi", variability="fixed"
    )
    pitch_proportional_gain: float = variable(
        0.05, "K_P of the PI of the pitch", unit="N.m/rad", min=0.0, max=1e6, source="guess"
    )
    pitch_integral_gain: float = variable(
        0.02, "K_I of the PI of the pitch", unit="N.m/(rad.s)", min=0.0, max=1e6, source="guess"
    )


@dataclass(frozen=True)
class Inputs(DepthInputs):
    pitch_reference: float = variable(0.0, "Reference of the pitch, bow up", unit="rad")
    measured_pitch: float = variable(0.0, "Measured pitch theta, positive bow up", unit="rad")
    measured_pitch_rate: float = variable(
        0.0, "Pitch rate q, used when velocity_source is measured", unit="rad/s"
    )


@dataclass(frozen=True)
class Matrices(axis.Matrices):
    """The calculated parameters of the depth and of the pitch."""

    pitch_predictor_matrix: Matrix = variable(
        ((0.0, 1.0), (-9.0, -6.0)), "A_m of the pitch", unit=(("1/s", "1"), ("1/s2", "1/s"))
    )
    pitch_predictor_input: Vector = variable((0.0, 38.0), "B_m of the pitch", unit=("s/(kg.m2)", "1/(kg.m2)"))
    pitch_lyapunov_matrix: Matrix = variable(((1.0, 0.0), (0.0, 1.0)), "P of the pitch")
    pitch_adaptation_vector: Vector = variable((0.0, 1.0), "P B_m of the pitch")
    pitch_feedforward_gain: float = variable(1.0, "k_g of the pitch", unit="N.m/rad")
    pitch_unmatched_input: Vector = variable((1.0, 0.0), "B_u of the pitch")
    pitch_estimation_gain: Matrix = variable(
        ((0.0, 1.0), (1.0, 0.0)),
        "Prediction error to estimates of the pitch",
        unit=(("N.m/rad", "N.m.s/rad"), ("1/s", "1")),
    )
    thruster_share: Vector = variable((0.5, 0.5), "Share of the force that each thruster takes")


@dataclass(frozen=True)
class State:
    depth: AxisState = AxisState()
    pitch: AxisState = AxisState()


@dataclass(frozen=True)
class Outputs(axis.Outputs):
    demanded_moment: float = variable(0.0, "Demand u of the pitch, positive bow up", unit="N.m")
    pitch_tracking_error: float = variable(0.0, "theta - r of the pitch", unit="rad")
    estimated_pitch_rate: float = variable(0.0, "Pitch rate that the law uses", unit="rad/s")
    pitch_u_m: float = variable(0.0, "State feedback of the pitch", unit="N.m")
    pitch_u_a: float = variable(0.0, "Adaptive control of the pitch", unit="N.m")
    pitch_u_p: float = variable(0.0, "Extension of the pitch", unit="N.m")
    pitch_theta_hat: Vector = variable((0.0, 0.0), "theta_hat of the pitch, per SI unit", unit="N.m")
    pitch_sigma_hat: float = variable(0.0, "sigma_hat of the pitch", unit="N.m")


def _of_pitch(declared: type) -> list[tuple[str, str]]:
    """Returns names of the depth axis, each with its counterpart of the pitch axis, "pitch_" and the name."""
    names = [field.name for field in fields(declared)]
    own = [(name, f"pitch_{name}") for name in names if f"pitch_{name}" in names]
    return [*own, ("depth_feedback_gain", "pitch_feedback_gain")] if declared is Parameters else own


_PARAMETERS, _MATRICES, _OUTPUTS = map(_of_pitch, (Parameters, Matrices, Outputs))


def calculate(p: Parameters) -> Matrices:
    of_pitch = _pitch_parameters(p)
    # A_m depends on the sum of stiffness and feedback alone
    total = p.pitch_model_stiffness + p.pitch_feedback_gain, p.pitch_rate_feedback_gain
    pitch = depth_matrices(total, p.lyapunov_weight, of_pitch)
    sampled = sampled_prediction(pitch.predictor_input, p.prediction_error_matrix, p.adaptation_period)
    values = asdict(pitch) | asdict(sampled)
    own = {of_pitch: values[name] for name, of_pitch in _MATRICES}
    return Matrices(**asdict(axis.calculate(p)), **own, thruster_share=allocation.shares(p.thruster_lever))


def requirements(p: Parameters, matrices: Matrices) -> tuple:
    return (
        *axis.requirements(p, matrices),
        (is_hurwitz(matrices.pitch_predictor_matrix), "a Hurwitz A_m of the pitch"),
        (p.pitch_augmentation != Augmentation.NONLINEAR_P, "pitch_augmentation none or pi"),
    )


def initial_state(t: float, inputs: Inputs, p: Parameters, matrices: Matrices) -> State:
    """Returns the state at rest on the first measurement of both axes."""
    return State(
        axis.initial_state(t, inputs, p, matrices),
        axis.initial_state(t, _pitch_inputs(inputs), _pitch_parameters(p), _pitch_matrices(matrices)),
    )


def step(t: float, h: float, state: State, inputs: Inputs, p: Parameters, matrices: Matrices) -> State:
    of_pitch = _pitch_parameters(p)
    u, u_pitch = _controls(state, p, of_pitch)
    force, moment = _deliver(u.total, u_pitch.total, state.depth.interface.j, p, matrices)
    return State(
        axis.after_delivery(t, h, state.depth, inputs, u, force, p, matrices),
        axis.after_delivery(
            t, h, state.pitch, _pitch_inputs(inputs), u_pitch, moment, of_pitch, _pitch_matrices(matrices)
        ),
    )


def output(t: float, state: State, p: Parameters, matrices: Matrices) -> Outputs:
    of_pitch = _pitch_parameters(p)
    u, u_pitch = _controls(state, p, of_pitch)
    force, _ = _deliver(u.total, u_pitch.total, state.depth.interface.j, p, matrices)
    depth = asdict(axis.output(t, state.depth, p, matrices)) | {"voltage": force.voltage}
    pitch = asdict(axis.output(t, state.pitch, of_pitch, _pitch_matrices(matrices)))
    return Outputs(
        **depth,
        **{name: pitch[of_depth] for of_depth, name in _OUTPUTS},
        demanded_moment=u_pitch.total,
        estimated_pitch_rate=pitch["estimated_depth_rate"],
    )


def _controls(state: State, p: Parameters, of_pitch: Parameters) -> tuple[Control, Control]:
    return axis.control(state.depth.law, p), axis.control(state.pitch.law, of_pitch)


def _deliver(
    force: float, moment: float, j: float, p: Parameters, matrices: Matrices
) -> tuple[Delivery, Delivery]:
    """Returns the deliveries for a force [N] in the earth frame and for a moment [N.m]."""
    share, (x_1, x_2) = matrices.thruster_share, p.thruster_lever
    span, demanded = x_1 - x_2, j * force
    couple, ranges = moment / span, depth_interface.force_ranges(p)
    given, turning = allocation.limited(demanded, couple, share, ranges, p.priority == Priority.HEAVE)
    forces = share[0] * given - turning, share[1] * given + turning
    voltage, delivered = depth_interface.voltages_of(forces, p)
    # errors are exactly 0 where both demands are met
    error = allocation.force((given - demanded, 0.0), j)
    return (
        Delivery(voltage, allocation.force(delivered, j), error),
        Delivery(voltage, -x_1 * delivered[0] - x_2 * delivered[1], span * (turning - couple)),
    )


def _pitch_inputs(inputs: Inputs) -> DepthInputs:
    """Returns the inputs of the pitch axis by the names of the depth axis."""
    return DepthInputs(
        depth_reference=inputs.pitch_reference,
        measured_depth=inputs.measured_pitch,
        measured_depth_rate=inputs.measured_pitch_rate,
    )


def _pitch_parameters(p: Parameters) -> Parameters:
    """Returns the parameters of the pitch axis by the names of the depth axis; shared ones are unchanged."""
    given = asdict(p)
    own = {name: given[of_pitch] for name, of_pitch in _PARAMETERS}
    own |= {"reference_feedforward": ReferenceFeedforward.NONE, "initial_u_a": 0.0, "initial_sigma_hat": 0.0}
    return replace(p, **own)


def _pitch_matrices(matrices: Matrices) -> axis.Matrices:
    """Returns the matrices of the pitch axis by the names of the depth axis."""
    given = asdict(matrices)
    return replace(matrices, **{name: given[of_pitch] for name, of_pitch in _MATRICES})


GUIDE = Guide(
    equations=axis.GUIDE.equations
    + """
the same for the pitch, with x = (pitch, rate), the moment M for the force and the parameters pitch_...
A_m          = [[0, 1], [-(K + k_m1) / I, -(D + k_m2) / I]],   B_m = [0, 1 / I]
F_1          = s_1 J u - m,   F_2 = s_2 J u + m,   m = M / (x_1 - x_2)      forces of the two thrusters
s_1          = -x_2 / (x_1 - x_2),   s_2 = x_1 / (x_1 - x_2),   voltage_i = F_i / K_i or table^-1(F_i / n_i)
""",
    conventions=(
        *axis.GUIDE.conventions,
        "voltage[1] drives the fore thruster, voltage[2] the aft one. Pitch and moment are positive bow up;"
        " the moment of a force F_i, positive down, at x_i is -x_i F_i.",
        "pitch is the attitude of J, as in other depth controllers; the law controls measured_pitch. A"
        " vehicle that measures its pitch drives both.",
    ),
    tuning=(
        "Tune the depth first, as L1DepthController: with a pitch at rest the depth axis is that law.",
        "pitch_model_inertia, pitch_model_damping, pitch_model_stiffness and thruster_lever describe the"
        " vehicle. pitch_feedback_gain and pitch_rate_feedback_gain make A_m of the pitch.",
        "priority chooses the axis that keeps its demand at the limit of the thrusters. The other axis gets"
        " the rest, which drives its prediction, and its integrators hold.",
    ),
    limits=(
        *axis.GUIDE.limits,
        "The L1-norm condition of each axis alone does not cover the coupling between them: a moment by heave"
        " and a depth reading by pitch count as disturbances.",
        "Both axes share regressor, filter order, adaptation law, observer and input gain. The pitch has no"
        " reference feedforward and no nonlinear P.",
        "No gain of the pitch is published or identified: all are guesses for RovHeavePitchPlant.",
    ),
    sources=axis.GUIDE.sources,
    experiment=Experiment(
        stop_time=20.0,
        stimuli=(
            *shared_guide.EXPERIMENT.stimuli,
            ("pitch_reference", ((4.0, 0.0), (8.0, 0.02))),
            ("measured_pitch", ((2.0, 0.0), (6.0, 0.05), (10.0, -0.03), (16.0, 0.02))),
        ),
    ),
)


BLOCK = depth_interface.depth_controller(
    __name__,
    "L1HeavePitchController",
    "L1 adaptive controller of depth and pitch for an underwater vehicle with a fore and an aft thruster",
    calculated=Matrices,
    inputs=Inputs,
)
