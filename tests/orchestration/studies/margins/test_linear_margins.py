"""Margins of the linear loop: closed forms, SciPy's transfer functions, a simulation with a delay."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import signal
from scipy.linalg import expm, solve_continuous_lyapunov

from controller_fmu.design import FilterOrder
from orchestration.studies.margins.l1_loop import Law, Observer, Plant, loop
from orchestration.studies.margins.linear_margins import Equation, LinearLoop, LinearMargins, margins
from orchestration.studies.margins.margins_figure import margins_figure

M, D, K_1, K_2, W, K_P, K_I, LAG = 5.5, 2.5, 1.895, 20.23, 0.3017, 3.967, 0.00499, 0.05
A_M = ((0.0, 1.0), (-K_1 / M, -(D + K_2) / M))
LAW = Law(
    a_m=A_M, b=(0.0, 1.0 / M), c=(1.0, 0.0), k_m=(K_1, K_2), q=(1.0, 1.0),
    filter_order=FilterOrder.FIRST, bandwidth=W, proportional_gain=K_P, integral_gain=K_I,
)  # fmt: skip
IDEAL = Plant(((0.0, 1.0), (0.0, -D / M)), (0.0, 1.0 / M))
LAGGING = replace(IDEAL, lags=(LAG,))
OBSERVER = Observer(alpha=0.4, beta=0.1, period=0.04)


def integrator(gain: float) -> LinearLoop:
    """x' = input, u = -gain x."""
    rows = Equation({"x": 1.0}, {"input": 1.0}), Equation({}, {"u": -1.0, "x": -gain})
    return LinearLoop(rows, "input", "u")


def test_an_integrator_bears_a_quarter_of_a_turn() -> None:
    loop_margins = margins(integrator(4.0))
    assert loop_margins.delay == pytest.approx(0.5 * math.pi / 4.0, rel=1e-9)
    assert loop_margins.frequency == pytest.approx(4.0, rel=1e-9)
    assert (loop_margins.low_gain, loop_margins.high_gain) == (0.0, math.inf)


def test_three_lags_bear_a_gain_of_eight() -> None:
    """L = -1 / (s + 1)^3 has its phase crossover at sqrt(3) rad/s, where |L| = 1 / 8."""
    rows = (
        Equation({"a": 1.0}, {"a": -1.0, "input": 1.0}),
        Equation({"b": 1.0}, {"b": -1.0, "a": 1.0}),
        Equation({"c": 1.0}, {"c": -1.0, "b": 1.0}),
        Equation({}, {"u": -1.0, "c": -1.0}),
    )
    loop_margins = margins(LinearLoop(rows, "input", "u"))
    assert loop_margins.high_gain == pytest.approx(8.0, rel=1e-9)
    assert loop_margins.low_gain == 0.0  # L(0) = -1 asks for a gain of -1
    assert loop_margins.delay == math.inf  # |L| < 1 everywhere


def test_a_loop_that_is_unstable_has_no_margins() -> None:
    loop_margins = margins(integrator(-1.0))
    assert all(math.isnan(value) for value in vars(loop_margins).values())


def test_a_missing_equation_is_refused() -> None:
    with pytest.raises(ValueError, match="1 equations: expected one for each of"):
        _ = LinearLoop((Equation({"x": 1.0}, {"y": 1.0}),), "input", "x").signals


def by_transfer_functions(k_d: tuple[list[float], list[float]], lag: float) -> LinearMargins:
    """The limit with the true state, by hand, without the predictor: eta is what x' - A_m x and u show of it.

    K = k_1 + k_2 s + kD (M s^2 + (D + k_2) s + k_1) + (1 + kD) (K_P + K_I / s)
    P = 1 / (M s^2 + D s) / (lag s + 1)
    """
    n, d = k_d
    a_m = [M, D + K_2, K_1]
    pi = [K_P, K_I]
    feedback = np.polymul([K_2, K_1], np.polymul(d, [1.0, 0.0]))
    adaptive = np.polymul(np.polymul(n, a_m), [1.0, 0.0])
    numerator = np.polyadd(np.polyadd(feedback, adaptive), np.polymul(np.polyadd(n, d), pi))
    plant = np.polymul([M, D, 0.0], [lag, 1.0] if lag else [1.0])
    denominator = np.polymul(np.polymul(d, [1.0, 0.0]), plant)
    w = np.geomspace(0.1, 100.0, 400_001)
    _, response = signal.freqresp(signal.TransferFunction(numerator, denominator), w)
    magnitude = np.abs(response)
    crossings = np.flatnonzero(np.diff(np.sign(magnitude - 1.0)))
    assert len(crossings) == 1
    i = crossings[0]
    phase_margin = (math.pi + np.angle(response[i])) % (2.0 * math.pi)
    return LinearMargins(float(phase_margin / w[i]), float(w[i]), math.nan, math.nan)


@pytest.mark.parametrize("lag", [0.0, LAG])
@pytest.mark.parametrize(
    ("order", "k_d"),
    [
        (FilterOrder.FIRST, ([W], [1.0, 0.0])),
        (FilterOrder.THIRD, ([3.0 * W**2, W**3], [1.0, 3.0 * W, 0.0, 0.0])),
    ],
)
def test_the_limit_of_fast_adaptation_is_the_linear_controller_derived_by_hand(
    order: FilterOrder, k_d: tuple[list[float], list[float]], lag: float
) -> None:
    loop_margins = margins(loop(replace(LAW, filter_order=order), replace(IDEAL, lags=(lag,))))
    expected = by_transfer_functions(k_d, lag)
    assert loop_margins.delay == pytest.approx(expected.delay, rel=1e-4)  # a step of its grid
    assert loop_margins.frequency == pytest.approx(expected.frequency, rel=1e-4)


@pytest.mark.parametrize("observer", [None, OBSERVER])
def test_the_delay_margin_converges_with_the_adaptation_gain(observer: Observer | None) -> None:
    law = replace(LAW, observer=observer)
    limit = margins(loop(law, LAGGING)).delay
    errors = [abs(margins(loop(replace(law, kappa=kappa), LAGGING)).delay - limit) for kappa in (1e6, 1e8)]
    assert errors[0] < 1e-3 * limit
    assert errors[1] == pytest.approx(0.01 * errors[0], rel=0.05)  # of first order in 1 / kappa


@pytest.mark.parametrize("sampled", [False, True])
def test_the_limit_with_the_observer_is_that_of_its_frequency_response(sampled: bool) -> None:
    """By hand: x_hat is exact in the combination that the adaptation sees, not in each of its states.

    With H the response from depth to rate and lambda = p_12 / p_22, (x_hat - x)' P b = 0 gives
    eta = M s H + k_1 + (D + k_2) H - (lambda (M s + D + k_2) - k_1) (H - s) / (s + lambda), less u_a + u_p.
    """
    w = np.geomspace(1.0, 20.0, 200_001)
    s, alpha, beta, t = 1j * w, OBSERVER.alpha, OBSERVER.beta, OBSERVER.period
    q = np.exp(s * t)
    if sampled:
        rate = beta / t * q * (q - 1.0) / (q**2 + (alpha + beta - 2.0) * q + 1.0 - alpha)
    else:
        rate = beta / t**2 * s / (s**2 + alpha / t * s + beta / t**2)
    p = solve_continuous_lyapunov(np.array(A_M).T, -np.eye(2))
    part = p[0, 1] / p[1, 1]
    eta = M * s * rate + K_1 + (D + K_2) * rate
    eta -= (part * (M * s + D + K_2) - K_1) * (rate - s) / (s + part)
    k = K_1 + K_2 * rate + W / s * eta + (1.0 + W / s) * (K_P + K_I / s)
    response = k / (M * s**2 + D * s) / (LAG * s + 1.0)
    (i,) = np.flatnonzero(np.diff(np.sign(np.abs(response) - 1.0)))
    expected = (math.pi + np.angle(response[i])) % (2.0 * math.pi) / w[i]
    delay = margins(loop(replace(LAW, observer=replace(OBSERVER, sampled=sampled)), LAGGING)).delay
    # the bilinear equivalent has every frequency wrong by (w T)^2 / 12 = 0.2 %
    assert delay == pytest.approx(expected, rel=7e-3 if sampled else 1e-4)


def simulated_growth(kappa: float, delay: float) -> float:
    """Logarithm of how much the loop with lag and observer grows from 10 s to 60 s, its control delayed.

    Written apart from `l1_loop`: states z, v, f, both of the observer, x_hat, eta, u_a and the integral; the
    control is a straight line between the steps, of which the delay is a hundred.
    """
    first, second = OBSERVER.alpha / OBSERVER.period, OBSERVER.beta / OBSERVER.period**2
    p_b = solve_continuous_lyapunov(np.array(A_M).T, -np.eye(2)) @ np.array([0.0, 1.0 / M])
    z, v, f, zo, vo, x1, x2, eta, u_a, q = range(10)
    a, b = np.zeros((10, 10)), np.zeros((10, 1))
    a[z, v] = 1.0
    a[v, [v, f]] = -D / M, 1.0 / M
    a[f, f], b[f] = -1.0 / LAG, 1.0 / LAG
    a[zo, [vo, z, zo]] = 1.0, first, -first
    a[vo, [z, zo]] = second, -second
    a[x1, x2] = 1.0
    # told u_a + u_p, with u_p = -K_P z - K_I q
    a[x2, [x1, x2, eta, u_a, z, q]] = A_M[1][0], A_M[1][1], 1.0 / M, 1.0 / M, -K_P / M, -K_I / M
    a[eta, [x1, z, x2, vo]] = kappa * np.array([-p_b[0], p_b[0], -p_b[1], p_b[1]])
    a[u_a, [u_a, eta]] = -W
    a[q, z] = 1.0
    row = np.zeros(10)
    row[[z, vo, u_a, q]] = -K_1 - K_P, -K_2, 1.0, -K_I
    h, lead = delay / 100, 100
    # [x, u, u'] over a step: exact for a control that is a straight line
    block = np.zeros((12, 12))
    block[:10, :10], block[:10, 10:11], block[10, 11] = a, b, 1.0
    step = expm(block * h)
    over, held, ramp = step[:10, :10], step[:10, 10], step[:10, 11] / h
    count = round(60.0 / h)
    x, controls = np.zeros(10), np.zeros(count + lead + 1)
    x[z], sizes = 1.0, np.zeros(count)
    for i in range(count):
        controls[i + lead] = row @ x
        x = over @ x + held * controls[i] + ramp * (controls[i + 1] - controls[i])
        sizes[i] = abs(x[v])
    early, late = (slice(round(t / h), round((t + 5.0) / h) - lead) for t in (10.0, 55.0))
    return math.log(sizes[late].max() / sizes[early].max())


@pytest.mark.parametrize("kappa", [164.59, 1e6])
def test_a_simulation_with_a_delay_is_stable_below_the_margin_and_unstable_above(kappa: float) -> None:
    """At 98 % and 102 % of it, over 45 s."""
    loop_margins = margins(loop(replace(LAW, kappa=kappa, observer=OBSERVER), LAGGING))
    assert simulated_growth(kappa, 0.98 * loop_margins.delay) < -0.5
    assert simulated_growth(kappa, 1.02 * loop_margins.delay) > 0.5


def test_the_poles_leave_the_left_half_plane_at_the_gain_margin() -> None:
    law, loop_margins = (
        replace(LAW, observer=OBSERVER),
        margins(loop(replace(LAW, observer=OBSERVER), LAGGING)),
    )
    for factor, is_stable in ((0.98, True), (1.02, False)):
        plant = replace(LAGGING, gains=(factor * loop_margins.high_gain,))
        assert bool(loop(law, plant).poles().real.max() < 0.0) is is_stable


def test_the_fast_loop_of_the_example_bears_less_delay_than_its_limit() -> None:
    """With kappa b' P b below about w^3 / (2 a) a delay of microseconds excites the adaptation.

    w = 160 rad/s of the filter, a = 0.7 /s the damping of the fast loop; docs/explanation/margins.md.
    """
    law = Law(
        a_m=((0.0, 1.0), (-1.0, -1.4)), b=(0.0, 1.0), c=(1.0, 0.0), k_m=(0.0, 0.0), q=(1.0, 1.0),
        filter_order=FilterOrder.FIRST, bandwidth=160.0,
    )  # fmt: skip
    plant = Plant(((0.0, 1.0), (3.0, -5.9)), (0.0, 1.0))
    limit = margins(loop(law, plant)).delay
    assert limit == pytest.approx(0.0100, abs=5e-5)
    assert margins(loop(replace(law, kappa=1e6), plant)).delay < 1e-4
    assert margins(loop(replace(law, kappa=1e8), plant)).delay == pytest.approx(limit, rel=1e-3)


def test_the_diagrams_mark_the_margins_on_the_frequency_response() -> None:
    """The crossover is on the unit circle, gain margins on the real axis."""
    lagging = loop(replace(LAW, observer=OBSERVER, kappa=3000.0), LAGGING)
    known = margins(lagging)
    figure = margins_figure("a loop", "lag and observer", lagging)
    panels: list[Any] = figure.axes
    assert [axis.get_label_text() for panel in panels for axis in (panel.xaxis, panel.yaxis)] == [
        "",
        "Gain [dB]",
        "Real part [1]",
        "Imaginary part [1]",
        "Frequency [rad/s]",
        "Phase [deg]",
    ]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[1].startswith(f"delay margin {known.delay:.4g} s, phase margin ")
    assert labels[2].startswith(f"largest gain {known.high_gain:.4g} at ")
    assert labels[3].startswith(f"smallest gain {known.low_gain:.4g} at ")
    gains, values, phases = (
        [tuple(line.get_xydata()[0]) for line in panel.lines if line.get_marker() in "o^v"]
        for panel in panels
    )
    (crossover, unity), (_, high), (_, low) = gains
    # of roots by brentq, whose tolerance is 2e-12 rad/s
    assert unity == pytest.approx(0.0, abs=1e-9)
    assert high == pytest.approx(-20.0 * math.log10(known.high_gain), abs=1e-9)
    assert low == pytest.approx(-20.0 * math.log10(known.low_gain), abs=1e-9)
    # a phase in radians is frequency times delay; the line is interpolated between 2,000 frequencies
    margin = math.degrees(crossover * known.delay)
    assert [angle for _, angle in phases] == pytest.approx([margin - 180.0, -180.0, -180.0], abs=0.01)
    assert complex(*values[0]) == pytest.approx(-np.exp(1j * math.radians(margin)), abs=1e-9)
    assert complex(*values[1]) == pytest.approx(-1.0 / known.high_gain, abs=1e-9)


def test_an_unstable_loop_and_one_without_gain_margins_are_drawn_without_their_marks() -> None:
    for gain, marks in ((-1.0, 1), (4.0, 2)):  # with the critical point
        (legend,) = margins_figure("a loop", "ideal", integrator(gain)).legends
        assert len(legend.get_texts()) == marks
