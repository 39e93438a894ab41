"""What the documentation of ThrustAllocation says besides its variables."""

from controller_fmu.l1.depth_controller_guide import PAPER
from fmus.block.guide import Experiment, Guide

GUIDE = Guide(
    equations="""\
voltage_i = J u / (2 K_i), limited to -voltage_limit .. voltage_limit,   J = cos(roll) cos(pitch)   (11)
""",
    conventions=(
        "The force u is that of the earth frame, positive down; a positive voltage pushes the upright vehicle"
        " down. Each thruster takes half of the demand.",
        "Angles are in rad; roll and pitch may stay at 0 where they are not measured.",
    ),
    tuning=("thruster_gain (N/V, measured) and voltage_limit are those of the thrusters.",),
    limits=(
        "The voltages of a communication point are those of the inputs of the step before it: in a Jacobi"
        " exchange this block delays the force by one communication step. In a Gauss-Seidel exchange that"
        " steps it after the controller and before the vehicle it does not.",
        "The controller does not learn of the limit of the voltages: its own limit of the force should be"
        " voltage_limit (K_1 + K_2) at most, so that its anti-windup acts.",
    ),
    sources=(PAPER,),
    experiment=Experiment(
        stop_time=10.0,
        step_size=0.1,
        stimuli=(
            ("control_force", ((1.0, 0.0), (5.0, 8.0), (9.0, -2.0))),
            ("roll", ((6.0, 0.0), (8.0, 0.4))),
        ),
    ),
)
