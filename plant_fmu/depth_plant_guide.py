"""Guide to RovDepthPlant."""

from fmus.block.guide import Experiment, Guide, Source

GUIDE = Guide(
    equations="""\
M_z w'     = tau_z + w_dz + J (W - B(z)) - D_z w_r - D_q |w_r| w_r       (10), D_q added
             + (M_z - (W - B(z)) / g) J w_f'                             waves: displaced water, added mass
z'         = J w,   J = cos(roll) cos(pitch),   w_r = w - J (v_c + w_f)
B(z)       = B_0                        submerged, B_0 = weight - net_weight + buoyancy_change
             B_0 - rho g A (-z)         emerged by -z, never negative; only with free_surface
thruster   v_s = sat(v, v_max),   v_d = sgn(v_s) max(|v_s| - v_0, 0)
           F_s = efficiency K r v_d ((1 - c) + c |v_d| / v_q)            (11) for r = 1, c = 0
           F_s = efficiency n table(v_s)                                 with thruster_tabulated
           F'  = sat((F_s - F) / lag, R)                                 no limit for R = 0
           tau_z = s (F_1 + F_2),   s = clip((z + d_t) / d_f, 0, 1)      s = 1 for d_f = 0
sensor     m_k = q(z(t_k) + h + bias + drift (t_k - t_0) + noise xi_k) at t_k = t_0 + k period
           measured = the newest m_k with t_k + delay <= t;   xi_k standard normal, h head of waves, q rounds
""",
    conventions=(
        "Depth z is the depth of the vehicle's top, positive down and 0 at the surface.",
        "Forces and velocities along the body's z axis are positive down; a current and waves are given in"
        " the earth frame.",
        "wave_velocity w_f and wave_acceleration w_f' are vertical and positive down, wave_pressure_head h is"
        " positive under a crest. Connect all three with WaveSource, or none.",
        "A positive voltage pushes down. net_weight is W - B: the vehicle floats if it is negative.",
        "buoyancy_change is positive when it lifts.",
    ),
    tuning=(
        "For another vehicle, set weight, net_weight, waterplane_area and inertia (with the added mass of its"
        " size), then linear_damping and quadratic_damping from descents at several constant thrusts.",
        "A thruster has thruster_gain K, thruster_dead_zone v_0, thruster_voltage_limit v_max and"
        " thruster_lag. thruster_ideal keeps only gain and efficiency.",
        "Further effects are off at the start values: thruster_reverse_ratio r, for negative voltages;"
        " thruster_curvature c, for a force quadratic in the voltage, with thruster_curve_voltage v_q, where"
        " line and parabola meet; thruster_rate_limit R of the force; thruster_full_depth d_f, from which a"
        " propeller draws no air, with thruster_depth d_t below the vehicle's top.",
        "For a measured thruster, set thruster_tabulated, thruster_table_voltage, thruster_table_force and"
        " thruster_scale n, the number of thrusters. The force is linear between the points. For fewer"
        " points, put the others on its segments. The start values describe a T200, far too strong for"
        " this vehicle.",
        "sensor_ideal reports the depth, with the pressure head of waves, at every instant. Otherwise period,"
        " noise, bias, drift, resolution and delay act. One sensor_seed gives one sequence of noise, on every"
        " platform.",
        "Faults and surroundings are inputs: thruster_efficiency (1 healthy, 0 dead), external_force,"
        " buoyancy_change, current_velocity, and three wave inputs, from WaveSource.",
    ),
    limits=(
        "The vehicle moves in heave only; roll and pitch are inputs.",
        "The paper gives no data of inertia, damping, thrusters and sensor: the column Source says what is"
        " published, estimated or guessed. The model was not compared with a real vehicle.",
        "The vehicle's sides are vertical at the surface. There is no bottom and no tether.",
        "Waves act by linear theory on a small submerged body. The surface stays level where the vehicle"
        " emerges. Forces of second order, such as the mean pull towards the surface, are left out.",
        "At the surface, buoyancy is a spring of 218 N/m under 5.5 kg (6.3 rad/s). In a loop, delays of the"
        " controller's observer and of the thrusters sustain an oscillation there.",
        "The controllers of l1-depth assume a thrust proportional to the voltage, with their own gain and"
        " voltage limit, or invert their own table. They ignore other effects of the thrusters.",
        "The loss of thrust at the surface is linear in the propeller's depth. It does not depend on the load"
        " or on how long the propeller has drawn air.",
        "internal_step can be at most sensor_period, sensor_delay at most seven periods.",
    ),
    sources=(
        Source(
            "Maalouf, Chemori and Creuze: A new extension of the L1 adaptive controller to drastically"
            " reduce the tracking time lags, NOLCOS 2013. Numbers in brackets are its equations.",
            "https://hal-lirmm.ccsd.cnrs.fr/lirmm-00841558",
        ),
        Source("T. I. Fossen: Marine Control Systems, Marine Cybernetics, 2002 (damping, current, surface)."),
        Source(
            "O. M. Faltinsen: Sea Loads on Ships and Offshore Structures, Cambridge University Press, 1990"
            " (forces of waves on a small body)."
        ),
        Source("DNV-RP-H103: Modelling and analysis of marine operations (added mass of a box)."),
        Source(
            "A. Kozlowska et al.: Time domain modeling of propeller forces due to ventilation in"
            " static and dynamic conditions,"
            " Journal of Marine Science and Engineering 8, 2020 (loss of thrust)."
        ),
        Source(
            "P. L'Ecuyer: Efficient and portable combined random number generators, Communications of the"
            " ACM 31(6), 1988 (the sensor's noise)."
        ),
    ),
    experiment=Experiment(
        stop_time=20.0,
        stimuli=(
            ("voltage[1]", ((1.0, 0.0), (2.0, 4.0), (8.0, 4.0), (9.0, 2.0))),
            ("voltage[2]", ((1.0, 0.0), (2.0, 4.0), (8.0, 4.0), (9.0, 2.0))),
            ("thruster_efficiency[2]", ((12.0, 1.0), (12.5, 0.7))),
            ("external_force", ((14.0, 0.0), (14.5, 0.3), (15.0, 0.0))),
            ("buoyancy_change", ((16.0, 0.0), (16.5, 0.2))),
            ("pitch", ((5.0, 0.0), (10.0, 0.2))),
        ),
    ),
)
