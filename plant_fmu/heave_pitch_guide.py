"""Guide to the vehicles in heave and pitch."""

from fmus.block.guide import Experiment, Guide
from plant_fmu import depth_plant_guide

EXPERIMENT = Experiment(
    stop_time=20.0,
    stimuli=(
        ("voltage[1]", ((1.0, 0.0), (2.0, 4.0), (8.0, 4.0), (9.0, 2.0))),
        ("voltage[2]", ((1.0, 0.0), (2.0, 4.0), (8.0, 3.0), (9.0, 2.0))),
        ("thruster_efficiency[2]", ((12.0, 1.0), (12.5, 0.95))),
        ("external_force", ((14.0, 0.0), (14.5, 0.3), (15.0, 0.0))),
        ("external_moment", ((16.0, 0.0), (16.5, 0.02), (17.0, 0.0))),
    ),
)

GUIDE = Guide(
    equations="""\
M v'       = W - B(z) + cos(theta) (F_1 + F_2) + F_ext + (M - (W - B(z)) / g) w_f' - D v_r - D_q |v_r| v_r
I q'       = -x_1 F_1 - x_2 F_2 - W BG sin(theta) + M_ext - D_M q - D_Mq |q| q
z'         = v,   theta' = q,   v_r = v - v_c - w_f
B(z)       = B_0                        submerged, B_0 = weight - net_weight + buoyancy_change
             B_0 - rho g A (-z)         emerged by -z, never negative; only with free_surface
thruster   as in RovDepthPlant, F_1 fore, F_2 aft, each at its own depth; behind its lag
           (b_1 s + a_0) / (s^3 + a_2 s^2 + a_1 s + a_0)             none for a_0 = 0
sensor     as in RovDepthPlant, of z - x_s sin(theta) - z_s (1 - cos(theta)) + p_f / (rho g)
pitch      sampled as the depth is, with white noise
""",
    conventions=(
        "Depth z, its rate and vertical forces are positive down; pitch is positive bow up, and so is"
        " external_moment.",
        "voltage[1] drives the fore thruster, voltage[2] the aft one; a positive voltage pushes down. Forces"
        " of thrusters are along the body's z axis.",
        "thruster_lever and sensor_forward are positive forward of the centre of gravity.",
        "Waves act as in RovDepthPlant. They turn the vehicle only if external_moment does so.",
    ),
    tuning=(
        "For another vehicle, set the heave as in RovDepthPlant, pitch_inertia and metacentric_height from"
        " the period 2 pi sqrt(I / (W BG)) of a free oscillation, and the damping from its decay.",
        "For a measured thruster, set thruster_tabulated and thruster_transfer. The lag acts before the"
        " transfer function: set it to 0.",
        "A step is one of the classical Runge-Kutta method of fourth order, exact in the lag. internal_step"
        " must resolve the poles of thruster_transfer: at 0.45 of the fastest, 5 ms for a T200, the force"
        " after a jump of the voltage is within 0.03 % of the jump.",
    ),
    limits=(
        "Surge is neglected. Thrust F at a pitch of 0.1 rad pushes forward by 0.1 F: 0.12 N at the holding"
        " thrust, 5 cm/s with a damping of 2.5 N.s/m, of which 0.5 cm/s would be along the inclined path."
        " Added masses of surge and heave that differ would turn the vehicle while it surges.",
        "The righting moment contains the weight instead of the buoyancy, a difference of 4 %, also at the"
        " surface. The free surface acts on heave alone.",
        "A thruster whose moment is above W BG tumbles the vehicle: 0.147 N.m here, two thrusters that"
        " differ by 2.5 N.",
        "internal_step can be at most sensor_period and the inverse of the largest rate of"
        " thruster_transfer, sensor_delay at most seven periods.",
        "Moments, levers and damping of pitch are guesses. The model was not compared with a real vehicle.",
    ),
    sources=depth_plant_guide.GUIDE.sources,
    experiment=EXPERIMENT,
)
