"""Waves of small steepness in deep water, linear theory: a sum of components of one direction.

    eta         = sum a_i cos(w_i t + phi_i)                          elevation, positive up
    w_f         = sum a_i w_i exp(-k_i z) sin(w_i t + phi_i)          vertical orbital velocity, positive down
    w_f'        = sum a_i w_i^2 exp(-k_i z) cos(w_i t + phi_i)        its derivative at a fixed depth
    p / (rho g) = sum a_i exp(-k_i z) cos(w_i t + phi_i)              pressure head, positive under a crest
    k_i         = w_i^2 / g                                           each component has its own length

z [m] is the depth below the mean surface, positive down; above it (z < 0) the water moves as at the surface.
Source: Faltinsen, Sea Loads on Ships and Offshore Structures (1990), chapter 2.
"""

import math
from dataclasses import dataclass

from fmus.block import variable
from fmus.numerics import cos, exp, log, matmul, maximum, sin, sqrt, where
from plant_fmu.depth_sensor import scrambled, uniform
from plant_fmu.heave import GRAVITY

COMPONENTS = 32
LOWEST, HIGHEST = 0.5, 4.0  # of the peak frequency, as the signal `spectrum` of the scenarios
STEEPEST = 0.142  # height / length of a breaking wave: Miche (1944)
# added to the seed: a sea must not repeat the numbers of a sensor with the same seed
_OTHER_SEEDS = 2**31
_Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Components:
    """Components of the waves; a regular wave has the first alone."""

    amplitude: _Numbers = variable(
        (0.0,) * COMPONENTS, "Amplitude of a component", unit="m", variability="fixed"
    )
    angular_frequency: _Numbers = variable(
        (1.0,) * COMPONENTS, "Angular frequency of a component", unit="rad/s", variability="fixed"
    )
    wave_number: _Numbers = variable(
        (0.1,) * COMPONENTS, "Wave number of a component, w^2 / g", unit="1/m", variability="fixed"
    )
    phase: _Numbers = variable(
        (0.0,) * COMPONENTS, "Phase of a component at 0 s, 0 at a crest", unit="rad", variability="fixed"
    )


@dataclass(frozen=True)
class WaterMotion:
    """Motion of the water at a depth."""

    elevation: float = variable(0.0, "Elevation of the surface, positive up", unit="m")
    wave_velocity: float = variable(0.0, "Vertical orbital velocity at the depth, positive down", unit="m/s")
    wave_acceleration: float = variable(
        0.0, "Vertical orbital acceleration at the depth, positive down", unit="m/s2"
    )
    wave_pressure_head: float = variable(
        0.0, "Pressure of the waves at the depth over rho g, positive under a crest", unit="m"
    )


def water_motion(t: float, depth: float, waves: Components, count: int = COMPONENTS) -> WaterMotion:
    """Returns the vertical motion at a time [s] and depth [m], of the first `count` components."""
    submerged = maximum(depth, 0.0)
    angles = [
        w * t + phase for w, phase in zip(waves.angular_frequency[:count], waves.phase[:count], strict=True)
    ]
    decayed = tuple(
        a * exp(-k * submerged)
        for a, k in zip(waves.amplitude[:count], waves.wave_number[:count], strict=True)
    )
    cosines = tuple(map(cos, angles))
    heads = tuple(a * c for a, c in zip(decayed, cosines, strict=True))
    displacements = tuple(a * sin(angle) for a, angle in zip(decayed, angles, strict=True))
    return WaterMotion(
        elevation=matmul(waves.amplitude[:count], cosines),
        wave_velocity=matmul(waves.angular_frequency[:count], displacements),
        wave_acceleration=GRAVITY * matmul(waves.wave_number[:count], heads),
        wave_pressure_head=matmul((1.0,) * count, heads),
    )


def regular_wave(amplitude: float, period: float, phase: float) -> Components:
    """Returns a regular wave: amplitude [m], period [s], phase [rad] at 0 s, 0 at a crest."""
    w, others = 2.0 * math.pi / period, (0.0,) * (COMPONENTS - 1)
    frequencies, numbers = (w,) * COMPONENTS, (w * w / GRAVITY,) * COMPONENTS
    return Components((amplitude, *others), frequencies, numbers, (phase, *others))


def jonswap_sea(
    significant_height: float, peak_period: float, gamma: float, seed: int, has_rayleigh_amplitudes: bool
) -> Components:
    """Returns an irregular sea with the JONSWAP spectrum, x = w / w_p:

        S ~ x^-5 exp(-5/4 x^-4) gamma^exp(-(x - 1)^2 / (2 s^2)),   s = 0.07 for x <= 1, 0.09 above

    From LOWEST to HIGHEST, as many bands as components have equal shares of the variance for gamma = 1. The
    seed draws a frequency in each band and a phase. Amplitudes follow from the spectrum at the frequencies:
    the variance is (significant_height / 4)^2 for every seed. Rayleigh amplitudes are drawn about these, with
    the same mean square, and the elevation is then a sample of a Gaussian process. So the variance scatters
    from seed to seed, as it does between records of one sea; its mean stays.

    seed: 1 or more, below 2^31
    Source: Hasselmann et al. (1973), JONSWAP; Tucker, Challenor and Carter (1984), Rayleigh amplitudes.
    """
    first, last = (math.exp(-1.25 * x**-4.0) for x in (LOWEST, HIGHEST))
    seeds = scrambled(seed + _OTHER_SEEDS)
    ratios, phases, weights = [], [], []
    for i in range(COMPONENTS):
        u, *seeds = uniform(*seeds)
        v, *seeds = uniform(*seeds)
        # the share of the variance below x is exp(-5/4 x^-4) for gamma = 1
        ratio = sqrt(sqrt(-1.25 / log(first + (last - first) * (i + u) / COMPONENTS)))
        width = where(ratio <= 1.0, 0.07, 0.09)
        weights.append(exp(log(gamma) * exp(-((ratio - 1.0) ** 2) / (2.0 * width**2))))
        ratios.append(ratio)
        phases.append(2.0 * math.pi * v)
    factors = []
    for _ in range(COMPONENTS):
        u, *seeds = uniform(*seeds)
        # the square of an amplitude with a Rayleigh distribution is exponential
        factors.append(where(has_rayleigh_amplitudes, sqrt(-log(u)), 1.0))
    total = matmul((1.0,) * COMPONENTS, tuple(weights))
    frequencies = tuple(2.0 * math.pi / peak_period * ratio for ratio in ratios)
    return Components(
        tuple(
            significant_height / 4.0 * sqrt(2.0 * weight / total) * factor
            for weight, factor in zip(weights, factors, strict=True)
        ),
        frequencies,
        tuple(w * w / GRAVITY for w in frequencies),
        tuple(phases),
    )


def is_unbroken(height: float, period: float) -> bool:
    """Whether a wave does not break: height [m] from trough to crest, period [s]."""
    return height <= STEEPEST * GRAVITY * period * period / (2.0 * math.pi)
