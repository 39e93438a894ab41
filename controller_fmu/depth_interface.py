"""The depth control interface: inputs, observer, allocation and outputs that every depth controller shares.

A block inherits its parameters from the classes that it uses, so that one variable has one name, unit and
start value in all of them. The measurement at the beginning of a step decides the control at its end.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from controller_fmu import allocation
from controller_fmu.observer import ObserverState, VelocitySource, sample_when_due
from fmus.block import Block, variable
from fmus.numerics import Clock, clip, interp, logical_and, logical_not, logical_or, where
from fmus.numerics import all as all_hold

Vector = tuple[float, float]
Table = tuple[float, ...]
_GUESS = "guess: the paper gives none"
# Pulse [us] and force [kgf] of a Blue Robotics T200 at 16 V. `plant_fmu/thruster.py` has the same numbers: a
# controller imports nothing of the vehicle, whose numbers may differ from the assumed ones.
_T200_AT_16_V = (
    (1900, 5.25), (1860, 4.65), (1820, 3.82), (1780, 3.11), (1740, 2.43), (1700, 1.82), (1660, 1.28),
    (1620, 0.82), (1580, 0.40), (1540, 0.08), (1532, 0.04), (1528, 0.0), (1472, 0.0), (1468, -0.04),
    (1460, -0.07), (1420, -0.32), (1380, -0.65), (1340, -1.02), (1300, -1.44), (1260, -1.94), (1220, -2.45),
    (1180, -2.99), (1140, -3.66), (1100, -4.07),
)  # fmt: skip


@dataclass(frozen=True)
class ActuatorParameters:
    """Parameters of the thrusters, which every depth controller needs."""

    internal_step: float = variable(
        0.02,
        "Longest internal step; best not below the communication step",
        unit="s",
        min=1e-6,
        max=10.0,
        variability="fixed",
    )
    thruster_gain: Vector = variable(
        (0.25, 0.25), "Force coefficient K of each thruster", unit="N/V", min=1e-6, max=1e6, source=_GUESS
    )
    voltage_limit: float = variable(
        12.0, "Largest voltage of a thruster", unit="V", min=1e-6, max=1e6, source=_GUESS
    )
    thruster_tabulated: bool = variable(
        False,
        "Whether the table gives the voltages, in place of the gain",
        variability="fixed",
        source="assumed: the paper has a straight line, (11)",
    )
    thruster_scale: Vector = variable(
        (1.0, 1.0),
        "Number of thrusters that a voltage drives: factor of the table's force",
        min=1e-3,
        max=1e3,
        source="assumed: one thruster each",
    )
    thruster_table_voltage: Table = variable(
        tuple((1500.0 - pulse) * 12.0 / 400.0 for pulse, _ in _T200_AT_16_V),
        "Voltages of the table, ascending",
        unit="V",
        min=-1e6,
        max=1e6,
        source="chosen: it stands for a speed controller's pulse; 12 V (down) is 1100 us, -12 V (up) 1900 us",
    )
    thruster_table_force: Table = variable(
        tuple(0.0 - kgf * 9.80665 for _, kgf in _T200_AT_16_V),
        "Force at each voltage of the table, ascending",
        unit="N",
        min=-1e6,
        max=1e6,
        source="published: Blue Robotics T200 at 16 V, September 2019, forward thrust up",
    )


@dataclass(frozen=True)
class ObserverParameters(ActuatorParameters):
    """Parameters of thrusters and observer, for a controller that uses the depth rate."""

    velocity_source: VelocitySource = variable(
        VelocitySource.ALPHA_BETA_OBSERVER, "Where the depth rate comes from", variability="fixed"
    )
    observer_alpha: float = variable(
        0.4, "Gain alpha_o of the observer, for the depth", min=0.0, max=1.0, source="guess: not published"
    )
    observer_beta: float = variable(
        0.1,
        "Gain beta_o of the observer, for the rate",
        min=0.0,
        max=2.0,
        source="alpha_o^2 / (2 - alpha_o), Benedict and Bordner (1962); not published",
    )
    observer_period: float = variable(
        0.04,
        "Sampling period T_o of the observer",
        unit="s",
        min=1e-4,
        max=10.0,
        variability="fixed",
        source="proxy: reading time of a Bar30 depth sensor",
    )


@dataclass(frozen=True)
class InertiaParameter:
    """Parameter of a design that assumes the inertia of the vehicle."""

    model_inertia: float = variable(
        5.5,
        "Inertia with added mass M_z that the design assumes",
        unit="kg",
        min=0.1,
        max=1e6,
        source="estimate: 3 kg and the added mass of a box",
    )


@dataclass(frozen=True)
class DampingParameter:
    """Parameter of a design that assumes the linear damping of the vehicle."""

    model_damping: float = variable(
        2.5, "Linear damping D_z that the design assumes", unit="N.s/m", min=0.0, max=1e6, source=_GUESS
    )


@dataclass(frozen=True)
class DesignParameters(DampingParameter, InertiaParameter, ObserverParameters):
    """Parameters of thrusters, observer, and a design that assumes inertia and damping."""


@dataclass(frozen=True)
class DepthInputs:
    depth_reference: float = variable(0.0, "Reference r of the depth", unit="m")
    depth_reference_rate: float = variable(0.0, "Its derivative r'", unit="m/s")
    depth_reference_acceleration: float = variable(0.0, "Its second derivative r''", unit="m/s2")
    measured_depth: float = variable(0.0, "Measured depth z, positive down", unit="m")
    measured_depth_rate: float = variable(
        0.0, "Depth rate z', used when velocity_source is measured", unit="m/s"
    )
    roll: float = variable(0.0, "Roll angle", unit="rad")
    pitch: float = variable(0.0, "Pitch angle", unit="rad")


@dataclass(frozen=True)
class DepthOutputs:
    voltage: Vector = variable((0.0, 0.0), "Voltage of each thruster, saturated", unit="V")
    demanded_force: float = variable(0.0, "Demand u, earth frame, positive down", unit="N")
    tracking_error: float = variable(0.0, "e = z - r", unit="m")
    estimated_depth_rate: float = variable(0.0, "Depth rate that the law uses", unit="m/s")


@dataclass(frozen=True)
class DepthMeasurement:
    """Measurement for the law, in SI units."""

    depth: float = variable(0.0, "Measured depth z")
    rate: float = variable(0.0, "Depth rate v")
    reference: float = variable(0.0, "Reference r")
    reference_rate: float = variable(0.0, "Its derivative r'")
    reference_acceleration: float = variable(0.0, "Its second derivative r''")

    @property
    def error(self) -> float:
        """Tracking error e = z - r."""
        return self.depth - self.reference

    @property
    def error_rate(self) -> float:
        """Error rate e' = v - r'."""
        return self.rate - self.reference_rate


@dataclass(frozen=True)
class DepthState:
    """State of the interface: last measurement, observer and J."""

    measured: DepthMeasurement = DepthMeasurement()
    observer: ObserverState = ObserverState()
    j: float = variable(1.0, "J = cos(roll) cos(pitch)", min=-1.0, max=1.0)


@dataclass(frozen=True)
class Delivery:
    """Delivery of the thrusters for a demand: voltages [V], force [N], force delivered minus demanded [N]."""

    voltage: Vector
    force: float
    saturation_error: float


def requirements(p: ObserverParameters, calculated: object) -> tuple[tuple[bool, str], ...]:
    """Returns the requirements of the observer and of the table."""
    # The observer takes one sample a step. 1e-9: rounding of equal times that are given in other digits.
    is_short = p.internal_step <= p.observer_period * (1.0 + 1e-9)
    return ((is_short, "internal_step at most observer_period"), *table_requirements(p))


def table_requirements(p: ActuatorParameters, calculated: object = None) -> tuple[tuple[bool, str], ...]:
    """Returns the requirements of a table in use: it ascends, and has forces of both signs."""
    voltages, forces = p.thruster_table_voltage, p.thruster_table_force
    is_left_out = logical_not(p.thruster_tabulated)
    rises = all_hold(a < b for a, b in pairwise(voltages))
    never_falls = all_hold(a <= b for a, b in pairwise(forces))
    has_both_signs = logical_and(forces[0] < 0.0, forces[-1] > 0.0)
    return (
        (logical_or(is_left_out, rises), "thruster_table_voltage: each above the one before"),
        (logical_or(is_left_out, never_falls), "thruster_table_force: none below the one before"),
        (logical_or(is_left_out, has_both_signs), "thruster_table_force from below 0 N to above 0 N"),
    )


def first_state(t: float, inputs: DepthInputs, p: ObserverParameters) -> DepthState:
    """Returns the state with the observer at rest on the first measurement."""
    return _after(ObserverState(inputs.measured_depth, 0.0, Clock(t + p.observer_period)), inputs, p)


def next_state(t: float, state: DepthState, inputs: DepthInputs, p: ObserverParameters) -> DepthState:
    """Returns the state with the measurement of time t [s], and the observer corrected if a sample is due."""
    observer = sample_when_due(
        t, state.observer, inputs.measured_depth, p.observer_alpha, p.observer_beta, p.observer_period
    )
    return _after(observer, inputs, p)


def _after(observer: ObserverState, inputs: DepthInputs, p: ObserverParameters) -> DepthState:
    is_measured = p.velocity_source == VelocitySource.MEASURED
    rate = where(is_measured, inputs.measured_depth_rate, observer.rate)
    return DepthState(measurement(inputs, rate), observer, body_to_earth(inputs))


def measurement(inputs: DepthInputs, rate: float) -> DepthMeasurement:
    """Returns the inputs with the depth rate [m/s] for the law."""
    return DepthMeasurement(
        inputs.measured_depth,
        rate,
        inputs.depth_reference,
        inputs.depth_reference_rate,
        inputs.depth_reference_acceleration,
    )


def body_to_earth(inputs: DepthInputs) -> float:
    """Returns J = cos(roll) cos(pitch)."""
    return allocation.body_to_earth(inputs.roll, inputs.pitch)


def deliver(force: float, j: float, p: ActuatorParameters) -> Delivery:
    """Allocates a demand [N] to the thrusters, half to each, and returns their delivery."""
    share = 0.5 * j * force
    first, second = (clip(share, low, high) for low, high in force_ranges(p))
    voltage, forces = voltages_of((first, second), p)
    # from the limit itself: after division by a gain and back, it would not be exactly 0 without saturation
    missing = first - share, second - share
    return Delivery(voltage, allocation.force(forces, j), allocation.force(missing, j))


def force_ranges(p: ActuatorParameters) -> tuple[Vector, Vector]:
    """Returns the lowest and the highest force [N] of each thruster along the body's z axis."""
    voltages, forces = p.thruster_table_voltage, p.thruster_table_force

    def of_table() -> tuple[Vector, Vector]:
        low, high = (interp(limit, voltages, forces) for limit in (-p.voltage_limit, p.voltage_limit))
        first, second = ((scale * low, scale * high) for scale in p.thruster_scale)
        return first, second

    first, second = ((-gain * p.voltage_limit, gain * p.voltage_limit) for gain in p.thruster_gain)
    return where(p.thruster_tabulated, of_table, lambda: (first, second))


def voltages_of(forces: Vector, p: ActuatorParameters) -> tuple[Vector, Vector]:
    """Returns the voltages [V] for forces [N] in the range of the thrusters, and these forces."""
    table = p.thruster_table_voltage, p.thruster_table_force

    def of_table() -> tuple[Vector, Vector]:
        voltages = [
            allocation.table_voltage(force / scale, *table)
            for force, scale in zip(forces, p.thruster_scale, strict=True)
        ]
        return allocation.saturate((voltages[0], voltages[1]), p.voltage_limit), forces

    def of_gain() -> tuple[Vector, Vector]:
        gains = p.thruster_gain
        saturated = allocation.saturate((forces[0] / gains[0], forces[1] / gains[1]), p.voltage_limit)
        return saturated, (gains[0] * saturated[0], gains[1] * saturated[1])

    return where(p.thruster_tabulated, of_table, of_gain)


def outputs(force: float, measured: DepthMeasurement, j: float, p: ActuatorParameters) -> dict[str, Any]:
    """Returns the variables of `DepthOutputs` by name, for a demand [N]."""
    return {
        "voltage": deliver(force, j, p).voltage,
        "demanded_force": force,
        "tracking_error": measured.error,
        "estimated_depth_rate": measured.rate,
    }


def depth_controller(module: str, name: str, description: str, **given: Any) -> Block:
    """Returns `Block.of_module` of a depth controller, with the inputs and the experiment that all share."""
    shared = {"inputs": DepthInputs, "stop_time": 310.0, "step_size": 0.02, "license": "MIT"}
    return Block.of_module(module, name, description, **(shared | given))
