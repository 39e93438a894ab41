"""Block RovHeavePitchPlant: fore and aft thruster voltage in, depth and pitch out.

The vehicle of RovDepthPlant with one more axis, whose numbers are not published and guessed. Other vehicles
are this block with other start values.
"""

from dataclasses import dataclass, replace

from fmus.block import Block, NoValues, variable
from fmus.numerics import rk4_step, where
from plant_fmu import depth_plant, depth_sensor, heave, heave_pitch, thruster
from plant_fmu.depth_plant import Surroundings
from plant_fmu.depth_sensor import SensorState
from plant_fmu.heave_pitch_guide import GUIDE
from plant_fmu.thruster import Pair, Transfer, Triple

_GUESS = "guess: the paper gives none"
# added to the seed: the noise of the pitch must not repeat the noise of the depth
_OTHER_SEEDS = 2**30


@dataclass(frozen=True)
class Parameters(depth_plant.Parameters):
    """Parameters of heave and pitch."""

    initial_pitch: float = variable(
        0.0, "Pitch angle at the start", unit="rad", variability="fixed", source="assumed: level"
    )
    pitch_inertia: float = variable(
        0.026,
        "Moment of inertia I with added mass",
        unit="kg.m2",
        min=1e-6,
        max=1e9,
        source="guess: box of the published size and mass, and as much again of added mass",
    )
    metacentric_height: float = variable(
        0.005,
        "Height BG of the centre of buoyancy above the centre of gravity",
        unit="m",
        min=0.0,
        max=1e3,
        source=_GUESS,
    )
    pitch_linear_damping: float = variable(
        0.02,
        "Linear damping D_M of pitch",
        unit="N.m.s",
        min=0.0,
        max=1e9,
        source="guess: damping ratio of 0.16",
    )
    pitch_quadratic_damping: float = variable(
        0.005, "Quadratic damping D_Mq of pitch", unit="N.m.s2", min=0.0, max=1e9, source=_GUESS
    )
    thruster_lever: Pair = variable(
        (0.06, -0.06),
        "Lever of each thruster, positive forward of the centre of gravity",
        unit="m",
        min=-1e3,
        max=1e3,
        source=_GUESS,
    )
    thruster_transfer: tuple[float, float, float, float] = variable(
        (0.0, 30.0, 300.0, 0.0),
        "Transfer function behind the lag: b_1, a_2, a_1, a_0; a_0 = 0 leaves it out",
        unit=("1/s2", "1/s", "1/s2", "1/s3"),
        min=0.0,
        max=1e15,
        source="guess: left out, the lag alone",
    )
    sensor_forward: float = variable(
        0.08, "Depth sensor forward of the centre of gravity", unit="m", min=-1e3, max=1e3, source=_GUESS
    )
    sensor_below: float = variable(
        0.0, "Depth sensor below the centre of gravity", unit="m", min=-1e3, max=1e3, source=_GUESS
    )
    pitch_noise: float = variable(
        0.002,
        "Standard deviation of the white noise of the measured pitch",
        unit="rad",
        min=0.0,
        max=10.0,
        source="guess: 0.1 degrees; sampled as the depth is",
    )


@dataclass(frozen=True)
class Inputs(Surroundings):
    external_moment: float = variable(0.0, "Disturbance of pitch, positive bow up", unit="N.m")


@dataclass(frozen=True)
class Continuous:
    depth: float = variable(0.0, "Depth z, positive down", unit="m")
    depth_rate: float = variable(0.0, "Depth rate z'", unit="m/s")
    pitch: float = variable(0.0, "Pitch angle, positive bow up", unit="rad")
    pitch_rate: float = variable(0.0, "Pitch rate q", unit="rad/s")
    transfer: tuple[Triple, Triple] = variable(
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        "State of each thruster's transfer function",
        unit=(("N", "N/s", "N/s2"), ("N", "N/s", "N/s2")),
    )
    lagged_force: Pair = variable((0.0, 0.0), "Force of each thruster behind limit and lag", unit="N")


@dataclass(frozen=True)
class State(Continuous):
    """Continuous states, values that follow from the inputs, and the sensors."""

    steady_force: Pair = variable((0.0, 0.0), "Steady force of each thruster", unit="N")
    pressure_head: float = variable(0.0, "Pressure of waves over rho g", unit="m")
    sensor: SensorState = SensorState()
    pitch_sensor: SensorState = SensorState()


@dataclass(frozen=True)
class Outputs:
    depth: float = variable(0.0, "True depth z, positive down", unit="m")
    depth_rate: float = variable(0.0, "True depth rate z'", unit="m/s")
    measured_depth: float = variable(0.0, "Depth as the sensor reports it, at its place", unit="m")
    thruster_force: Pair = variable(
        (0.0, 0.0), "Force of each thruster along the body's z axis, positive down", unit="N"
    )
    total_force: float = variable(0.0, "Sum of the thruster forces", unit="N")
    pitch: float = variable(0.0, "True pitch angle theta, positive bow up", unit="rad")
    pitch_rate: float = variable(0.0, "True pitch rate q", unit="rad/s")
    measured_pitch: float = variable(0.0, "Pitch angle as its sensor reports it", unit="rad")


def requirements(p: Parameters, calculated: NoValues) -> tuple:
    of_heave = depth_plant.requirements(p, calculated)
    return (*of_heave, *Transfer(*p.thruster_transfer).requirements(p.internal_step))


def initial_state(t: float, inputs: Inputs, p: Parameters, calculated: NoValues) -> State:
    """Returns the state at the start, the thrusters at rest."""
    head = inputs.wave_pressure_head
    sensed = _sensed_depth(p.initial_depth, p.initial_pitch, p) + head
    return State(
        depth=p.initial_depth,
        depth_rate=p.initial_heave_velocity,
        pitch=p.initial_pitch,
        pressure_head=head,
        sensor=depth_sensor.first_sample(p, t, sensed, p.sensor_seed),
        pitch_sensor=depth_sensor.first_sample(
            _pitch_sensor(p), t, p.initial_pitch, p.sensor_seed + _OTHER_SEEDS
        ),
    )


def derivative(t: float, state: State, inputs: Inputs, p: Parameters, calculated: NoValues) -> Continuous:
    asked = thruster.present_forces(p, state.lagged_force, state.steady_force)
    v, acceleration, q, angular, transfer = _in_parts(_motion(_moving(state), asked, inputs, p))
    lagged = thruster.force_rates(p, state.lagged_force, state.steady_force)
    return Continuous(v, acceleration, q, angular, transfer, lagged)


def integrate(t: float, h: float, state: State, inputs: Inputs, p: Parameters, calculated: NoValues) -> State:
    """Returns the state after h seconds: exact forces of limit and lag, and Runge-Kutta under these."""
    lagged = depth_plant.forces_from(state.lagged_force, inputs, p)
    x = rk4_step(lambda elapsed, x: _motion(x, lagged(elapsed), inputs, p), 0.0, _moving(state), h)
    depth, rate, pitch, pitch_rate, transfer = _in_parts(x)
    return replace(
        state,
        depth=depth,
        depth_rate=rate,
        pitch=pitch,
        pitch_rate=pitch_rate,
        transfer=transfer,
        lagged_force=lagged(h),
    )


def _moving(state: Continuous) -> tuple:
    first, second = state.transfer
    return (state.depth, state.depth_rate, state.pitch, state.pitch_rate, *first, *second)


def _in_parts(x: tuple) -> tuple:
    """Returns the numbers of `_moving` in the shape of the state."""
    return (*x[:4], (tuple(x[4:7]), tuple(x[7:])))


def _motion(x: tuple, asked: Pair, inputs: Inputs, p: Parameters) -> tuple:
    """Returns the derivatives of x, the numbers of `_moving`, under forces of limit and lag [N]."""
    z, v, theta, q, *rest = x
    transfer, turning = Transfer(*p.thruster_transfer), ((*rest[:3],), (*rest[3:],))
    forces = _forces(z, theta, turning, asked, p)
    thrust = heave_pitch.vertical_thrust(forces, theta)
    moment = heave_pitch.thrust_moment(forces, p.thruster_lever) + inputs.external_moment
    righting = heave_pitch.righting_moment(theta, p.weight, p.metacentric_height)
    damping = heave.damping(q, p.pitch_linear_damping, p.pitch_quadratic_damping)
    return (
        v,
        depth_plant.heave_acceleration(z, v, thrust, 1.0, inputs, p),
        q,
        heave_pitch.angular_acceleration(moment, righting, damping, p.pitch_inertia),
        *transfer.rates(turning[0], asked[0]),
        *transfer.rates(turning[1], asked[1]),
    )


def step(t: float, h: float, state: State, inputs: Inputs, p: Parameters, calculated: NoValues) -> State:
    head = inputs.wave_pressure_head
    sensed = _sensed_depth(state.depth, state.pitch, p) + head
    return replace(
        state,
        steady_force=depth_plant.steady_forces(inputs, p),
        pressure_head=head,
        sensor=depth_sensor.sample_when_due(p, state.sensor, t + h, sensed),
        pitch_sensor=depth_sensor.sample_when_due(_pitch_sensor(p), state.pitch_sensor, t + h, state.pitch),
    )


def crossings(t: float, state: State, inputs: Inputs, p: Parameters, calculated: NoValues) -> tuple:
    depths = (heave_pitch.depth_at(state.depth, state.pitch, lever) for lever in p.thruster_lever)
    of_propellers = [crossing for depth in depths for crossing in thruster.ventilation_crossings(depth, p)]
    of_thrusters = depth_plant.thruster_crossings(state.lagged_force, state.steady_force, inputs, p)
    return (*depth_plant.surface_crossings(state.depth, inputs, p), *of_propellers, *of_thrusters)


def output(t: float, state: State, p: Parameters, calculated: NoValues) -> Outputs:
    asked = thruster.present_forces(p, state.lagged_force, state.steady_force)
    first, second = _forces(state.depth, state.pitch, state.transfer, asked, p)
    sensed = _sensed_depth(state.depth, state.pitch, p) + state.pressure_head
    return Outputs(
        depth=state.depth,
        depth_rate=state.depth_rate,
        measured_depth=depth_sensor.reading(p, state.sensor, t, sensed),
        thruster_force=(first, second),
        total_force=first + second,
        pitch=state.pitch,
        pitch_rate=state.pitch_rate,
        measured_pitch=depth_sensor.reading(_pitch_sensor(p), state.pitch_sensor, t, state.pitch),
    )


def _forces(depth: float, pitch: float, transfer: tuple[Triple, Triple], asked: Pair, p: Parameters) -> Pair:
    """Returns the force of each thruster [N], each at its own depth below the surface."""
    first, second = (
        thruster.submerged_share(heave_pitch.depth_at(depth, pitch, lever), p)
        * where(p.thruster_ideal, steady, Transfer(*p.thruster_transfer).force(x, steady))
        for lever, x, steady in zip(p.thruster_lever, transfer, asked, strict=True)
    )
    return first, second


def _sensed_depth(depth: float, pitch: float, p: Parameters) -> float:
    return heave_pitch.depth_at(depth, pitch, p.sensor_forward, p.sensor_below)


def _pitch_sensor(p: Parameters) -> Parameters:
    """Returns the parameters with the pitch sensor's numbers by the names of the depth sensor."""
    others = dict.fromkeys(("sensor_bias", "sensor_drift", "sensor_resolution", "sensor_delay"), 0.0)
    return replace(p, sensor_noise=p.pitch_noise, **others)


BLOCK = Block.of_module(
    __name__,
    "RovHeavePitchPlant",
    "Heave and pitch of a small underwater vehicle with a fore and an aft thruster and a depth sensor",
    guide=GUIDE,
    stop_time=310.0,
    step_size=0.02,
    license="MIT",
)
