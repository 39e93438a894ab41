"""What a sweep leaves behind: parts while it runs, one table at the end, and no rows of two sweeps in it."""

import importlib.util
import json
import math
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from orchestration.errors import SweepError
from orchestration.scenarios import scenario
from orchestration.sweep import table
from orchestration.sweep.plan import Plan, plan
from orchestration.sweep.run import Store
from orchestration.sweep.table import failed, statistics, summary_table

Make = Callable[..., Plan]
GRID = '[sweep.vary]\n"r.u" = { values = [0, 1, 2, 3, 4] }\n"r.misdeed" = { values = ["none"] }\n'


def store(made: Plan, folder: Path, recorded: tuple[str, ...] | None = None) -> Store:
    return Store(folder, table.schema(made, recorded))


def row(made: Plan, sample: int, error: str | None = None) -> dict:
    measured = {} if error else {"mean": 10.0 * sample, "effort": 1.0}
    return {"sample": sample, **made.values(sample), **measured, "error": error}


def add(opened: Store, made: Plan, samples: Iterable[int]) -> None:
    opened.add([row(made, sample) for sample in samples])


def begun(made: Plan, folder: Path, samples: Iterable[int] = ()) -> Store:
    """Returns a store that is open and holds these samples."""
    opened = store(made, folder)
    opened.begin()
    add(opened, made, samples)
    return opened


def test_the_table_is_sorted_and_says_what_its_columns_are(planned: Make, tmp_path: Path) -> None:
    made, out = planned(GRID), tmp_path / "out"
    opened = store(made, out)
    assert opened.begin() == set()
    opened.add([row(made, 4, "the rudder is stuck")])
    add(opened, made, [3, 0, 2, 1])
    opened.finish()
    rows, about = table.read(out / "mine.sweep.parquet")
    assert rows.to_pylist() == [
        {
            "sample": i, "r.u": float(i), "r.misdeed": "none", "mean": 10.0 * i, "effort": 1.0,
            "warned": None, "error": None,
        }
        for i in range(4)
    ] + [
        {
            "sample": 4, "r.u": 4.0, "r.misdeed": "none", "mean": None, "effort": None,
            "warned": None, "error": "the rudder is stuck",
        }
    ]  # fmt: skip
    assert table.names(rows.schema, "varied") == ["r.u", "r.misdeed"]
    assert table.names(rows.schema, "metric") == ["mean", "effort"]
    assert (about["seed"], about["samples"]) == (0, 5)
    assert about["scenario"] == made.scenario.resolved
    assert about["fmus"]["r"]["guid"] == made.checked.descriptions["r"].guid
    assert [path.name for path in out.iterdir()] == ["mine.sweep.parquet"]


def test_other_bytes_of_an_fmu_of_the_same_guid_are_another_sweep(planned: Make, tmp_path: Path) -> None:
    made, changed = planned(GRID), tmp_path / "changed.fmu"
    changed.write_bytes(made.checked.components["r"].read_bytes() + b" ")
    with store(made, tmp_path) as opened:
        opened.begin()
    again = replace(made, checked=replace(made.checked, components={"r": changed}))
    with store(again, tmp_path) as opened, pytest.raises(SweepError, match=r"another sweep \(fmus differ\)"):
        opened.begin()


@pytest.mark.usefixtures("scenario_fmus")
def test_units_stand_in_the_columns(tmp_path: Path) -> None:
    columns = table.schema(plan(scenario.load(scenario.find("monte-carlo"))), None)
    units = {field.name: field.metadata[b"unit"].decode() for field in columns}
    assert units["plant.inertia"] == "kg"
    assert units["settling_time"] == "s"
    assert units["sample"] == units["error"] == ""


def test_parts_in_any_order_give_the_same_bytes(planned: Make, tmp_path: Path) -> None:
    made = planned(GRID)
    written = []
    for name, batches in [("a", [[0, 1, 2, 3, 4]]), ("b", [[4], [1, 0], [3, 2]])]:
        opened = begun(made, tmp_path / name)
        for batch in batches:
            add(opened, made, batch)
        opened.finish()
        written.append(opened.path.read_bytes())
    assert written[0] == written[1]


def test_the_table_of_many_samples_is_written_with_few_in_memory(
    planned: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a group of rows, what is kept is a place in the log for each sample, of 8 bytes."""
    monkeypatch.setattr(table, "ROWS_OF_A_GROUP", 200)
    peaks = []
    for count in (500, 501, 3000):  # the first imports
        made = planned(f'[sweep.vary]\n"r.u" = {{ linspace = [0, 1, {count}] }}\n', name=f"of_{count}")
        opened = begun(made, tmp_path, range(count))
        tracemalloc.start()
        opened.finish()
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert table.read(opened.path)[0]["sample"].to_pylist() == list(range(count))
    assert peaks[2] - peaks[1] < 3 * 8 * 3000  # the places, and what is compared with them


def test_a_table_has_the_bytes_that_arrow_gives_its_rows(tmp_path: Path) -> None:
    """With values of every type, and with gaps or without."""
    rows = [
        {"x": 0.1, "i": 2**53 + 1, "b": True, "s": "Größe", "all": 1.0},
        {"x": None, "i": None, "b": None, "s": None, "all": math.nan},
        {"x": -math.inf, "i": -1, "b": False, "s": "", "all": -0.0},
    ] * 5
    types = {"x": pa.float64(), "i": pa.int64(), "b": pa.bool_(), "s": pa.string(), "all": pa.float64()}
    columns = pa.schema(list(types.items()), {b"kind": b"any"})
    table.write((json.dumps(row).encode() for row in rows), columns, tmp_path / "ours")
    pq.write_table(pa.Table.from_pylist(rows, columns), tmp_path / "arrow")
    assert (tmp_path / "ours").read_bytes() == (tmp_path / "arrow").read_bytes()


@pytest.mark.parametrize(
    ("kind", "value"),
    [(pa.int64(), True), (pa.int64(), 1.5), (pa.float64(), "1.5"), (pa.bool_(), 1), (pa.string(), 1.5)],
)
def test_a_value_of_another_type_is_refused(kind: pa.DataType, value: object, tmp_path: Path) -> None:
    with pytest.raises(pa.ArrowInvalid, match=r"Column\(/x\) changed from|Failed to convert JSON to int64"):
        table.write(
            [b'{"x": null}', json.dumps({"x": value}).encode()], pa.schema([("x", kind)]), tmp_path / "x"
        )
    assert not (tmp_path / "x").exists()


@pytest.mark.slow
def test_a_table_is_written_and_summed_up_without_pandas(planned: Make, tmp_path: Path) -> None:
    """Which takes longer to import than all else of a small sweep."""
    made = planned(GRID)
    opened = begun(made, tmp_path, range(5))
    opened.finish()
    program = "import json, sys; from pathlib import Path; from orchestration.sweep import table\n"
    program += "results, about = table.read(Path(sys.argv[1])); table.summary_table(results, about)\n"
    program += "lines = [json.dumps(row).encode() for row in results.to_pylist()]\n"
    program += "table.write(lines, results.schema, Path(sys.argv[1]))\n"
    program += "print([name for name in ('pandas', 'scipy.stats') if name in sys.modules])"
    assert importlib.util.find_spec("pandas")
    command = [sys.executable, "-c", program, str(tmp_path / "mine.sweep.parquet")]
    assert subprocess.run(command, check=True, capture_output=True, text=True).stdout == "[]\n"


def test_what_is_done_is_found_again(planned: Make, tmp_path: Path) -> None:
    made = planned(GRID)
    begun(made, tmp_path, [1, 3])
    again = store(made, tmp_path)
    assert again.begin() == {1, 3}
    add(again, made, [0, 2, 4])
    again.finish()
    assert store(made, tmp_path).begin() == {0, 1, 2, 3, 4}


@pytest.mark.parametrize("finished", [True, False])
def test_another_sweep_of_the_name_is_refused_until_it_is_discarded(
    planned: Make, tmp_path: Path, finished: bool
) -> None:
    made = planned(GRID)
    first = begun(made, tmp_path)
    first.add([row(made, 0)], [b"recording"])
    add(first, made, range(1, 5))
    if finished:
        first.finish()
    other = store(planned(GRID.replace("4]", "5]")), tmp_path)
    with pytest.raises(SweepError, match=r"mine.* is of another sweep \(scenario differ\)"):
        other.begin()
    with pytest.raises(SweepError, match=r"\(recorded differ\)"):
        store(made, tmp_path, recorded=("r.y",)).begin()
    other.discard()
    assert not [
        path for path in tmp_path.iterdir() if path.name.startswith("mine.") and path.suffix != ".toml"
    ]
    assert other.begin() == set()


def test_recordings_without_a_journal_are_of_another_sweep(planned: Make, tmp_path: Path) -> None:
    """As a sweep leaves them that is killed while it discards its files, or a table that the user removed."""
    made = planned(GRID)
    first = begun(made, tmp_path)
    first.add([row(made, 3)], [b"earlier"])
    assert store(made, tmp_path).begin() == {3}
    assert [path.read_bytes() for path in first.recordings.iterdir()] == [b"earlier"]  # of the row
    (tmp_path / "mine.sweep.jsonl").unlink()
    assert store(made, tmp_path).begin() == set()
    assert not first.recordings.exists()


def test_another_fmu_is_another_sweep_but_another_place_is_not(
    planned: Make, tmp_path: Path, rogue: Callable[..., Path]
) -> None:
    text = planned(GRID) and (tmp_path / "mine.toml").read_text()
    one, copy = tmp_path / "one.fmu", tmp_path / "copy.fmu"
    one.write_bytes(rogue().read_bytes())
    copy.write_bytes(rogue().read_bytes())

    def with_fmu(path: Path) -> Plan:
        (tmp_path / "mine.toml").write_text(text.replace(str(rogue()), str(path)))
        return plan(scenario.load(tmp_path / "mine.toml"))

    store(with_fmu(one), tmp_path).begin()
    assert store(with_fmu(copy), tmp_path).begin() == set()
    with pytest.raises(SweepError, match=r"\(fmus differ\)"):
        store(with_fmu(rogue(saves_state=True)), tmp_path).begin()


def test_the_same_sweep_may_be_written_otherwise_on_the_command_line(planned: Make, tmp_path: Path) -> None:
    made = planned(GRID)
    begun(made, tmp_path, [1, 2])
    again = replace(made, scenario=replace(made.scenario, arguments=("./mine.toml", "--set", "r.u=2.0")))
    assert store(again, tmp_path).begin() == {1, 2}


def test_the_summary_leaves_failed_samples_out(planned: Make, tmp_path: Path) -> None:
    made = planned(GRID)
    opened = begun(made, tmp_path, range(4))
    opened.add([row(made, 4, "the rudder is stuck")])
    opened.finish()
    rows, _ = table.read(opened.path)
    assert failed(rows) == 1
    mean = statistics(rows["mean"].to_numpy())  # of 0, 10, 20, 30
    assert (mean["samples"], mean["mean"], mean["50 %"]) == (4, 15.0, 15.0)
    assert mean["std"] == pytest.approx((500.0 / 3.0) ** 0.5, rel=1e-15)  # rounding of the root


def test_every_text_that_is_varied_has_rows_of_its_own_in_the_summary(planned: Make, tmp_path: Path) -> None:
    made = planned(
        '[sweep.vary]\n"r.u" = { values = [0, 1] }\n"r.misdeed" = { values = ["none", "warning"] }\n'
    )
    opened = begun(made, tmp_path, [0, 2])
    opened.add([{**row(made, sample), "mean": 5.0, "effort": math.nan} for sample in (1, 3)])
    opened.finish()
    columns = {
        column.header: list(column.cells) for column in summary_table(*table.read(opened.path)).columns
    }
    assert columns["r.misdeed"] == ["none", "none", "warning", "warning"]
    assert columns["Metric"] == ["mean", "effort"] * 2
    assert columns["Samples"] == ["2", "2", "2", "0"]
    assert columns["Mean"] == ["10", "1", "5", "not a number"]


def test_a_grid_of_two_numbers_has_a_table_of_each_metric(planned: Make, tmp_path: Path) -> None:
    """The variable with fewer values is across; a failed sample has no number."""
    made = planned(
        '[sweep.vary]\n"r.u" = { values = [1, 2, 3] }\n"experiment.stop_time" = { values = [0.5, 1] }\n'
    )
    opened = begun(made, tmp_path, range(5))
    opened.add([row(made, 5, "the rudder is stuck")])
    opened.finish()
    rows, about = table.read(opened.path)
    mean, effort = table.terminal_tables(rows, about)
    assert "mean" in str(mean.title)
    assert "across: experiment.stop_time" in str(mean.title)
    u, *columns = mean.columns
    assert [u.header, *u.cells] == ["r.u [1]", "1", "2", "3"]
    assert [column.header for column in columns] == ["0.5", "1"]
    cells = {
        (float(str(x)), float(str(column.header))): cell
        for column in columns
        for x, cell in zip(u.cells, column.cells, strict=True)
    }
    given = [made.values(sample) for sample in range(6)]
    expected = {(one["r.u"], one["experiment.stop_time"]): f"{10.0 * i:.4g}" for i, one in enumerate(given)}
    assert cells == expected | {(given[5]["r.u"], given[5]["experiment.stop_time"]): "not a number"}
    assert {cell for column in effort.columns[1:] for cell in column.cells} == {"1", "not a number"}


@pytest.mark.parametrize("values", ['["none", "warning"]', "[0.5]"])
def test_other_sweeps_have_no_table_of_a_grid(planned: Make, tmp_path: Path, values: str) -> None:
    name = "r.misdeed" if "none" in values else "experiment.stop_time"
    made = planned(f'[sweep.vary]\n"r.u" = {{ values = [1, 2] }}\n"{name}" = {{ values = {values} }}\n')
    opened = begun(made, tmp_path, range(made.count))
    opened.finish()
    assert not [*table.grid_tables(*table.read(opened.path))]
    assert len(table.terminal_tables(*table.read(opened.path))) == 1


def test_another_file_is_no_table_of_a_sweep(tmp_path: Path, planned: Make) -> None:
    path = tmp_path / "other.parquet"
    pq.write_table(table.schema(planned(GRID), None).remove_metadata().empty_table(), path)
    for file in (path, tmp_path / "none.parquet", tmp_path / "mine.toml"):
        assert not table.is_sweep(file)
        with pytest.raises(SweepError, match="expected the table of a sweep"):
            table.read(file)


def test_two_sweeps_in_one_folder_are_refused_until_the_first_ends(planned: Make, tmp_path: Path) -> None:
    made = planned(GRID)
    with store(made, tmp_path) as first:
        first.begin()
        with pytest.raises(SweepError, match=r"mine\.sweep\.lock: another process runs this sweep"):
            store(made, tmp_path).__enter__()
    with store(made, tmp_path) as second:
        assert second.begin() == set()
    assert not (tmp_path / "mine.sweep.lock").exists()


def test_rows_that_were_run_twice_are_one_and_a_table_has_all_samples(planned: Make, tmp_path: Path) -> None:
    made = planned(GRID)
    opened = begun(made, tmp_path, [0, 1, 1, 2, 0])
    with pytest.raises(SweepError, match=r"mine\.sweep\.jsonl: 3 rows of 3 samples, expected 5"):
        opened.finish()
    assert not opened.path.exists()
    add(opened, made, [4, 3])
    opened.finish()
    assert table.read(opened.path)[0]["sample"].to_pylist() == [0, 1, 2, 3, 4]


def test_a_table_with_rows_of_two_sweeps_is_refused(planned: Make, tmp_path: Path) -> None:
    made = planned(GRID)
    opened = store(made, tmp_path)
    table.write(
        (json.dumps(row(made, i)).encode() for i in (0, 1, 2, 3, 4, 4)), table.schema(made, None), opened.path
    )
    with pytest.raises(SweepError, match=r"6 rows of 5 samples, expected 5; --restart discards it"):
        opened.begin()


@pytest.mark.parametrize("damage", [b'\n{"sample": 3, "r.u": 3.0, "mean', b"\n\xff\x00", b"\n[1]", b"\n{}"])
def test_a_damaged_line_is_run_again(planned: Make, tmp_path: Path, damage: bytes) -> None:
    made = planned(GRID)
    opened = begun(made, tmp_path, [1, 2])
    (log,) = tmp_path.glob("*.jsonl")
    log.write_bytes(log.read_bytes() + damage)
    assert store(made, tmp_path).begin() == {1, 2}
    add(opened, made, [0, 3, 4])
    assert opened.begin() == {0, 1, 2, 3, 4}


@pytest.mark.parametrize("damage", [b"", b'{"name": "mi', b"\xff", b"3\n"])
def test_a_damaged_first_line_is_named(planned: Make, tmp_path: Path, damage: bytes) -> None:
    made = planned(GRID)
    opened = begun(made, tmp_path)
    (log,) = tmp_path.glob("*.jsonl")
    log.write_bytes(damage)
    with pytest.raises(SweepError, match=r"mine\.sweep\.jsonl: .* damaged; --restart discards it"):
        store(made, tmp_path).begin()
    opened.discard()
    assert opened.begin() == set()


def test_a_damaged_table_is_named(planned: Make, tmp_path: Path) -> None:
    made = planned(GRID)
    opened = begun(made, tmp_path, range(5))
    opened.finish()
    opened.path.write_bytes(opened.path.read_bytes()[:-20])
    with pytest.raises(SweepError, match=r"mine\.sweep\.parquet: expected the table of a sweep"):
        store(made, tmp_path).begin()
