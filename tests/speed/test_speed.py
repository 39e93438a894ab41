"""What `python -m tests.speed` makes of what it measures; no time is a pass or a fail."""

import re
from pathlib import Path

import pytest
import typer

from orchestration import OrchestrationError
from tests.speed import __main__ as speed
from tests.speed.__main__ import measured, row_of, spread
from tests.speed.lag import STEP_SIZE
from tests.speed.parts import PARTS, Measure, Rows, check_level, lost
from tests.speed.states import ROOT, State, state
from tests.speed.tables import MACHINE, markdown, read, write


def made_up(folder: Path, sources: Path = ROOT) -> State:
    return State(sources, folder, sources.name)


@pytest.mark.importers
def test_every_importer_does_the_same_work(tmp_path: Path) -> None:
    """The level of each, after so many steps, is checked on the way."""
    (tmp_path / "now").mkdir()
    for measure in PARTS["importers"][1]:
        (values,) = measure.read(made_up(tmp_path / "now"), True).values()
        assert len(values) == 1


def test_a_step_more_or_less_is_noticed() -> None:
    for steps in (1 << 10, 1 << 19):
        check_level("it", steps * STEP_SIZE * 0.1, steps)
        for others in (steps - 1, steps + 1):
            with pytest.raises(OrchestrationError, match=r"it: a level of .* after \d+ steps: expected"):
                check_level("it", others * STEP_SIZE * 0.1, steps)


def test_a_spread_is_the_extremes_of_few_values_and_the_half_in_the_middle_of_many() -> None:
    assert spread([3.0, 1.0, 2.0]) == "2 (1 to 3)"
    assert spread([*range(12), 1e6]) == "6 (3 to 9)"
    assert (spread([1.2345]), spread([1234567.8])) == ("1.23", "1234568")


def test_states_take_turns_after_a_round_that_does_not_count(tmp_path: Path) -> None:
    now, before = made_up(tmp_path), made_up(tmp_path, ROOT / "docs")
    calls = []

    def read(chosen: State, quick: bool) -> Rows:
        calls.append(chosen)
        scale = 1.0 if chosen is now else 4.0
        return {"t": {"a, s -> 2": scale * len(calls), "b": "same" if quick else chosen.revision}}

    rows = measured(Measure(read, 2), [before, now], quick=False)["t"]
    assert calls == [now, before] * 3
    assert rows == [
        ("a, s", "2", "20 (16 to 24)", "4 (3 to 5)", "0.198 (0.188 to 0.208)"),
        ("b", "", "", "", "different"),
    ]
    assert measured(Measure(read), [before, now], quick=True)["t"][1][-1] == "equal bit for bit"
    assert measured(Measure(read, compared=False), [before, now], quick=True)["t"][0][2] == ""


def test_what_an_earlier_state_cannot_do_is_not_measured_there(tmp_path: Path) -> None:
    now, before = made_up(tmp_path), made_up(tmp_path, ROOT / "docs")

    def read(chosen: State, quick: bool) -> Rows:
        if chosen is before:
            raise OrchestrationError("no such command")
        return {"t": {"a, s": 1.0}}

    assert measured(Measure(read, 2), [before, now], quick=False) == {
        "t": [("a, s", "", "", "1 (1 to 1)", "")]
    }
    with pytest.raises(OrchestrationError, match="no such command"):
        measured(Measure(read), [now, before], quick=True)


def test_a_state_that_differs_from_itself_is_an_error() -> None:
    assert row_of("a", ["x", "x"], ["y", "y"])[-1] == "different"
    assert row_of("a", ["x"], ["x"], shared=True)[-1] == "equal bit for bit"
    with pytest.raises(OrchestrationError, match="results of one state differ"):
        row_of("a", ["x"], ["y"], shared=True)


def test_a_table_is_shown_without_columns_that_no_row_fills() -> None:
    table = "|  | goal | now |\n| --- | ---: | ---: |\n| x |  | 1 |\n| y | 2 |  |\n"
    assert markdown([("x", "", "", "1", ""), ("y", "2", "", "", "")]) == table
    assert markdown([("date", "today")]) == "|  |  |\n| --- | ---: |\n| date | today |\n"


def test_the_pages_have_one_place_for_each_table_that_is_measured(tmp_path: Path) -> None:
    pages = (ROOT / "docs" / "performance.md", ROOT / "docs" / "explanation" / "scale.md")
    texts = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    names = [MACHINE, *(table for tables, _ in PARTS.values() for table in tables)]
    assert sorted(re.findall(r"^<!-- speed: (.*) -->$", texts, re.M)) == sorted(names)
    stored = read(ROOT / "docs" / "performance.json")
    assert stored.keys() == set(names)
    assert all(markdown(rows) for rows in stored.values())
    write(copy := tmp_path / "copy.json", stored)
    assert copy.read_bytes() == (ROOT / "docs" / "performance.json").read_bytes()


def test_a_part_that_fails_keeps_its_tables_and_loses_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(chosen: State, quick: bool) -> Rows:
        raise ValueError("no such thing")

    good = Measure(lambda chosen, quick: {"two": {"new, s": 1.0}}, compared=False)
    monkeypatch.setattr(speed, "PARTS", {"bad": (("one",), [Measure(fail)]), "good": (("two",), [good])})
    write(file := tmp_path / "tables.json", {name: [("old", "")] for name in (MACHINE, "one", "two")})
    with pytest.raises(SystemExit, match="failed: bad"):
        speed.main(None, str(ROOT), True, file)
    stored = read(file)
    assert (stored["one"], stored["two"]) == ([["old", ""]], [["new, s", "", "", "1", ""]])
    assert "Python" in {row[0] for row in stored[MACHINE]}
    assert "no such thing" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("parts", "before", "quick", "refused"),
    [
        (["runs"], str(ROOT), False, "--out: expected all parts"),
        (None, None, False, "and --before"),
        (None, str(ROOT), True, "--quick: expected a file outside docs/"),
    ],
)
def test_the_tables_of_the_pages_are_replaced_by_a_whole_measurement_alone(
    parts: list[str] | None, before: str | None, quick: bool, refused: str
) -> None:
    with pytest.raises(typer.BadParameter, match=refused):
        speed.main(parts, before, quick, ROOT / "docs" / "performance.json")


def test_a_state_is_a_clone_or_a_revision(tmp_path: Path) -> None:
    assert state(str(ROOT), tmp_path / "clone").sources == ROOT
    with pytest.raises(OrchestrationError, match=r"no-such-revision: .*: expected a revision or a clone"):
        state("no-such-revision", tmp_path / "none")


def test_what_workers_lose_begins_with_the_last_of_their_first_batches() -> None:
    """One of them loads until 3 s, while the other runs: from there on 6 of 8 s are busy."""
    parts = [[(0.0, 1.0), (1.0, 4.0), (5.0, 7.0)], [(0.0, 3.0), (3.0, 6.0)]]
    assert lost(parts, workers=2) == 1.0 - 6.0 / 8.0
    assert lost(parts, workers=3) == 1.0 - 6.0 / 12.0
