"""The comparison: whom it has, with which gains, and its tables."""

from collections.abc import Callable
from pathlib import Path

import pytest

from orchestration.studies.score import closed_loop, score, score_tables
from orchestration.studies.score.protocol import Protocol, read_protocol
from orchestration.studies.score.score import part
from orchestration.studies.score.score_document import CaseResult, Row, Score, protocol_info

GAINS = """
[parameters."controller.augmentation"]
value = "pi"
[parameters."controller.proportional_gain"]
value = 12.5
"""


@pytest.fixture
def small(small_protocol: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Protocol:
    """A protocol of two cases and one controller, which is tuned."""
    (tmp_path / "l1-pi.toml").write_text(GAINS)
    monkeypatch.setattr(closed_loop, "GAINS", tmp_path)
    return read_protocol(small_protocol())


def test_every_controller_stands_twice_tuned_and_as_it_comes(small: Protocol) -> None:
    tuned, start = score.controllers(small)
    assert (tuned.name, start.name) == ("tuned/l1-pi", "start/l1-pi")
    assert start.parameters == {"augmentation": "pi"}
    assert tuned.parameters == {"augmentation": "pi", "proportional_gain": 12.5}
    assert score.run_count(1, small, full=True) == 2 * (2 + 3 + 2 * 2)


@pytest.mark.slow
def test_the_comparison_is_a_score_of_both(small: Protocol) -> None:
    document = score.compare(small, workers=1).document
    assert [row.name for row in document.rows] == ["tuned/l1-pi", "start/l1-pi"]
    assert [row.name for row in document.scored] == ["tuned/l1-pi"]
    tuned, start = (row.cases["nominal"].metrics["rmse"] for row in document.rows)
    assert tuned < 0.5 * start  # three times the gain


def test_tuned_gains_run_at_the_step_that_they_were_tuned_at(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(closed_loop, "GAINS", tmp_path)
    assert closed_loop.tuned(protocol, "l1-pi").step == 0.0  # that of the protocol's base
    (tmp_path / "l1-pi.toml").write_text(f"[tuning]\nstep = 0.005\n{GAINS}")
    tuned = closed_loop.tuned(protocol, "l1-pi")
    assert (tuned.step, tuned.parameters["proportional_gain"]) == (0.005, 12.5)
    with closed_loop.ClosedLoop(tuned, protocol) as loop:
        assert loop.experiment(protocol.nominal).step_size == 0.005


def test_tuned_gains_are_in_the_units_that_their_file_states(
    protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(closed_loop, "GAINS", tmp_path)
    bandwidth = '[parameters."controller.filter_bandwidth"]\nvalue = 0.5\nunit = "rad/ms"\n'
    (tmp_path / "l1-pi.toml").write_text(f"{GAINS}{bandwidth}")
    assert closed_loop.tuned(protocol, "l1-pi").parameters["filter_bandwidth"] == 500.0


def test_the_step_is_a_column_without_a_best_where_rows_have_one(protocol: Protocol) -> None:
    document = made_up(protocol, a=1.25, b=2.5)
    titles = [column.title for column in score_tables.overview(document).columns]
    assert "Run step" not in titles
    for row, step in zip(document.rows, (0.02, 0.005), strict=True):
        row.step = step
    table = score_tables.overview(document)
    assert table.columns[-1].title == "Run step"
    assert [(cells[-1].text, cells[-1].is_best) for cells in table.cells] == [("20", False), ("5", False)]


def made_up(protocol: Protocol, **errors: float) -> Score:
    """Rows with that error in the nominal case."""
    rows = [
        Row(
            name=f"tuned/{name}",
            title=name,
            connected=["depth_reference"],
            scored=False,
            fmu={},
            delay_margin=0.1,
            cases={"nominal": CaseResult(metrics={"rmse": error}, failed=["late"] if error > 5 else [])},
        )
        for name, error in errors.items()
    ]
    return Score(made_by="a test", protocol=protocol_info(protocol), rows=rows)


def test_a_table_marks_the_best_and_what_failed(protocol: Protocol) -> None:
    document = made_up(protocol, a=1.25, b=2.5, c=7.0)
    table = score_tables.of_metric(part(document, "tuned"), "rmse")
    cells = [row[0] for row in table.cells]
    assert [(cell.text, cell.is_best) for cell in cells] == [("1.25", True), ("2.5", False), ("7", False)]
    assert [cell.failed for cell in cells] == [(), (), ("late",)]
    assert not part(document, "start").rows


def test_the_summary_has_points_of_the_profile_in_place_of_a_mean_over_cases(protocol: Protocol) -> None:
    """Of cases that are not tuned on and repeat none; a failed run is within no factor of the best.

    A mean of these errors would rank b first, by the one case whose errors are large.
    """
    document = made_up(protocol, a=1.0, b=1.05, c=1.0, d=0.1)
    errors = {
        "hold-sine": (3.0, 3.2, 3.0, 0.1),
        "hold-waves": (9.0, 5.0, 4.0, 0.1),
        "frozen": (1.0, 2.0, 9.9, 0.1),
        "noise": (9.0, 1.0, 1.0, 1.0),  # it repeats the nominal case
        "nominal": (9.0, 1.0, 1.0, 1.0),  # tuned on
    }
    infos = document.protocol.cases
    document.protocol.cases = {name: infos[name] for name in errors}
    for number, row in enumerate(document.rows):
        row.cases = {name: CaseResult(metrics={"rmse": values[number]}) for name, values in errors.items()}
    document.rows[2].cases["hold-waves"].failed = ["not settled"]
    document.rows[3].unranked = ["its run, repeated, gives other values"]
    table = score_tables.overview(document)
    titles = [column.title for column in table.columns]
    near, wide = (titles.index(f"RMSE up to {factor} x best") for factor in ("1.1", "2"))
    thirds = [100.0 / 3.0 * count for count in range(4)]
    assert [row[near].value for row in table.cells] == pytest.approx([thirds[2], thirds[2], thirds[1], 100.0])
    assert [row[wide].value for row in table.cells] == pytest.approx([100.0, 100.0, thirds[1], 100.0])
    assert [row[near].is_best for row in table.cells] == [True, True, False, False]


def test_a_controller_that_fails_the_nominal_case_has_no_best_delay_margin(protocol: Protocol) -> None:
    """A vehicle that rests at the surface is quiet with any delay."""
    document = made_up(protocol, a=1.25, b=2.5, c=7.0)
    for row, margin in zip(document.rows, (0.1, 0.2, 0.6), strict=True):
        row.delay_margin = margin
    nominal = score_tables.of_case(document, "nominal")
    for table in (score_tables.overview(document), nominal):
        column = [column.title for column in table.columns].index("Delay margin")
        cells = [row[column] for row in table.cells]
        assert [cell.text for cell in cells] == ["0.1", "0.2", "0.6"]
        assert [cell.is_best for cell in cells] == [False, True, False]
        assert cells[2].failed == ("late",)
