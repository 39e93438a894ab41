"""Block RovDepthPlant: two thruster voltages in, depth out; vehicle, thrusters and depth sensor.

The AC-ROV of Maalouf et al. (2013) as far as it is published; every other number has the source estimate
or guess. Depth is positive down, and 0 when the vehicle's top is at the surface.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from fmus.block import Block, NoValues, variable
from fmus.numerics import rk4_step, where
from plant_fmu import depth_sensor, heave, thruster
from plant_fmu.depth_plant_guide import GUIDE
from plant_fmu.depth_sensor import SensorParameters, SensorState
from plant_fmu.thruster import Pair, ThrusterParameters


@dataclass(frozen=True)
class HullParameters:
    """Parameters of the vehicle without thrusters and sensor."""

    internal_step: float = variable(
        0.02, "Longest internal step", unit="s", min=1e-6, max=10.0, variability="fixed"
    )
    initial_depth: float = variable(
        0.0, "Depth at the start", unit="m", variability="fixed", source="published: the surface"
    )
    initial_heave_velocity: float = variable(
        0.0, "Heave velocity at the start", unit="m/s", variability="fixed", source="assumed: at rest"
    )
    inertia: float = variable(
        5.5,
        "Inertia with added mass M_z",
        unit="kg",
        min=0.1,
        max=1e6,
        source="estimate: 3 kg (published) and the added mass of a box, DNV-RP-H103",
    )
    linear_damping: float = variable(
        2.5, "Linear damping D_z", unit="N.s/m", min=0.0, max=1e6, source="guess: the paper gives none"
    )
    quadratic_damping: float = variable(
        7.0, "Quadratic damping D_q", unit="N.s2/m2", min=0.0, max=1e6, source="estimate: 0.5 rho C_d A"
    )
    weight: float = variable(29.43, "Weight W", unit="N", min=1e-3, max=1e9, source="published: 3 kg")
    net_weight: float = variable(
        -1.2,
        "W - B when submerged; negative floats",
        unit="N",
        min=-1e6,
        max=1e6,
        source="published: holding thrust 1.2 N, of which +0.2 N is 17 %",
    )
    free_surface: bool = variable(True, "Whether buoyancy falls as the vehicle emerges", variability="fixed")
    water_density: float = variable(
        1000.0, "Density of the water", unit="kg/m3", min=1.0, max=1e5, source="fresh water, a pool"
    )
    waterplane_area: float = variable(
        0.022192,
        "Horizontal section of the vehicle",
        unit="m2",
        min=1e-6,
        max=1e4,
        source="published size: 0.152 m x 0.146 m",
    )


@dataclass(frozen=True)
class Parameters(SensorParameters, ThrusterParameters, HullParameters):
    """Parameters of the vehicle, the thrusters and the sensor."""


@dataclass(frozen=True)
class Surroundings:
    """Inputs of every vehicle: voltages, faults, forces and the motion of the water."""

    voltage: Pair = variable((0.0, 0.0), "Voltage of each thruster", unit="V")
    thruster_efficiency: Pair = variable(
        (1.0, 1.0), "1 healthy, 0 dead: a fault of each thruster", min=0.0, max=1.0
    )
    external_force: float = variable(0.0, "Disturbance w_dz along the body's z axis, positive down", unit="N")
    buoyancy_change: float = variable(
        0.0, "Added to the buoyancy B, positive lifts", unit="N", min=-1e6, max=1e6
    )
    current_velocity: float = variable(0.0, "Vertical current in the earth frame, positive down", unit="m/s")
    wave_velocity: float = variable(
        0.0, "Vertical orbital velocity of waves in the earth frame, positive down", unit="m/s"
    )
    wave_acceleration: float = variable(
        0.0, "Vertical orbital acceleration of waves in the earth frame, positive down", unit="m/s2"
    )
    wave_pressure_head: float = variable(
        0.0, "Pressure of waves over rho g, which the sensor reads as depth", unit="m"
    )


@dataclass(frozen=True)
class Inputs(Surroundings):
    roll: float = variable(0.0, "Roll angle", unit="rad")
    pitch: float = variable(0.0, "Pitch angle", unit="rad")


@dataclass(frozen=True)
class Continuous:
    depth: float = variable(0.0, "Depth z, positive down", unit="m")
    heave_velocity: float = variable(0.0, "Heave velocity w in the body frame", unit="m/s")
    thruster_force: Pair = variable((0.0, 0.0), "Force of each thruster if submerged", unit="N")


@dataclass(frozen=True)
class State(Continuous):
    """Continuous states, values that follow from the inputs, and the sensor."""

    steady_force: Pair = variable((0.0, 0.0), "Steady force of each thruster", unit="N")
    j: float = variable(1.0, "J = cos(roll) cos(pitch)", min=-1.0, max=1.0)
    pressure_head: float = variable(0.0, "Pressure of waves over rho g", unit="m")
    sensor: SensorState = SensorState()


@dataclass(frozen=True)
class Outputs:
    depth: float = variable(0.0, "True depth z, positive down", unit="m")
    depth_rate: float = variable(0.0, "True depth rate z' = J w", unit="m/s")
    heave_velocity: float = variable(0.0, "Heave velocity w in the body frame", unit="m/s")
    measured_depth: float = variable(0.0, "Depth as the sensor reports it", unit="m")
    thruster_force: Pair = variable(
        (0.0, 0.0), "Force of each thruster along the body's z axis, positive down", unit="N"
    )
    total_force: float = variable(0.0, "tau_z, sum of the thruster forces", unit="N")


def requirements(p: Parameters, calculated: NoValues) -> tuple:
    return (
        # 1e-9: rounding of equal times that are given in other digits
        (p.internal_step <= p.sensor_period * (1.0 + 1e-9), "internal_step at most sensor_period"),
        (p.net_weight < p.weight, "net_weight below weight, so that there is buoyancy"),
        depth_sensor.delay_fits(p),
        thruster.table_ascends(p),
    )


def initial_state(t: float, inputs: Inputs, p: Parameters, calculated: NoValues) -> State:
    """Returns the state at the start, the thrusters at rest."""
    head = inputs.wave_pressure_head
    first = depth_sensor.first_sample(p, t, p.initial_depth + head, p.sensor_seed)
    j = heave.body_to_earth(inputs.roll, inputs.pitch)
    return State(p.initial_depth, p.initial_heave_velocity, (0.0, 0.0), (0.0, 0.0), j, head, first)


def derivative(t: float, state: State, inputs: Inputs, p: Parameters, calculated: NoValues) -> Continuous:
    forces = thruster.present_forces(p, state.thruster_force, state.steady_force)
    rates = _motion((state.depth, state.heave_velocity), forces, inputs, p)
    return Continuous(*rates, thruster.force_rates(p, state.thruster_force, state.steady_force))


def integrate(t: float, h: float, state: State, inputs: Inputs, p: Parameters, calculated: NoValues) -> State:
    """Returns the state after h seconds: the exact forces of the thrusters, and Runge-Kutta under these."""
    # a short lag would be stiff for Runge-Kutta steps that suit the vehicle
    forces = forces_from(state.thruster_force, inputs, p)
    depth, velocity = rk4_step(
        lambda elapsed, x: _motion(x, forces(elapsed), inputs, p), 0.0, (state.depth, state.heave_velocity), h
    )
    return replace(state, depth=depth, heave_velocity=velocity, thruster_force=forces(h))


def _motion(x: tuple, forces: Pair, inputs: Inputs, p: Parameters) -> tuple[float, float]:
    """Returns z' and w' under forces of the submerged thrusters [N]; x: z [m], w [m/s]."""
    (z, w), j = x, heave.body_to_earth(inputs.roll, inputs.pitch)
    thrust = thruster.submerged_share(z, p) * sum(forces)
    return j * w, heave_acceleration(z, w, thrust, j, inputs, p)


def step(t: float, h: float, state: State, inputs: Inputs, p: Parameters, calculated: NoValues) -> State:
    head = inputs.wave_pressure_head
    return replace(
        state,
        steady_force=steady_forces(inputs, p),
        j=heave.body_to_earth(inputs.roll, inputs.pitch),
        pressure_head=head,
        sensor=depth_sensor.sample_when_due(p, state.sensor, t + h, state.depth + head),
    )


def crossings(t: float, state: State, inputs: Inputs, p: Parameters, calculated: NoValues) -> tuple:
    of_thrusters = thruster_crossings(state.thruster_force, state.steady_force, inputs, p)
    ventilation = thruster.ventilation_crossings(state.depth, p)
    return (*surface_crossings(state.depth, inputs, p), *ventilation, *of_thrusters)


def surface_crossings(z: float, inputs: Surroundings, p: Parameters) -> tuple[float, float]:
    """Returns the heights [m] until the vehicle begins to emerge, and until it has left the water."""
    submerged_buoyancy = p.weight - p.net_weight + inputs.buoyancy_change
    return z, z + heave.height(submerged_buoyancy, p.water_density, p.waterplane_area)


def thruster_crossings(forces: Pair, steady: Pair, inputs: Surroundings, p: Parameters) -> tuple[float, ...]:
    """Returns the event indicators of both thrusters, from their forces behind limit and lag [N]."""
    of_each = (thruster.corners(p, i, inputs.voltage[i], forces[i], steady[i]) for i in (0, 1))
    return tuple(corner for corners in of_each for corner in corners)


def steady_forces(inputs: Surroundings, p: Parameters) -> Pair:
    """Returns the steady forces [N] of the submerged thrusters."""
    first, second = (
        thruster.steady_force(p, i, inputs.voltage[i], inputs.thruster_efficiency[i]) for i in (0, 1)
    )
    return first, second


def forces_from(force: Pair, inputs: Surroundings, p: Parameters) -> Callable[[float], Pair]:
    """Returns a function of time [s]: the force of each submerged thruster [N] that long after `force`."""
    steady = steady_forces(inputs, p)

    def forces(elapsed: float) -> Pair:
        first, second = (thruster.force_after(p, i, force[i], steady[i], elapsed) for i in (0, 1))
        return first, second

    return forces


def heave_acceleration(
    z: float, velocity: float, thrust: float, j: float, inputs: Surroundings, p: Parameters
) -> float:
    """Returns the acceleration [m/s2] along an axis at a depth [m] and a velocity along it [m/s].

    thrust: along the axis [N]; j: vertical part of a unit along the axis
    """
    submerged_buoyancy = p.weight - p.net_weight + inputs.buoyancy_change
    floating = heave.buoyancy(z, submerged_buoyancy, p.water_density, p.waterplane_area)
    net_weight = p.weight - where(p.free_surface, floating, submerged_buoyancy)
    water_velocity = inputs.current_velocity + inputs.wave_velocity
    drag = heave.damping(velocity - j * water_velocity, p.linear_damping, p.quadratic_damping)
    wave_force = heave.wave_force(j * inputs.wave_acceleration, p.inertia, net_weight)
    external = inputs.external_force + wave_force
    return heave.acceleration(thrust, external, j * net_weight, drag, p.inertia)


def output(t: float, state: State, p: Parameters, calculated: NoValues) -> Outputs:
    submerged = thruster.submerged_share(state.depth, p)
    forces = thruster.present_forces(p, state.thruster_force, state.steady_force)
    first, second = (submerged * force for force in forces)
    return Outputs(
        depth=state.depth,
        depth_rate=state.j * state.heave_velocity,
        heave_velocity=state.heave_velocity,
        measured_depth=depth_sensor.reading(p, state.sensor, t, state.depth + state.pressure_head),
        thruster_force=(first, second),
        total_force=first + second,
    )


BLOCK = Block.of_module(
    __name__,
    "RovDepthPlant",
    "Depth dynamics of a small underwater vehicle with two thrusters and a depth sensor",
    guide=GUIDE,
    stop_time=310.0,
    step_size=0.02,
    license="MIT",
)
