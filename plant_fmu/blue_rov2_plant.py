"""Block BlueRov2Plant: a BlueROV2 Heavy in heave and pitch, from published numbers; none is fitted here.

RovHeavePitchPlant has the equations. The two voltages drive the fore and the aft pair of the four vertical
thrusters. A number that is not published for this vehicle has the source choice, guess or estimate.
"""

from dataclasses import replace

from fmus.block.guide import Experiment, Source
from plant_fmu import heave_pitch_plant
from plant_fmu.heave_pitch_guide import GUIDE

_TABLE = "published: von Benzon et al. (2022), table A1"
# m/s2: the source computes weight and buoyancy with it
_GRAVITY = 9.82
_MASS, _VOLUME, _DENSITY = 13.5, 0.0134, 1000.0  # kg, m3, kg/m3: table A1
_BAR30 = "published: a Bar30, the depth sensor of this vehicle"
_PLACE = "assumed: at the centre of gravity; no place was found published for a Heavy"
_BESIDE_TABLE = "without effect beside the table"

_STARTS = {
    "internal_step": (0.005, "chosen: 0.45 of the fastest pole of the thrusters, 91 rad/s"),
    "initial_depth": (0.0, "chosen: the surface"),
    "inertia": (_MASS + 18.68, f"{_TABLE}: 13.5 kg and 18.68 kg of added mass"),
    "linear_damping": (33.0, _TABLE),
    "quadratic_damping": (190.0, _TABLE),
    "weight": (_MASS * _GRAVITY, f"{_TABLE}: 13.5 kg at 9.82 m/s2"),
    "net_weight": (
        (_MASS - _DENSITY * _VOLUME) * _GRAVITY,
        f"{_TABLE}: 0.0134 m3 in fresh water; it sinks",
    ),
    "free_surface": (True, "chosen"),
    "water_density": (_DENSITY, f"{_TABLE}: fresh water"),
    "waterplane_area": (
        _VOLUME / 0.25,
        "estimate: the published volume over a height of 0.25 m, for which Blue Robotics give 254 mm",
    ),
    "thruster_ideal": (False, "published: the thrusters have a dead band and dynamics"),
    "thruster_gain": (
        (2.0 * 4.07 * 9.80665 / 12.0,) * 2,
        f"chosen: a line to the table's force at 12 V; {_BESIDE_TABLE}",
    ),
    "thruster_dead_zone": ((0.0, 0.0), _BESIDE_TABLE),
    "thruster_voltage_limit": ((12.0, 12.0), "chosen: the ends of the table, pulses of 1100 us and 1900 us"),
    "thruster_lag": ((0.0, 0.0), "left out: the transfer function has its place"),
    "thruster_rate_limit": ((0.0, 0.0), "left out: none was found published"),
    "thruster_reverse_ratio": ((1.0, 1.0), _BESIDE_TABLE),
    "thruster_curvature": ((0.0, 0.0), _BESIDE_TABLE),
    "thruster_curve_voltage": ((12.0, 12.0), _BESIDE_TABLE),
    "thruster_tabulated": (True, "published: the T200 has a dead band and gives more forward"),
    "thruster_scale": ((2.0, 2.0), "published: two vertical thrusters fore and two aft"),
    "thruster_transfer": (
        (6136.0, 89.0, 9258.0, 108700.0),
        "published: von Benzon et al. (2022), and bluerov2_dynamics, fossen/thrust_dynamics.m",
    ),
    "thruster_lever": ((0.12, -0.12), _TABLE),
    "thruster_depth": (0.125, "guess: half of the height; without effect but for ventilation"),
    "thruster_full_depth": (0.0, "left out: none was found published"),
    "pitch_inertia": (0.23 + 0.135, f"{_TABLE}: 0.23 kg.m2 and 0.135 kg.m2 of added inertia"),
    "metacentric_height": (0.01, _TABLE),
    "pitch_linear_damping": (0.8, _TABLE),
    "pitch_quadratic_damping": (0.47, _TABLE),
    "sensor_ideal": (False, "published: the vehicle has a depth sensor"),
    "sensor_period": (0.04, f"{_BAR30}, reads in up to 40 ms"),
    "sensor_noise": (
        0.001,
        "guess: half the resolution; simulated ArduSub has 20 mm, from logs (ArduPilot, pull request 9165)",
    ),
    "sensor_resolution": (0.002, f"{_BAR30}, resolves 2 mm"),
    "sensor_forward": (0.0, f"{_PLACE}; orca2, orca.urdf.xacro, has it 0.16 m aft in a BlueROV2"),
    "sensor_below": (0.0, _PLACE),
    "pitch_noise": (0.002, "guess: 0.1 degrees; none was found published"),
}

BLOCK = heave_pitch_plant.BLOCK.with_starts(
    __name__,
    "BlueRov2Plant",
    "Heave and pitch of a BlueROV2 Heavy, with T200 thrusters and a depth sensor",
    _STARTS,
    guide=replace(
        GUIDE,
        conventions=(
            *GUIDE.conventions,
            "Forward thrust is up, as in the source. The map from volts to pulses is a choice: a line from"
            " -12 V and 1900 us to 12 V and 1100 us. So a positive voltage is reverse thrust, down: both"
            " pairs give 160 N down at 12 V and 206 N up at -12 V.",
            "The dead band of 1472 us to 1528 us is -0.84 V to 0.84 V.",
        ),
        tuning=(
            "Controllers of l1-depth invert the table with controller.thruster_tabulated, and"
            " controller.thruster_scale[1] and [2] at 2.",
            "Sea water: net_weight -2.6 N and water_density 1027 kg/m3.",
        ),
        limits=(
            "Surge is neglected. Thrust F at a pitch of 0.1 rad pushes forward by 0.1 F; the added mass of"
            " heave is 12.3 kg above the added mass of surge, which turns the vehicle by 12.3 kg u w: 0.06"
            " N.m at 0.1 m/s and 0.05 m/s, 0.05 rad of pitch.",
            "The righting moment contains the weight instead of the buoyancy, a difference of 0.7 %, also at"
            " the surface. The free surface acts on heave alone.",
            "One pair at full reverse thrust tumbles the vehicle: its moment is 9.6 N.m, the righting moment"
            " at most 1.3 N.m.",
            "The hydrodynamic numbers were identified in a tank by others. Other sets of numbers of this"
            " vehicle exist, with 11.4 kg and a metacentric height of 0.1 m; they are not mixed with these.",
            "The table has every tenth row of its source, and the ends of the dead band. It was measured in"
            " fresh water, at rest, at a constant 16 V.",
            "internal_step can be at most sensor_period and 10 ms, sensor_delay at most seven periods.",
        ),
        sources=(
            Source(
                "M. von Benzon et al.: An Open-Source Benchmark Simulator: Control of a BlueROV2 Underwater"
                " Robot, Journal of Marine Science and Engineering 10(12):1898, 2022.",
                "https://doi.org/10.3390/jmse10121898",
            ),
            Source(
                "V. Nan Fernandez-Ayala: bluerov2_dynamics, MIT licence (the same numbers as a program).",
                "https://github.com/ViktorNfa/bluerov2_dynamics",
            ),
            Source(
                "C.-J. Wu: 6-DoF Modelling and Control of a Remotely Operated Vehicle, thesis, Flinders"
                " University, 2018 (the tank tests)."
            ),
            Source(
                "Blue Robotics: T200 public performance data, 10 V to 20 V, September 2019.",
                "https://cad.bluerobotics.com/T200-Public-Performance-Data-10-20V-September-2019.xlsx",
            ),
            *GUIDE.sources,
        ),
        experiment=Experiment(
            stop_time=20.0,
            stimuli=(
                ("voltage[1]", ((1.0, 0.0), (2.0, 2.0), (8.0, 2.0), (9.0, -1.5))),
                ("voltage[2]", ((1.0, 0.0), (2.0, 2.0), (8.0, 1.8), (9.0, -1.5))),
                ("thruster_efficiency[2]", ((12.0, 1.0), (12.5, 0.95))),
                ("external_force", ((14.0, 0.0), (14.5, 5.0), (15.0, 0.0))),
                ("external_moment", ((16.0, 0.0), (16.5, 0.2), (17.0, 0.0))),
            ),
        ),
    ),
)
