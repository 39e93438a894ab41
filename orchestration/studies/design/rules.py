"""The rules by which gains follow from the data of a vehicle: docs/explanation/design.md derives them.

    A_m     s^2 + 2 w_m s + w_m^2: k_m1 = M w_m^2, k_m2 = 2 M w_m - D
    filter  w, the smallest from w_m on with |G|_L1 L <= 0.95
    PI      (s + 2 w_m / 3)^3 in place of A_m: K_P = M w_m^2 / 3, K_I = 8 M w_m^3 / 27
    PID     (s + w_0)^3: k_p = 3 M w_0^2, k_i = M w_0^3, k_d = 3 M w_0 - D

w_m and w_0 are the largest that leave the phase margin in every corner of the ranges, known delays
subtracted, and that keep the noise of the demand small.
Sources: Maalouf et al. (2013); Hovakimyan and Cao (2010); Astrom and Hagglund (2006); Benedict and Bordner
(1962).
"""

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from controller_fmu.design import FilterOrder, l1_condition, lyapunov_matrix
from fmus.extras import imports_of
from orchestration.errors import OrchestrationError
from orchestration.studies.design.vehicle_data import Range, VehicleData
from orchestration.studies.margins.l1_loop import (
    CONTROL,
    PLANT_INPUT,
    Law,
    Observer,
    Plant,
    loop,
    measurement_equations,
    plant_equations,
)
from orchestration.studies.margins.linear_margins import Equation, LinearLoop, margins

with imports_of("study", "a design"):
    from scipy.optimize import brentq

PHASE_MARGIN = 20.0  # deg; in the worst corner, where a nominal loop is asked for 45
NORM = 0.95  # of |G|_L1 L, which must stay below 1
OBSERVER_PHASE = 20.0  # deg; that the observer takes at the crossover
NOISE = 0.05  # of the thrust limit: the largest standard deviation of the demand
TURN = 0.25  # of a turn of the fast loop in a sample; at half a turn it aliases
WEIGHT = 1.0 / 9.0  # of the depth in Q, times w_m^2: the fast loop then has 90 % of the damping it can have
SIGMA = 1.5  # bound of sigma_hat, relative to the value that it has to reach
_RATIO, _STEPS = 1.1, 60  # bandwidths are tried from the highest down, each 9 % below the one before

Design = TypeVar("Design", "L1Design", "PidDesign")


@dataclass(frozen=True)
class Conditions:
    """The conditions of a design.

    step: communication step [s]; speed, depth: largest |r'| [m/s] and |r| [m] of the reference
    phase_margin: in every corner [deg]
    """

    step: float
    speed: float
    depth: float
    phase_margin: float = PHASE_MARGIN

    def delay(self, data: VehicleData) -> float:
        """Returns the known delay [s]: the sensor's, half a sample, and one and a half steps of the loop."""
        return data.delay + 0.5 * data.period + 1.5 * self.step


@dataclass(frozen=True)
class Gain:
    """A parameter of a controller, its unit, and the reason of its value."""

    name: str
    value: float | bool
    unit: str
    source: str


@dataclass(frozen=True)
class _Design:
    """Numbers that designs of both laws have.

    inertia, damping: M and D; bandwidth: w_m or w_0; alpha: of the observer, beta follows
    norm: |G|_L1 L, which PID has not; noise: of the demand [N], not a number if no filter satisfies the norm
    phase: the margin that is left [deg], delay: and as a delay [s]
    """

    inertia: float
    damping: float
    bandwidth: float
    alpha: float = 1.0
    norm: float = math.nan
    noise: float = math.nan
    phase: float = -180.0
    delay: float = math.nan


@dataclass(frozen=True)
class L1Design(_Design):
    """Design of the L1 law and of its PI extension; filter: w; lipschitz: L; adaptation_gain: Gamma."""

    filter: float = math.nan
    lipschitz: float = math.nan
    adaptation_gain: float = math.nan

    @property
    def a_m(self) -> tuple[Range, Range]:
        return (0.0, 1.0), (-(self.bandwidth**2), -2.0 * self.bandwidth)

    @property
    def state_feedback(self) -> Range:
        return self.inertia * self.bandwidth**2, 2.0 * self.inertia * self.bandwidth - self.damping

    @property
    def lyapunov_weight(self) -> Range:
        return WEIGHT * self.bandwidth**2, 1.0

    @property
    def extension(self) -> Range:
        """K_P and K_I of the PI."""
        return self.inertia * self.bandwidth**2 / 3.0, 8.0 / 27.0 * self.inertia * self.bandwidth**3

    def law(self, period: float, kappa: float, extended: bool) -> Law:
        """Returns the linear law; kappa: gain of the adaptation where the vehicle is."""
        k_p, k_i = self.extension if extended else (0.0, 0.0)
        return Law(
            a_m=self.a_m,
            b=(0.0, 1.0 / self.inertia),
            c=(1.0, 0.0),
            k_m=self.state_feedback,
            q=self.lyapunov_weight,
            filter_order=FilterOrder.FIRST,
            bandwidth=self.filter,
            proportional_gain=k_p,
            integral_gain=k_i,
            kappa=kappa,
            observer=Observer(self.alpha, beta_of(self.alpha), period, sampled=True),
        )


@dataclass(frozen=True)
class PidDesign(_Design):
    """Design of the PID controller."""

    @property
    def gains(self) -> tuple[float, float, float]:
        """k_p, k_i and k_d."""
        w = self.bandwidth
        return 3.0 * self.inertia * w**2, self.inertia * w**3, 3.0 * self.inertia * w - self.damping


def beta_of(alpha: float) -> float:
    """Returns beta of the observer for its alpha, Benedict and Bordner (1962)."""
    return alpha**2 / (2.0 - alpha)


def observer_alpha(crossover: float, period: float) -> float:
    """Returns alpha of the observer whose lag T (2 - alpha) / alpha takes `OBSERVER_PHASE` at a crossover."""
    lag = math.radians(OBSERVER_PHASE) / crossover
    return min(2.0 / (1.0 + lag / period), 1.0)


def rate_noise(alpha: float, period: float, noise: float) -> float:
    """Returns the standard deviation [m/s] of the observed rate; noise: of a sample [m], white."""
    beta = beta_of(alpha)
    return noise / period * math.sqrt(2.0 * beta**2 / (alpha * (4.0 - 2.0 * alpha - beta)))


def lipschitz_constant(data: VehicleData, inertia: float, damping: float, k_m: Range, speed: float) -> float:
    """Returns the largest L over the corners: |theta(z, z')| <= L |x|_inf for the uncertainty

        (1 - omega) k_m1 z + ((1 - omega) k_m2 + D - (M / M_z) (D_z + D_q |z'|)) z',   omega = gain M / M_z

    with M and D assumed, M_z, D_z, D_q and the gain of the thrust in their ranges, |z'| up to `speed`.
    """
    largest = 0.0
    for m_z, d_z, d_q, gain in itertools.product(data.inertia, data.damping, data.drag, data.gain):
        ratio, omega = inertia / m_z, gain * inertia / m_z
        of_rate = (1.0 - omega) * k_m[1] + damping - ratio * (d_z + d_q * speed)
        largest = max(largest, abs(1.0 - omega) * k_m[0] + abs(of_rate))
    return largest


def adaptation_gain(design_law: Law, period: float, depth: float) -> float:
    """Returns the Gamma with which the fast loop makes `TURN` of a turn in a sample at the largest depth."""
    p_b = lyapunov_matrix(np.array(design_law.a_m), np.diag(design_law.q)) @ np.array(design_law.b)
    fastest = 2.0 * math.pi * TURN / period
    return fastest**2 / (float(p_b @ np.array(design_law.b)) * (1.0 + depth**2))


def pid_loop(design: PidDesign, period: float, plant: Plant) -> LinearLoop:
    """Returns the loop of the PID controller, cut where the control enters the plant."""
    k_p, k_i, k_d = design.gains
    observer = Observer(design.alpha, beta_of(design.alpha), period, sampled=True)
    law = [
        Equation({"integral": 1.0}, {"m1": 1.0}),
        Equation({}, {CONTROL: -1.0, "m1": -k_p, "integral": -k_i, "m2": -k_d}),
    ]
    equations = (*plant_equations(plant), *measurement_equations(observer), *law)
    return LinearLoop(equations, PLANT_INPUT, CONTROL)


def corner_plants(data: VehicleData) -> Iterator[Plant]:
    """Yields the linear plant at rest in each corner, with the longest lag of the thrusters."""
    for inertia, damping, gain in itertools.product(*map(sorted, map(set, _ranges(data)))):
        yield Plant(((0.0, 1.0), (0.0, -damping / inertia)), (0.0, 1.0 / inertia), (gain,), (data.lag,))


def _ranges(data: VehicleData) -> tuple[Range, Range, Range]:
    return data.inertia, data.damping, data.gain


def margin_left(loops: Iterator[LinearLoop], known_delay: float, enough: float) -> tuple[float, float]:
    """Returns the smallest phase margin [deg] and delay margin [s] that known delays leave.

    It ends with the first that is below `enough`; -180 degrees for a loop that is not stable.
    """
    worst, delay = 180.0, math.inf
    for one in loops:
        own = margins(one)
        if math.isnan(own.delay):
            return -180.0, math.nan
        left = own.delay - known_delay
        if math.isfinite(left):
            worst, delay = min(worst, math.degrees(left * own.frequency)), min(delay, left)
        if worst < enough:
            break
    return worst, delay


def design_l1(data: VehicleData, conditions: Conditions, bandwidth: float = 0.0) -> L1Design:
    """Returns the design of L1 and its extension; OrchestrationError if no bandwidth fits the conditions.

    bandwidth: w_m [rad/s]; 0 for the largest
    """
    return _largest("L1", _l1_at, data, conditions, bandwidth)


def design_pid(data: VehicleData, conditions: Conditions, bandwidth: float = 0.0) -> PidDesign:
    """Returns the design of PID; OrchestrationError if no bandwidth fits the conditions."""
    return _largest("PID", _pid_at, data, conditions, bandwidth)


def _largest(
    law: str,
    made: Callable[[VehicleData, Conditions, float, float], Design],
    data: VehicleData,
    conditions: Conditions,
    bandwidth: float,
) -> Design:
    """Returns the design of the largest bandwidth that fits, or of the one that is given.

    made: returns the design at a bandwidth, whose margins end with the first below the last argument
    """
    delay, enough = conditions.delay(data) + data.lag, conditions.phase_margin
    bandwidths = [bandwidth] if bandwidth else [1.0 / (delay * _RATIO**i) for i in range(_STEPS)]
    tried = list[Design]()
    for w in bandwidths:
        tried.append(made(data, conditions, float(f"{w:.3g}"), enough))
        if not _misfits(tried[-1], data, enough):
            return tried[-1]

    def nearness(design: Design) -> tuple[float, float]:
        return min(design.phase, enough), -(design.norm if math.isnan(design.noise) else design.noise)

    # a margin that ended early is above the smallest: the message needs that over all corners
    nearest: Design | None = None
    for design in sorted(tried, key=nearness, reverse=True):
        if nearest and nearness(design) <= nearness(nearest):
            break
        whole = made(data, conditions, design.bandwidth, -math.inf)
        nearest = max(nearest or whole, whole, key=nearness)
    assert nearest
    misfits = _misfits(nearest, data, enough)
    others = " and ".join(hint for hint in misfits.values() if hint)
    searched = "" if bandwidth else f", the best of {bandwidths[-1]:.2g} to {bandwidths[0]:.2g} rad/s"
    raise OrchestrationError(
        f"no {law} for {data.name}: {', and '.join(misfits)}, at {nearest.bandwidth:.3g} rad/s{searched}: "
        f"expected narrower ranges in [vary.*] (inertia {_text(data.inertia)} kg, damping "
        f"{_text(data.damping)} N.s/m, thrust {_text(data.gain)}), less delay ({1e3 * delay:.0f} ms)"
        f"{others and f', or {others}'}"
    )


def _text(ends: Range) -> str:
    return f"{ends[0]:.3g} to {ends[1]:.3g}"


def _l1_at(data: VehicleData, conditions: Conditions, w_m: float, enough: float) -> L1Design:
    """Returns the design at a bandwidth; without noise and margin if no filter satisfies the norm."""
    inertia, middle = data.assumed
    # more damping than this would make k_m2 negative
    damping = min(middle, 2.0 * inertia * w_m)
    made = L1Design(inertia, damping, w_m)
    lipschitz = lipschitz_constant(data, inertia, damping, made.state_feedback, 2.0 * conditions.speed)
    a_m, b = np.array(made.a_m), np.array([0.0, 1.0 / inertia])
    omegas = [data.gain[0] * inertia / data.inertia[1], 1.0, data.gain[1] * inertia / data.inertia[0]]

    def excess(logarithm: float) -> float:
        w = math.exp(logarithm)
        return l1_condition(a_m, b, FilterOrder.FIRST, w, lipschitz, omegas=omegas) - NORM

    # a crossover beyond 1 / delay leaves no margin
    lowest, highest = math.log(w_m), math.log(max(1.0 / conditions.delay(data), 1.01 * w_m))
    at_lowest = excess(lowest)
    if at_lowest > 0.0 and (at_highest := excess(highest)) > 0.0:
        return replace(made, filter=math.exp(highest), norm=at_highest + NORM)
    root: Any = brentq(excess, lowest, highest, xtol=1e-3) if at_lowest > 0.0 else lowest
    w = math.exp(root)
    alpha = observer_alpha(2.0 * w_m + w, data.period)
    # of the rate in the demand: k_m2, and M w by the filter
    noise = (made.state_feedback[1] + inertia * w) * rate_noise(alpha, data.period, data.noise)
    made = replace(made, filter=w, alpha=alpha, lipschitz=lipschitz, norm=excess(root) + NORM, noise=noise)
    slow = adaptation_gain(made.law(data.period, math.inf, False), data.period, conditions.depth)
    loops = (
        loop(made.law(data.period, kappa, extended), plant)
        for extended in (True, False)
        for kappa in (slow * (1.0 + conditions.depth**2), slow)
        for plant in corner_plants(data)
    )
    phase, delay = margin_left(loops, conditions.delay(data), enough)
    return replace(made, adaptation_gain=slow, phase=phase, delay=delay)


def _pid_at(data: VehicleData, conditions: Conditions, w_0: float, enough: float) -> PidDesign:
    inertia, middle = data.assumed
    # more damping than this would make k_d negative
    damping = min(middle, 3.0 * inertia * w_0)
    alpha = observer_alpha(3.0 * w_0, data.period)
    made = PidDesign(inertia, damping, w_0, alpha)
    noise = made.gains[2] * rate_noise(alpha, data.period, data.noise)
    loops = (pid_loop(made, data.period, plant) for plant in corner_plants(data))
    phase, delay = margin_left(loops, conditions.delay(data), enough)
    return replace(made, noise=noise, phase=phase, delay=delay)


def _misfits(design: _Design, data: VehicleData, phase_margin: float) -> dict[str, str]:
    """Returns each misfit of a design -> its remedy other than narrower ranges."""
    if math.isnan(design.noise):
        norm = (
            f"|G|_L1 L of the L1-norm condition is {design.norm:.3g} with the fastest filter for this delay"
        )
        return {f"{norm}, at most {NORM:g} is allowed": ""}
    misfits = dict[str, str]()
    if design.phase < phase_margin:
        shown = f"leaves {design.phase:.3g} deg" if design.phase > -180.0 else "is not stable"
        misfits[f"the loop {shown} in a corner, {phase_margin:g} deg are asked for"] = (
            "a smaller --phase-margin"
        )
    if design.noise > (largest := NOISE * data.force_limit):
        misfits[f"the sensor's noise gives a demand of {design.noise:.3g} N, {largest:.3g} N are allowed"] = (
            f"a sensor with less noise ({1e3 * data.noise:.3g} mm)"
        )
    return misfits
