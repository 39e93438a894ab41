"""Block ThrustAllocation: a vertical force in, two thruster voltages out.

For a controller whose output is the force of the depth control interface, positive down. The voltages follow
from the inputs of the last step, one communication step later than in a controller that allocates.
"""

from dataclasses import dataclass

from controller_fmu import allocation, depth_interface, shared_guide
from controller_fmu.depth_interface import ActuatorParameters, Vector
from fmus.block import Block, NoValues, variable
from fmus.block.guide import Experiment, Guide


@dataclass(frozen=True)
class Parameters(ActuatorParameters):
    internal_step: float = variable(
        10.0,
        "Longest internal step; without effect, the voltages follow the inputs at once",
        unit="s",
        min=1e-7,
        max=1e6,
        variability="fixed",
    )


@dataclass(frozen=True)
class Inputs:
    control_force: float = variable(0.0, "Demanded force, earth frame, positive down", unit="N")
    roll: float = variable(0.0, "Roll angle", unit="rad")
    pitch: float = variable(0.0, "Pitch angle", unit="rad")


@dataclass(frozen=True)
class State:
    force: float = variable(0.0, "Demanded force", unit="N")
    j: float = variable(1.0, "J = cos(roll) cos(pitch)", min=-1.0, max=1.0)


@dataclass(frozen=True)
class Outputs:
    voltage: Vector = variable((0.0, 0.0), "Voltage of each thruster, saturated", unit="V")


def initial_state(t: float, inputs: Inputs, p: Parameters, calculated: NoValues) -> State:
    return State(inputs.control_force, allocation.body_to_earth(inputs.roll, inputs.pitch))


def step(t: float, h: float, state: State, inputs: Inputs, p: Parameters, calculated: NoValues) -> State:
    return initial_state(t, inputs, p, calculated)


def output(t: float, state: State, p: Parameters, calculated: NoValues) -> Outputs:
    return Outputs(voltage=depth_interface.deliver(state.force, state.j, p).voltage)


GUIDE = Guide(
    equations="""\
voltage_i = J u / (2 K_i), limited to -voltage_limit .. voltage_limit,   J = cos(roll) cos(pitch)   (11)
            or table^-1(J u / (2 n_i)), 0 V for 0 N, which jumps over the dead band where the sign changes
""",
    conventions=(
        "The force u is in the earth frame, positive down; a positive voltage pushes the upright vehicle"
        " down. Each thruster takes half of the demand.",
        "Angles are in rad; roll and pitch may stay at 0 if they are not measured.",
    ),
    tuning=(
        "thruster_gain (N/V, measured) and voltage_limit describe the thrusters. With thruster_tabulated,"
        " thruster_table_voltage, thruster_table_force and thruster_scale n, the number of thrusters that a"
        " voltage drives, replace the gain.",
    ),
    limits=(
        "The voltages of a communication point follow from the inputs of the step before it: in a Jacobi"
        " exchange this block delays the force by one communication step. In a Gauss-Seidel exchange in the"
        " order controller, allocation, vehicle it does not.",
        "The controller does not get the limit of the voltages: its own limit of the force should be at most"
        " voltage_limit (K_1 + K_2), so that its anti-windup acts.",
        "Noise that changes the sign of the demand moves the voltage from one end of the dead band to the"
        " other.",
    ),
    sources=(shared_guide.PAPER,),
    experiment=Experiment(
        stop_time=10.0,
        step_size=0.1,
        stimuli=(
            ("control_force", ((1.0, 0.0), (5.0, 8.0), (9.0, -2.0))),
            ("roll", ((6.0, 0.0), (8.0, 0.4))),
        ),
    ),
)


BLOCK = Block.of_module(
    __name__,
    "ThrustAllocation",
    "Allocation of a vertical force to two thrusters",
    requirements=depth_interface.table_requirements,
    stop_time=310.0,
    step_size=0.02,
    license="MIT",
)
