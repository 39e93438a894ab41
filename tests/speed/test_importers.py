"""Every importer does the same work in the comparison, and the table says what was measured.

No time is a pass or a fail: machines differ and are noisy.
"""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from fmus.block import NoValues
from orchestration.errors import OrchestrationError
from orchestration.run import Simulator
from tests.speed import importers
from tests.speed import pair as pair_module
from tests.speed.importers import Bare, Entry, compare, entry, measurement_of, table
from tests.speed.loops import LOOPS, Measurement
from tests.speed.pair import LEVEL, STEP_SIZE, Inputs, Pair, State

pytestmark = pytest.mark.importers


AT_ONCE = 0.0  # s: the least number of steps is enough
FLOOR_S = 1e-7


def levels(steps: int, one_after_another: bool = False) -> list[float]:
    """The first level at every communication point, by the equations in Python."""
    first, second = 0.0, 0.0
    measurements_made = [first]
    fast, slow = pair_module.FIRST.parameters(), pair_module.SECOND.parameters()
    for i in range(steps):
        t, before = i * STEP_SIZE, first
        first = pair_module.step(t, STEP_SIZE, State(first), Inputs(second), fast, NoValues()).level
        received = first if one_after_another else before
        second = pair_module.step(t, STEP_SIZE, State(second), Inputs(received), slow, NoValues()).level
        measurements_made.append(first)
    return measurements_made


def test_the_bare_loop_does_what_the_equations_say(bare: Bare) -> None:
    expected = levels(300)
    assert [bare.level(steps) for steps in (1, 2, 300)] == [expected[1], expected[2], expected[300]]


def test_this_master_records_what_the_equations_say(pair: Pair) -> None:
    with Simulator(pair.system) as simulator:
        recording = simulator.run(pair.experiment(300))
    assert recording[f"first.{LEVEL}"].tolist() == levels(300)


@pytest.mark.parametrize("name", LOOPS)
def test_every_importer_ends_where_the_bare_loop_ends(pair: Pair, bare: Bare, name: str) -> None:
    measurement = measurement_of(name, pair, AT_ONCE)
    assert isinstance(measurement, Measurement), measurement
    if name == "pathsim":
        own = levels(2 * measurement.steps + 1, one_after_another=True)
        assert measurement.levels == (own[measurement.steps + 1], own[2 * measurement.steps + 1])
    else:
        assert measurement.levels == (bare.level(measurement.steps), bare.level(2 * measurement.steps))


def test_a_step_more_would_be_noticed(bare: Bare) -> None:
    """Otherwise the test above would prove little."""
    for steps in (1 << 10, 1 << 11, 1 << 18, 1 << 19):
        off = abs(bare.level(steps + 1) / bare.level(steps) - 1.0)
        assert off > 1e3 * importers._CLOSE


def test_who_fails_is_a_row_with_the_reason(pair: Pair, tmp_path: Path) -> None:
    failed = measurement_of("ours", replace(pair, folder=tmp_path))
    assert isinstance(failed, str)
    assert failed.startswith("ended with exit status 1: ")
    assert entry("ours", [failed], float, FLOOR_S) == Entry("this master", problem=failed)


def test_who_does_not_end_is_a_row_with_the_reason(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importers, "_LONGEST_S", 0.01)
    assert measurement_of("ours", pair) == "not done in 0.01 s"


def test_a_fault_of_an_fmu_is_no_measurement(bare: Bare, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importers, "STEP_SIZE", -1.0)
    with pytest.raises(OrchestrationError, match="pair failed with exit status 2"):
        bare.per_step(10)


def made_up(first: float, second: float, scale: float = 1.0) -> Measurement:
    """A measurement of 1000 steps whose level is the number of steps, times `scale`."""
    return Measurement(1000, (first, second), (1000.0 * scale, 2000.0 * scale))


def test_loading_cancels_and_the_median_counts() -> None:
    measurements: list[Measurement | str] = [made_up(5.0, 5.5), made_up(1.0, 1.25), made_up(2.0, 2.375)]
    result = entry("ours", measurements, float, 0.125e-3)
    assert (result.per_step, result.overhead, result.ratio) == (0.375e-3, 0.25e-3, 3.0)
    assert (result.remark, result.problem) == ("records every output", "")


def test_a_time_below_zero_is_a_row_with_the_reason() -> None:
    result = entry("ours", [made_up(2.0, 1.0)], float, FLOOR_S)
    assert result.problem == "N steps took longer than 2 N steps: expected a machine that is less busy"


@pytest.mark.parametrize("scale", [1.1, 0.0, math.nan, math.inf])
def test_who_gives_other_numbers_has_no_time(scale: float) -> None:
    result = entry("ours", [made_up(1.0, 2.0), made_up(1.0, 2.0, scale)], float, FLOOR_S)
    assert "expected other numbers" in result.problem
    assert math.isinf(result.per_step)


def test_who_is_a_little_off_has_a_time_and_a_remark() -> None:
    result = entry("ours", [made_up(1.0, 2.0, 1.001)], float, FLOOR_S)
    assert result.remark == "records every output; its level is off by 1.0e-03 of its value"
    assert result.per_step == 1e-3


def test_the_table_has_the_fastest_first_and_every_reason() -> None:
    entries = [
        Entry("idle", problem="ended"),
        Entry("slow", "2", [30e-7], FLOOR_S, "records nothing"),
        Entry("fast", "1", [2e-7, 1e-7, 3e-7], FLOOR_S, "records every output"),
    ]
    assert table(entries).rows == [
        ("fast 1", "0.200 (0.100 to 0.300)", "0.100", "2.0", "records every output"),
        ("slow 2", "3.000", "2.900", "30.0", "records nothing"),
        ("idle", "", "", "", "ended"),
    ]


def test_a_comparison_has_a_row_for_everyone(monkeypatch: pytest.MonkeyPatch) -> None:
    measurements = []
    monkeypatch.setattr(
        importers, "measurement_of", lambda name, built: measurements.append(name) or made_up(1.0, 2.0)
    )
    monkeypatch.setattr(Bare, "level", lambda self, steps: float(steps))
    entries = compare(2, ["ours", "ecos"])
    assert measurements == ["ours", "ecos"] * 2
    assert [result.name for result in entries] == [importers.FLOOR, "this master", "Ecos"]
    assert all(result.floor == entries[0].per_step > 0.0 for result in entries)


def test_nothing_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    compare(1, ["prebound_ctypes"])
    assert not list(tmp_path.iterdir())
