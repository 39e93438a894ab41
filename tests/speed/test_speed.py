"""What `python -m tests.speed` makes of what it measures; no time is a pass or a fail."""

from pathlib import Path

import pytest
import typer

from orchestration import OrchestrationError
from tests.speed import __main__ as speed
from tests.speed.__main__ import check_places, markdown, measured, replace_tables, row_of, spread
from tests.speed.lag import STEP_SIZE
from tests.speed.parts import PARTS, Measure, Rows, check_level, lost
from tests.speed.states import ROOT, State, state


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


def test_tables_take_the_places_of_those_in_pages(tmp_path: Path) -> None:
    first, second = tmp_path / "first.md", tmp_path / "second.md"
    first.write_text("a\n\n<!-- table: one -->\n\n| old |\n|---|\n| 1 |\n\nb\n")
    second.write_text("<!-- table: two -->\n\nc\n")
    for pages, names in (([first], ["one", "two"]), ([first, second, second], ["one", "two"])):
        with pytest.raises(OrchestrationError, match="two: expected one place in the pages for each table"):
            check_places(pages, names)
    check_places([first, second], ["one", "two"])
    one, two = markdown(("h", "e", "n"), [("x", "", "1"), ("y", "", "")]), markdown(("h",), [("z",)])
    replace_tables([first, second], {"two": two})
    assert "| 1 |" in first.read_text()
    replace_tables([first, second], {"one": one, "two": two})
    table = "| h | n |\n| --- | ---: |\n| x | 1 |\n| y |  |\n"
    assert first.read_text() == f"a\n\n<!-- table: one -->\n\n{table}\nb\n"
    assert second.read_text() == "<!-- table: two -->\n\n| h |\n| --- |\n| z |\n\nc\n"


def test_a_part_that_fails_keeps_its_tables_and_loses_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(chosen: State, quick: bool) -> Rows:
        raise ValueError("no such thing")

    good = Measure(lambda chosen, quick: {"two": {"new, s": 1.0}}, compared=False)
    monkeypatch.setattr(speed, "PARTS", {"bad": (("one",), [Measure(fail)]), "good": (("two",), [good])})
    page = tmp_path / "page.md"
    page.write_text("".join(f"<!-- table: {x} -->\n\n| old |\n\n" for x in ("machine", "one", "two")))
    with pytest.raises(SystemExit, match="failed: bad"):
        speed.main(None, str(ROOT), True, [page])
    _, machine, one, two = page.read_text().split("<!-- ")
    assert one == "table: one -->\n\n| old |\n\n"
    assert two.endswith("| new, s | 1 |\n")
    assert "| Python |" in machine
    assert "no such thing" in capsys.readouterr().err


def test_a_place_that_is_missing_is_noticed_before_anything_is_measured(tmp_path: Path) -> None:
    (page := tmp_path / "page.md").write_text("<!-- table: machine -->\n")
    with pytest.raises(typer.BadParameter, match=r"commands, .*: expected one place"):
        speed.main(None, str(ROOT), False, [page])


def test_a_state_is_a_clone_or_a_revision(tmp_path: Path) -> None:
    assert state(str(ROOT), tmp_path / "clone").sources == ROOT
    with pytest.raises(OrchestrationError, match=r"no-such-revision: .*: expected a revision or a clone"):
        state("no-such-revision", tmp_path / "none")


def test_what_workers_lose_begins_with_the_last_of_their_first_batches() -> None:
    """One of them loads until 3 s, while the other runs: from there on 6 of 8 s are busy."""
    parts = [[(0.0, 1.0), (1.0, 4.0), (5.0, 7.0)], [(0.0, 3.0), (3.0, 6.0)]]
    assert lost(parts, workers=2) == 1.0 - 6.0 / 8.0
    assert lost(parts, workers=3) == 1.0 - 6.0 / 12.0
