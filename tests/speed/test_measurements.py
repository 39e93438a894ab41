"""What `python -m tests.speed` measures of our own programs, and what its tables make of it.

No time is a pass or a fail.
"""

from pathlib import Path

import numpy as np
import pytest
import typer

from fmus.build import builder
from orchestration.errors import OrchestrationError
from orchestration.run import Simulator
from tests.speed import __main__ as speed
from tests.speed import scenarios
from tests.speed.cluster import lost
from tests.speed.layers import Layer, layer
from tests.speed.page import check_places, replace_tables
from tests.speed.part import Options, Part, Table, spread
from tests.speed.runs import of_ways
from tests.speed.scenarios import HOST, MASTER, MASTER_LOOP, MONOLITH, PYTHON, Loop, loop
from tests.speed.states import ROOT, State
from tests.speed.steps import of_layers


@pytest.mark.slow
@pytest.mark.parametrize("name", builder.block_names())
def test_a_block_is_measured_both_ways(name: str) -> None:
    """The C program itself checks that both ways end with the same output."""
    measured = layer(name, steps=1000, rounds=1)
    assert measured.block == name
    assert min(measured.through_fmi, measured.bare) > 0.0


@pytest.mark.slow
def test_a_scenario_is_measured_in_every_way() -> None:
    """That the host and the one C program give equal trajectories is checked on the way."""
    measured = loop("nominal-extended", rounds=1)
    assert measured.steps == 15_500
    assert min(min(measured.seconds[way]) for way in (PYTHON, MASTER, HOST, MONOLITH)) > 0.0


def test_programs_that_differ_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Simulator, "run", lambda simulator, experiment: None)  # its time is not looked at
    given = iter([np.zeros(3), np.array([0.0, 0.0, 1e-300])])
    monkeypatch.setattr(scenarios, "read_result", lambda result, plan: next(given))
    with pytest.raises(OrchestrationError, match="differ: expected equal trajectories"):
        loop("example-l1", rounds=1)


def test_the_tables_have_the_ratios() -> None:
    assert of_layers([Layer("Block", 3e-8, 2e-8)]).rows == [("`Block`", "30 ns", "20 ns", "1.50")]
    seconds = {PYTHON: [2.0], MASTER: [8e-3, 7e-3, 9e-3], MASTER_LOOP: [6e-3], HOST: [5e-3], MONOLITH: [4e-3]}
    before = {MASTER: [12e-3], HOST: [10e-3], MONOLITH: [6e-3]}
    rows = [row[1:] for row in of_ways(Loop("scenario", 1000, seconds, before)).rows]
    assert rows == [
        ("2000.00 ms", "400.00", "500.00", "1996000"),
        ("8.00 ms (7.00 to 9.00)", "1.60", "2.00", "4000"),
        ("6.00 ms", "1.20", "1.50", "2000"),
        ("5.00 ms", "1.00", "1.25", "1000"),
        ("4.00 ms", "0.80", "1.00", "0"),
        ("12.00 ms", "1.20", "2.00", "6000"),
        ("10.00 ms", "1.00", "1.67", "4000"),
        ("6.00 ms", "0.60", "1.00", "0"),
    ]


def test_a_spread_is_the_extremes_of_few_values_and_the_half_in_the_middle_of_many() -> None:
    assert spread([3.0, 1.0, 2.0], 1, "s") == "2.0 s (1.0 to 3.0)"
    assert spread([*range(12), 1e6], 0) == "6 (3 to 9)"
    assert spread([1.5]) == "1.50"


def test_tables_take_the_places_of_those_in_pages(tmp_path: Path) -> None:
    first, second = tmp_path / "first.md", tmp_path / "second.md"
    first.write_text("a\n\n<!-- table: one -->\n\n| old |\n|---|\n| 1 |\n\nb\n")
    second.write_text("<!-- table: two -->\n\nc\n")
    one, two = Table("one", ("h", "n"), [("x", "1 s"), ("y", "")]), Table("two", ("h",), [("z",)])
    with pytest.raises(OrchestrationError, match="two: expected one place in the pages for each table"):
        check_places([first], ["one", "two"])
    with pytest.raises(OrchestrationError, match="two: expected one place in the pages for each table"):
        check_places([first, second, second], ["one", "two"])
    check_places([first, second], ["one", "two"])
    replace_tables([first, second], [two])
    assert "| 1 |" in first.read_text()
    replace_tables([first, second], [one, two])
    table = "| h | n |\n| --- | ---: |\n| x | 1 s |\n| y |  |\n"
    assert first.read_text() == f"a\n\n<!-- table: one -->\n\n{table}\nb\n"
    assert second.read_text() == "<!-- table: two -->\n\n| h |\n| --- |\n| z |\n\nc\n"


def test_a_part_that_fails_keeps_its_tables_and_loses_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def failing(options: Options) -> Part:
        raise ValueError("no such thing")

    new = Part([Table("two", ("h",), [("new",)])])
    monkeypatch.setattr(speed, "PARTS", {"bad": (failing, ("one",)), "good": (lambda _: new, ("two",))})
    page = tmp_path / "page.md"
    page.write_text(
        "".join(f"<!-- table: {x} -->\n\n| old |\n\n" for x in ("machine", "goals", "one", "two"))
    )
    with pytest.raises(SystemExit, match="failed: bad"):
        speed.main(None, str(ROOT), False, [page])
    _, machine, goals, one, two = page.read_text().split("<!-- ")
    assert one == "table: one -->\n\n| old |\n\n"
    assert two == "table: two -->\n\n| h |\n| --- |\n| new |\n"
    assert "| Python |" in machine
    assert "| `bad` |" in goals
    assert "no such thing" in capsys.readouterr().err


def test_a_place_that_is_missing_is_noticed_before_anything_is_measured(tmp_path: Path) -> None:
    (page := tmp_path / "page.md").write_text("<!-- table: goals -->\n")
    with pytest.raises(typer.BadParameter, match=r"calls, chains, .*: expected one place"):
        speed.main(None, str(ROOT), False, [page])


def test_a_state_that_differs_from_itself_is_an_error(tmp_path: Path) -> None:
    now, other = State(ROOT, tmp_path, "now"), State(ROOT / "tests", tmp_path, "other")
    assert Options(tmp_path, now, other).equality(False) == "different"
    assert Options(tmp_path, now, now).equality(True) == "equal bit for bit"
    with pytest.raises(OrchestrationError, match="results of one state differ"):
        Options(tmp_path, now, now).equality(False)


def test_what_workers_lose_begins_with_the_last_of_their_first_batches() -> None:
    """One of them loads until 3 s, while the other runs: from there on 6 of 8 s are busy."""
    parts = [[(0.0, 1.0), (1.0, 4.0), (5.0, 7.0)], [(0.0, 3.0), (3.0, 6.0)]]
    assert lost(parts, workers=2) == 1.0 - 6.0 / 8.0
    assert lost(parts, workers=3) == 1.0 - 6.0 / 12.0
