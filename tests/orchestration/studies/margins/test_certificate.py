"""The certificate: against the circle criterion by frequencies, and against simulated nonlinear gains."""

from typing import Any

import numpy as np
import pytest

from orchestration.scenarios import scenario
from orchestration.studies.margins.certificate import (
    Channel,
    Period,
    is_proved,
    largest_sector,
    limit,
    lyapunov_of,
    period,
)
from orchestration.studies.margins.code_loop import CodeLoop, Step, code_loop
from orchestration.studies.margins.margins import NO_CERTIFICATE, judge
from tests.shared_builds import Fmus

VOLTAGES = ("plant.voltage[1]", "plant.voltage[2]")
PLAIN = {"controller.augmentation": "pi", "controller.proportional_gain": 0.0}
WITH_P = {"controller.proportional_gain": 1.0}


@pytest.fixture(scope="module")
def loop() -> CodeLoop:
    """The loop of the paper's extended controller after its long hold."""
    made = code_loop(scenario.load(scenario.find("nominal-extended")), 140.0, VOLTAGES, PLAIN)
    assert made
    return made


def channel_of(loop: CodeLoop, changes: dict[str, float]) -> tuple[list[Step], Channel]:
    before, after = loop.steps(changes, WITH_P | changes)
    return before, Channel.between(before, after, 1.0)


def by_frequencies(whole: Period, gain: float) -> float:
    """The least eigenvalue of 2 I - k (G + G*), with v = -G q, on the unit circle."""
    a, b, c, d = whole
    points = np.exp(1j * np.geomspace(1e-6, np.pi, 3000))[:, np.newaxis, np.newaxis]
    g = c @ np.linalg.solve(points * np.eye(len(a)) - a, -b + 0j) + d
    hermitian = 2.0 * np.eye(len(d)) - gain * (g + g.conj().transpose(0, 2, 1))
    return float(np.linalg.eigvalsh(hermitian).min())


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{}, {"controller.adaptation_gain": 1e5}])
def test_the_proved_sector_is_that_of_the_circle_criterion(loop: CodeLoop, changes: dict[str, float]) -> None:
    """Within 0.5 %, with a Lyapunov function there and frequencies here."""
    steps, channel = channel_of(loop, changes)
    proved, whole = largest_sector(steps, channel), period(steps, [channel])
    assert by_frequencies(whole, proved) > 0.0 > by_frequencies(whole, 1.005 * proved)


def growth(steps: list[Step], channel: Channel, gains: np.ndarray) -> float:
    """Of the largest |v| of an error, from the first quarter of some communication steps to their last."""
    x, errors, count = channel.b[0], list[float](), len(steps)
    for i, gain in enumerate(gains):
        v = float(channel.c[i % count] @ x)
        x = steps[i % count].a @ x - channel.b[i % count] * gain * v
        errors.append(abs(v))
    quarter = len(errors) // 4
    return max(errors[-quarter:]) / max(errors[:quarter])


def changing(rng: np.random.Generator, size: int = 2000) -> np.ndarray:
    """Shares of the largest gain: stretches of random length at one gain, or switched on and off."""
    lengths = rng.integers(1, 60, size)
    levels = np.where(rng.random(size) < 0.7, rng.random(size) < 0.5, rng.random(size))
    return np.repeat(levels, lengths)[:size]


@pytest.mark.slow
def test_a_hundred_random_loops_with_any_gain_in_their_sector_return(loop: CodeLoop) -> None:
    """Designs of random gains, each at the largest sector that is proved for it."""
    rng, count = np.random.default_rng(100), 0
    while count < 100:
        changes = {
            "controller.adaptation_gain": 10.0 ** rng.uniform(1.0, 5.0),
            "controller.filter_bandwidth": 10.0 ** rng.uniform(-1.0, 0.3),
            "controller.rate_feedback_gain": rng.uniform(5.0, 30.0),
            "controller.depth_feedback_gain": rng.uniform(0.5, 8.0),
            "controller.observer_alpha": rng.uniform(0.3, 0.7),
        }
        steps, channel = channel_of(loop, changes)
        proved = largest_sector(steps, channel)
        if proved:
            assert growth(steps, channel, proved * changing(rng)) < 1.0, changes
            count += 1


def test_beyond_the_linear_limit_an_error_grows(loop: CodeLoop) -> None:
    steps, channel = channel_of(loop, {})
    gains = np.full(2000, 1.2 * largest_sector(steps, channel))
    assert growth(steps, channel, gains) > 1.0


def test_rational_numbers_refuse_a_wrong_proof(loop: CodeLoop) -> None:
    steps, channel = channel_of(loop, {})
    whole, ones = period(steps, [channel]), np.ones(len(steps))
    p = lyapunov_of(whole, 60.0 * ones, ones)
    assert p is not None
    assert is_proved(whole, 60.0 * ones, ones, p)
    assert not is_proved(whole, 75.0 * ones, ones, p)
    assert not is_proved(whole, 60.0 * ones, ones, 1.01 * p)
    assert lyapunov_of(whole, 75.0 * ones, ones) is None


def test_a_direction_is_left_out_only_if_nothing_moves_it_and_no_error_sees_it() -> None:
    """An unstable state stays in the period, and is not proved; so does an integrator that q moves."""
    ones = np.array([1.0, 1.0])
    for first in (1.5, 1.0):
        step = Step(np.diag([first, 0.5]), np.zeros((2, 0)), np.zeros((0, 2)))
        channel = Channel([ones], [ones])
        assert len(period([step], [channel]).a) == 2
        assert largest_sector([step], channel) == 0.0
    apart = Channel([np.array([0.0, 1.0])], [np.array([0.0, 1.0])])
    step = Step(np.diag([1.0, 0.5]), np.zeros((2, 0)), np.zeros((0, 2)))
    assert len(period([step], [apart]).a) == 1
    assert largest_sector([step], apart) == pytest.approx(1.5, rel=2e-3)  # x' = 0.5 x - q: 0.5 - k > -1


def test_a_limit_that_is_not_there_is_no_number() -> None:
    """It is found from 0 on where the gain of the scenario is beyond it."""
    assert limit(lambda k: k < 5.0, 3.0) == pytest.approx(5.0, rel=1e-3)
    assert limit(lambda k: k < 5.0, 7.0) == pytest.approx(5.0, rel=1e-3)
    assert limit(lambda k: k == 0.0) == pytest.approx(0.0, abs=1e-6)
    assert limit(lambda k: True) == np.inf
    assert np.isnan(limit(lambda k: False))


def certificate(**parameters: Any) -> dict[str, Any]:
    named = {f"controller.{name}": value for name, value in parameters.items()}
    loaded = scenario.load(scenario.find("nominal-extended"), settings=named)
    metrics = judge(loaded, measured=False, certificate=True).metrics
    return {metric.name: metric for metric in metrics if metric.group == "certificate"}


@pytest.mark.slow
def test_drag_takes_a_little_of_the_sector_and_the_linear_loop_bears_more() -> None:
    proved, with_drag, linear = (metric.value for metric in certificate().values())
    assert 0.95 * proved < with_drag < proved < linear < 1.2 * proved


@pytest.mark.slow
def test_a_nonlinear_p_is_inside_at_its_default_and_not_proved_at_its_least_threshold() -> None:
    """a / delta^(1 - alpha): 1 / 0.1^0.9 and 1 / 0.01^0.9."""
    nonlinear = {"augmentation": "nonlinear_p", "adaptation_gain": 1e5}
    fixed = certificate(**nonlinear)["sector of u_p that is proved"]
    assert fixed.remark == "the scenario has 7.943, inside"
    floor = certificate(**nonlinear, threshold="proportional_to_reference")["sector of u_p that is proved"]
    assert floor.remark == "the scenario has 63.1, not proved"
    large = nonlinear | {"threshold": "proportional_to_reference", "large_error_gain": 2.0}
    assert certificate(**large)["sector of u_p that is proved"].remark == "the scenario has 126.2, not proved"


@pytest.mark.slow
def test_a_loop_without_a_certificate_is_told_so(built: Fmus) -> None:
    assert built["PidDepthController"].is_file()
    loaded = scenario.load(scenario.find("nominal-l1"), {"components": {"controller": "PidDepthController"}})
    assert NO_CERTIFICATE in judge(loaded, measured=False, certificate=True).not_judged
