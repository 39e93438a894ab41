"""Block WaveSource: waves in deep water, and their motion at the depth of a vehicle.

A regular wave, or a sea with the JONSWAP spectrum whose phases follow from a seed, by the equations of
`plant_fmu.waves`.
"""

from dataclasses import dataclass
from enum import IntEnum

from fmus.block import Block, variable
from fmus.block.guide import Experiment, Guide, Source
from fmus.numerics import where
from plant_fmu import waves
from plant_fmu.waves import Components, WaterMotion


class WaveKind(IntEnum):
    """Kind of waves."""

    REGULAR = 1
    JONSWAP = 2


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(
        10.0,
        "Longest internal step; without effect, the waves follow from the time alone",
        unit="s",
        min=1e-7,
        max=1e6,
        variability="fixed",
    )
    kind: WaveKind = variable(
        WaveKind.REGULAR, "One wave, or a sea with the JONSWAP spectrum", variability="fixed", source="chosen"
    )
    wave_amplitude: float = variable(
        0.13,
        "Amplitude of the regular wave, half its height",
        unit="m",
        min=0.0,
        max=100.0,
        variability="fixed",
        source="chosen: about 1 N on RovDepthPlant at 1 m, with the period of 5 s",
    )
    start_phase: float = variable(
        0.0,
        "Phase of the regular wave at 0 s; 0 is a crest",
        unit="rad",
        min=-1e3,
        max=1e3,
        variability="fixed",
        source="chosen",
    )
    significant_height: float = variable(
        0.37,
        "Significant height H_s of the sea, four standard deviations of the elevation",
        unit="m",
        min=0.0,
        max=100.0,
        variability="fixed",
        source="chosen: the variance of the regular wave",
    )
    period: float = variable(
        5.0,
        "Period of the regular wave, or of the peak of the spectrum",
        unit="s",
        min=0.1,
        max=100.0,
        variability="fixed",
        source="chosen",
    )
    gamma: float = variable(
        3.3,
        "Height of the peak over the peak of Pierson and Moskowitz",
        min=1.0,
        max=20.0,
        variability="fixed",
        source="published: the mean of JONSWAP, Hasselmann et al. (1973)",
    )
    seed: int = variable(
        1,
        "Seed of the sea: of phases, of frequencies in their bands, and of Rayleigh amplitudes",
        min=1,
        max=2147483397,
        variability="fixed",
        source="chosen",
    )
    rayleigh_amplitudes: bool = variable(
        False,
        "Draws the amplitudes of the sea: its variance scatters from seed to seed",
        variability="fixed",
        source="chosen: all seeds have the same variance, which shortens comparisons",
    )


@dataclass(frozen=True)
class Inputs:
    depth: float = variable(0.0, "Depth of the vehicle, positive down", unit="m")


@dataclass(frozen=True)
class State:
    depth: float = variable(0.0, "Depth of the vehicle", unit="m")


def calculate(p: Parameters) -> Components:
    return where(
        p.kind == WaveKind.REGULAR,
        lambda: waves.regular_wave(p.wave_amplitude, p.period, p.start_phase),
        lambda: waves.jonswap_sea(p.significant_height, p.period, p.gamma, p.seed, p.rayleigh_amplitudes),
    )


def requirements(p: Parameters, components: Components) -> tuple:
    height = where(p.kind == WaveKind.REGULAR, 2.0 * p.wave_amplitude, p.significant_height)
    expected = f"a height of at most {waves.STEEPEST} g period^2 / (2 pi): steeper waves break"
    return ((waves.is_unbroken(height, p.period), expected),)


def initial_state(t: float, inputs: Inputs, p: Parameters, components: Components) -> State:
    return State(inputs.depth)


def step(t: float, h: float, state: State, inputs: Inputs, p: Parameters, components: Components) -> State:
    return State(inputs.depth)


def output(t: float, state: State, p: Parameters, components: Components) -> WaterMotion:
    return where(
        p.kind == WaveKind.REGULAR,
        lambda: waves.water_motion(t, state.depth, components, 1),
        lambda: waves.water_motion(t, state.depth, components),
    )


GUIDE = Guide(
    equations="""\
elevation          = sum a_i cos(w_i t + phi_i)
wave_velocity      = sum a_i w_i exp(-k_i z) sin(w_i t + phi_i),      k_i = w_i^2 / g
wave_acceleration  = sum a_i w_i^2 exp(-k_i z) cos(w_i t + phi_i)
wave_pressure_head = sum a_i exp(-k_i z) cos(w_i t + phi_i)
regular   a_1 = wave_amplitude, w_1 = 2 pi / period, phi_1 = start_phase; no other component
JONSWAP   S ~ x^-5 exp(-5/4 x^-4) gamma^exp(-(x - 1)^2 / (2 s^2)),    x = w / w_p = 0.5 .. 4
          s = 0.07 for x <= 1, 0.09 above;   sum a_i^2 / 2 = (H_s / 4)^2
          with rayleigh_amplitudes   a_i sqrt(-log r_i),   r_i uniform in (0, 1)
""",
    conventions=(
        "Depth z below the mean surface, velocity and acceleration are positive down. The elevation is"
        " positive up, the pressure head positive under a crest.",
        "Above the mean surface (z < 0) the water moves as at the surface.",
        "t is the time of the simulation, whatever its start.",
        f"A sea has {waves.COMPONENTS} components, with frequencies in bands of equal variance for gamma = 1."
        " Phases and frequencies follow from the seed, amplitudes from the spectrum, so that every seed has"
        " the same variance. With rayleigh_amplitudes it scatters from seed to seed, by 20 % (standard"
        " deviation) at gamma 3.3, about the same mean.",
    ),
    tuning=(
        "Connect the vehicle's depth to depth, and wave_velocity, wave_acceleration and wave_pressure_head to"
        " the inputs of these names of RovDepthPlant.",
        "wave_amplitude and start_phase act on a regular wave alone; significant_height, gamma and seed on a"
        " sea.",
        "One seed is one sea: take several for a statement about a sea state.",
        "The depth comes from the last communication point: its error is the distance moved in a step, 2 mm"
        " in 20 ms at 0.1 m/s. The relative error of the motion is k times it, 0.03 % at a period of 5 s.",
    ),
    limits=(
        "Linear theory in deep water: bottom, breaking and drift are left out. Waves above the steepness of"
        " breaking are refused; well below it the theory is better.",
        "wave_acceleration lacks the convective term. Its mean on a vehicle that moves with the water is"
        " sum a_i^2 w_i^2 k_i exp(-2 k_i z) / 2, downwards, where it should be 0.",
        "Waves have one direction and act at one place: the vehicle does not move horizontally, and is small"
        " beside a wave length.",
        "The spectrum ends at four times the peak frequency, above which JONSWAP has 0.4 % of its variance.",
    ),
    sources=(
        Source(
            "O. M. Faltinsen: Sea Loads on Ships and Offshore Structures, Cambridge University Press, 1990"
            " (linear waves)."
        ),
        Source(
            "K. Hasselmann et al.: Measurements of wind-wave growth and swell decay during the Joint North"
            " Sea Wave Project (JONSWAP), Deutsche Hydrographische Zeitschrift A8(12), 1973."
        ),
        Source(
            "M. J. Tucker, P. G. Challenor, D. J. T. Carter: Numerical simulation of a random sea: a common"
            " error and its effect upon wave group statistics, Applied Ocean Research 6(2), 1984 (Rayleigh"
            " amplitudes)."
        ),
        Source(
            "M. Miche: Mouvements ondulatoires de la mer en profondeur constante ou decroissante, Annales"
            " des Ponts et Chaussees, 1944 (the steepest wave)."
        ),
        Source(
            "P. L'Ecuyer: Efficient and portable combined random number generators, Communications of the"
            " ACM 31(6), 1988 (the seed)."
        ),
    ),
    experiment=Experiment(stop_time=20.0, stimuli=(("depth", ((0.0, 0.0), (20.0, 4.0))),)),
)


BLOCK = Block.of_module(
    __name__,
    "WaveSource",
    "Regular or irregular waves in deep water, at the depth of a vehicle",
    calculated=Components,
    outputs=WaterMotion,
    stop_time=160.0,
    step_size=0.02,
    license="MIT",
)
