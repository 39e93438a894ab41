"""Depth sensor: sampling, white noise, bias, drift, quantisation and delay.

    at t_k = t_0 + k T    s_k = q(z(t_k) + b + d (t_k - t_0) + sigma n_k),   q(s) = rho round(s / rho)
    in between            measured = the newest s_k with t_k + delay <= t

n_k is standard normal by Box and Muller from L'Ecuyer's combined generator (1988), whose integers
stay below 2^53 and are therefore exact in double precision: one seed, one sequence, in Python and C.
A resolution of 0 does not quantise; an ideal sensor reports z itself.
"""

import math
from dataclasses import dataclass, replace

from fmus.block import variable
from fmus.numerics import Clock, cos, floor, fmod, log, logical_and, sampled, sqrt, where

# samples kept: the delay may be HISTORY - 1 sampling periods
HISTORY = 8
# m; a finer resolution counts as 0, which keeps the quotient finite
_FINEST = 1e-9
_M_1, _A_1 = 2147483563.0, 40014.0
_M_2, _A_2 = 2147483399.0, 40692.0
_HALF = 65536.0  # a seed has 32 bits, in two halves
_ROUNDS = 4  # of a Feistel network: a strong permutation, Luby and Rackoff (1988)


@dataclass(frozen=True)
class SensorParameters:
    """Parameters of the depth sensor."""

    sensor_ideal: bool = variable(
        False, "Reports depth and pressure head of waves at every instant", variability="fixed"
    )
    sensor_period: float = variable(
        0.04,
        "Sampling period",
        unit="s",
        min=1e-4,
        max=10.0,
        variability="fixed",
        source="proxy: the pressure sensor Bar30, up to 40 ms; not the paper's",
    )
    sensor_noise: float = variable(
        0.001,
        "Standard deviation of the white noise",
        unit="m",
        min=0.0,
        max=1e3,
        source="guess: half the resolution",
    )
    sensor_bias: float = variable(0.0, "Bias", unit="m", min=-1e3, max=1e3, source="assumed")
    sensor_drift: float = variable(
        0.0, "Drift, per second of simulation", unit="m/s", min=-1e3, max=1e3, source="assumed"
    )
    sensor_resolution: float = variable(
        0.002,
        "Resolution; 0 does not quantise",
        unit="m",
        min=0.0,
        max=1e3,
        source="proxy: a Bar30 resolves 2 mm; not the paper's sensor",
    )
    sensor_delay: float = variable(
        0.0,
        "Time from a sample to its report",
        unit="s",
        min=0.0,
        max=70.0,
        variability="fixed",
        source="assumed",
    )
    sensor_seed: int = variable(
        1, "Seed of the noise", min=1, max=2147483397, variability="fixed", source="chosen"
    )


@dataclass(frozen=True)
class SensorState:
    """State of the sensor and of its random generator.

    Parameters
    ----------
    clock : Clock
        Clock of the samples.
    """

    samples: tuple[float, ...] = variable((0.0,) * HISTORY, "The last samples, the newest first")
    start: float = variable(0.0, "Start of the run", unit="s")
    clock: Clock = Clock()
    seed_1: float = variable(1.0, "First seed of the noise", min=0.0, max=_M_1)
    seed_2: float = variable(1.0, "Second seed of the noise", min=0.0, max=_M_2)


def quantise(value: float, resolution: float) -> float:
    """Returns the multiple of `resolution` nearest to `value`; `value` itself for a resolution of 0.

    Parameters
    ----------
    value, resolution : float
        Depth and resolution [m].

    Returns
    -------
    float

    Examples
    --------
    >>> quantise(0.7, 0.5), quantise(0.7, 0.0)
    (0.5, 0.7)
    """
    step = where(resolution > _FINEST, resolution, 1.0)
    return where(resolution > _FINEST, step * floor(value / step + 0.5), value)


def uniform(seed_1: float, seed_2: float) -> tuple[float, float, float]:
    """Returns a number in (0, 1) and the generator's next state.

    Parameters
    ----------
    seed_1, seed_2 : float
        State of the generator.

    Returns
    -------
    tuple of three floats
        Number, seed_1, seed_2.
    """
    seed_1 = fmod(_A_1 * seed_1, _M_1)
    seed_2 = fmod(_A_2 * seed_2, _M_2)
    difference = seed_1 - seed_2
    # one sum, of whole numbers: a proof loses its relation to the condition in two
    z = where(difference < 1.0, difference + (_M_1 - 1.0), difference)
    return z / _M_1, seed_1, seed_2


def normal(seed_1: float, seed_2: float) -> tuple[float, float, float]:
    """Returns a standard normal number and the generator's next state.

    Parameters
    ----------
    seed_1, seed_2 : float
        State of the generator.

    Returns
    -------
    tuple of three floats
        Number, seed_1, seed_2.
    """
    u, seed_1, seed_2 = uniform(seed_1, seed_2)
    v, seed_1, seed_2 = uniform(seed_1, seed_2)
    return sqrt(-2.0 * log(u)) * cos(2.0 * math.pi * v), seed_1, seed_2


def sample(p: SensorParameters, state: SensorState, t: float, depth: float) -> SensorState:
    """Returns the state after one more sample.

    Parameters
    ----------
    p : SensorParameters
    state : SensorState
        State before the sample.
    t : float
        Time of the sample [s].
    depth : float
        True depth [m].

    Returns
    -------
    SensorState
        The clock is unchanged.
    """
    n, seed_1, seed_2 = normal(state.seed_1, state.seed_2)
    true = depth + p.sensor_bias + p.sensor_drift * (t - state.start)
    newest = quantise(true + p.sensor_noise * n, p.sensor_resolution)
    return SensorState((newest, *state.samples[:-1]), state.start, state.clock, seed_1, seed_2)


def scrambled(seed: int) -> tuple[float, float]:
    """Returns the generator's first state.

    Parameters
    ----------
    seed : int
        At least 1 and below 2^32.

    Returns
    -------
    tuple of two floats
        seed_1, seed_2.
    """
    # Both components of the generator are linear: without scrambling, consecutive seeds would give sequences
    # at a constant distance. A Feistel network over the two halves of the seed, with the middle bits of a
    # square as round function, is not linear and gives every seed another state.
    high, low = _mixed(floor(seed / _HALF), _low_half(1.0 * seed))
    further_high, further_low = _mixed(high, low)
    return (
        fmod(high * _HALF + low, _M_1 - 1.0) + 1.0,
        fmod(further_high * _HALF + further_low, _M_2 - 1.0) + 1.0,
    )


def _mixed(high: float, low: float) -> tuple[float, float]:
    for i in range(_ROUNDS):
        square = (low + 40503.0 + i) * (low + 40503.0 + i)
        high, low = low, _low_half(high + floor(square / 256.0))
    return high, low


def _low_half(value: float) -> float:
    # fmod by a power of two is not used: compilers would fuse its product and sum, and round once less
    return value - _HALF * floor(value / _HALF)


def first_sample(p: SensorParameters, t: float, depth: float, seed: int) -> SensorState:
    """Returns the state of a sensor that has always read this depth.

    Parameters
    ----------
    p : SensorParameters
    t : float
        Time [s].
    depth : float
        True depth [m].
    seed : int
        Seed of the noise, 1 or more.

    Returns
    -------
    SensorState
    """
    state = sample(p, SensorState((), t, Clock(t, 1), *scrambled(seed)), t, depth)
    return replace(state, samples=(state.samples[0],) * HISTORY)


def sample_when_due(p: SensorParameters, state: SensorState, t: float, depth: float) -> SensorState:
    """Returns the state with one more sample if a sampling period has passed, else as it was.

    Parameters
    ----------
    p : SensorParameters
    state : SensorState
    t : float
        Time [s].
    depth : float
        True depth [m].

    Returns
    -------
    SensorState
    """
    return sampled(t, p.sensor_period, state, sample(p, state, t, depth))


def reading(p: SensorParameters, state: SensorState, t: float, depth: float) -> float:
    """Returns the depth that the sensor reports: the newest sample that is as old as the delay.

    Parameters
    ----------
    p : SensorParameters
    state : SensorState
    t : float
        Time [s].
    depth : float
        True depth [m], which an ideal sensor reports.

    Returns
    -------
    float
        Measured depth [m].
    """
    arrived, last_sample = state.samples[-1], state.clock.last_sample(p.sensor_period)
    for age, value in reversed(list(enumerate(state.samples))):
        # 1e-6 of a period: a delay of whole periods must not depend on the rounding of t
        waited = t - last_sample + age * p.sensor_period
        arrived = where(waited >= p.sensor_delay - 1e-6 * p.sensor_period, value, arrived)
    return where(p.sensor_ideal, depth, arrived)


def delay_fits(p: SensorParameters) -> tuple:
    """Returns the requirement that the kept samples reach back as far as the delay.

    Parameters
    ----------
    p : SensorParameters

    Returns
    -------
    tuple
        Condition, and expectation in words.
    """
    fits = logical_and(p.sensor_delay >= 0.0, p.sensor_delay <= (HISTORY - 1) * p.sensor_period)
    return fits, f"sensor_delay at most {HISTORY - 1} times sensor_period"
