"""Tests of the indices that `.ci/sensitivity.py` computes from the runs of a score."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orchestration.studies.score.closed_loop import ClosedLoop, tuned
from orchestration.studies.score.protocol import Case, Protocol, read_protocol
from orchestration.studies.vehicle import Vehicle

FOLDER = Path(__file__).parent.parent / ".ci"
sys.path.insert(0, str(FOLDER))
import sensitivity  # noqa: E402  # pyright: ignore[reportMissingImports]

sys.path.pop(0)
SAMPLES = 512


@pytest.fixture
def protocol() -> Protocol:
    """The protocol with three controllers."""
    full = read_protocol(vehicle=Vehicle.of("RovDepthPlant"))
    three = {name: full.controllers[name] for name in ("pid", "adrc", "mrac")}
    return replace(full, tables=full.tables.model_copy(update={"controllers": three}))


def values(cases: list[Case], name: str) -> np.ndarray:
    return np.array([float(case.values[name]) for case in cases])


def test_indices_of_ranks_that_two_numbers_decide(
    protocol: Protocol, monkeypatch: pytest.MonkeyPatch
) -> None:
    """adrc overtakes pid above the median inertia, and mrac is between them or ahead, as the lag decides.

    With a and b independent and fair coins, the ranks (pid, adrc, mrac) are, by a b: 1 3 2 where it is 00,
    3 1 2 where it is 10, 2 3 1 where it is 01, and 3 2 1 where it is 11. The variances are 11/16, 11/16
    and 1/4. With b known, a leaves 10/16, 10/16 and 0 of them; with a known, b leaves 1/8, 1/8 and 1/4.
    """
    numbers = sensitivity.guessed(protocol)
    (inertias, law), (lags, _) = numbers["inertia"], numbers["thruster_lag"]
    half = law.ppf(np.array([0.5]))[0]

    def errors(_: Protocol, cases: list[Case]) -> np.ndarray:
        a, b = values(cases, inertias[0]) > half, values(cases, lags[-1]) > 0.05
        return np.array([np.where(a, 4.0, 2.0), np.where(a, 2.0, 4.0), np.where(b, 1.0, 3.0)])

    monkeypatch.setattr(sensitivity, "errors", errors)
    result = sensitivity.indices(protocol, SAMPLES, 2)
    shares = {name: share["mean"] for name, share in result["indices"].items()}
    variance = 2 * 11 / 16 + 1 / 4
    # of 512 quasi-random vehicles; coins of so many have a standard deviation of 2 %
    assert shares["inertia"] == pytest.approx(2 * 10 / 16 / variance, abs=0.02)
    assert shares["thruster_lag"] == pytest.approx((2 * 1 / 8 + 1 / 4) / variance, abs=0.02)
    assert all(share == 0.0 for name, share in shares.items() if name not in ("inertia", "thruster_lag"))
    assert result["vehicles"] == 2 * SAMPLES * (len(numbers) + 2)
    assert result["all_failed"] == 0.0
    assert [rank["first"] for rank in result["ranks"].values()] == pytest.approx([0.25, 0.25, 0.5], abs=0.02)
    assert [rank["median"] for rank in result["ranks"].values()] == pytest.approx([2.5, 2.5, 1.5], abs=0.51)


def test_a_controller_that_fails_is_not_first(protocol: Protocol, monkeypatch: pytest.MonkeyPatch) -> None:
    """All fail above the median inertia, and pid everywhere."""
    inertias, law = sensitivity.guessed(protocol)["inertia"]
    half = law.ppf(np.array([0.5]))[0]

    def errors(_: Protocol, cases: list[Case]) -> np.ndarray:
        return np.where(values(cases, inertias[0]) > half, math.inf, np.array([[math.inf], [2.0], [1.0]]))

    monkeypatch.setattr(sensitivity, "errors", errors)
    result = sensitivity.indices(protocol, SAMPLES, 1)
    assert result["all_failed"] == pytest.approx(0.5, abs=0.02)
    firsts = {name: rank["first"] for name, rank in result["ranks"].items()}
    assert firsts == {"pid": 0.0, "adrc": 0.0, "mrac": 1.0 - result["all_failed"]}


def test_errors_are_those_of_the_score(protocol: Protocol, scenario_fmus: None) -> None:
    slow = replace(
        protocol.nominal,
        values={**protocol.nominal.values, "plant.thruster_lag[1]": 0.5, "plant.thruster_lag[2]": 0.5},
    )
    result = sensitivity.errors(protocol, [protocol.nominal, slow])
    for row, name in zip(result, protocol.controllers, strict=True):
        with ClosedLoop(tuned(protocol, name), protocol) as loop:
            assert row[0] == loop.metrics(protocol.nominal)["rmse"]
        assert row[1] == math.inf  # five times the delay margin that the gains were tuned to
