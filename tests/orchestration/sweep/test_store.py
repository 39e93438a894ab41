"""What a sweep leaves behind: parts while it runs, one table at the end, and no rows of two sweeps in it."""

from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from orchestration.errors import SweepError
from orchestration.sweep import table
from orchestration.sweep.plan import Plan
from orchestration.sweep.store import Store
from orchestration.sweep.summary import failed, summary

Make = Callable[..., Plan]
GRID = '[sweep.vary]\n"r.u" = { values = [0, 1, 2, 3, 4] }\n"r.misdeed" = { values = ["none"] }\n'


def store(made: Plan, folder: Path, recorded: tuple[str, ...] | None = None) -> Store:
    return Store(folder, table.schema(made), table.provenance(made, recorded))


def row(made: Plan, sample: int, error: str | None = None) -> dict:
    measured = {} if error else {"mean": 10.0 * sample, "effort": 1.0}
    return {"sample": sample, **made.values(sample), **measured, "error": error}


def test_the_table_is_sorted_and_says_what_its_columns_are(planned: Make, tmp_path: Path) -> None:
    made, out = planned(GRID), tmp_path / "out"
    opened = store(made, out)
    assert opened.begin() == set()
    opened.add([row(made, 3), row(made, 4, "the rudder is stuck")], {})
    opened.add([row(made, 0), row(made, 2), row(made, 1)], {})
    opened.finish()
    found, about = table.read(out / "mine.sweep.parquet")
    assert found.to_pylist() == [
        {"sample": i, "r.u": float(i), "r.misdeed": "none", "mean": 10.0 * i, "effort": 1.0, "error": None}
        for i in range(4)
    ] + [
        {
            "sample": 4, "r.u": 4.0, "r.misdeed": "none", "mean": None, "effort": None,
            "error": "the rudder is stuck",
        }
    ]  # fmt: skip
    assert table.names(found.schema, "varied") == ["r.u", "r.misdeed"]
    assert table.names(found.schema, "metric") == ["mean", "effort"]
    assert (about["seed"], about["samples"]) == (0, 5)
    assert about["scenario"] == made.scenario.resolved
    assert about["fmus"]["r"]["guid"] == made.checked.descriptions["r"].guid
    assert [each.name for each in out.iterdir()] == ["mine.sweep.parquet"]


@pytest.mark.usefixtures("scenario_fmus")
def test_units_stand_in_the_columns(tmp_path: Path) -> None:
    from orchestration.scenarios import scenario
    from orchestration.sweep.plan import plan

    columns = table.schema(plan(scenario.load(scenario.find("monte-carlo"))))
    units = {field.name: field.metadata[b"unit"].decode() for field in columns}
    assert units["plant.inertia"] == "kg"
    assert units["settling_time"] == "s"
    assert units["sample"] == units["error"] == ""


def test_parts_in_any_order_give_the_same_bytes(planned: Make, tmp_path: Path) -> None:
    made = planned(GRID)
    written = []
    for name, batches in [("a", [[0, 1, 2, 3, 4]]), ("b", [[4], [1, 0], [3, 2]])]:
        opened = store(made, tmp_path / name)
        opened.begin()
        for batch in batches:
            opened.add([row(made, sample) for sample in batch], {})
        opened.finish()
        written.append(opened.path.read_bytes())
    assert written[0] == written[1]


def test_what_is_done_is_found_again(planned: Make, tmp_path: Path) -> None:
    made = planned(GRID)
    first = store(made, tmp_path)
    first.begin()
    first.add([row(made, 1), row(made, 3)], {})
    again = store(made, tmp_path)
    assert again.begin() == {1, 3}
    again.add([row(made, sample) for sample in (0, 2, 4)], {})
    again.finish()
    assert store(made, tmp_path).begin() == {0, 1, 2, 3, 4}


@pytest.mark.parametrize("finished", [True, False])
def test_another_sweep_of_the_name_is_refused_until_it_is_discarded(
    planned: Make, tmp_path: Path, finished: bool
) -> None:
    made = planned(GRID)
    first = store(made, tmp_path)
    first.begin()
    first.add([row(made, sample) for sample in range(5)], {0: b"recording"})
    if finished:
        first.finish()
    other = store(planned(GRID.replace("4]", "5]")), tmp_path)
    with pytest.raises(SweepError, match=r"mine.* is of another sweep \(scenario differ\)"):
        other.begin()
    with pytest.raises(SweepError, match=r"\(recorded differ\)"):
        store(made, tmp_path, recorded=("r.y",)).begin()
    other.discard()
    assert not [
        each for each in tmp_path.iterdir() if each.name.startswith("mine.") and each.suffix != ".toml"
    ]
    assert other.begin() == set()


def test_another_fmu_is_another_sweep_but_another_place_is_not(
    planned: Make, tmp_path: Path, rogue: Callable[..., Path]
) -> None:
    text = planned(GRID) and (tmp_path / "mine.toml").read_text()
    one, copy = tmp_path / "one.fmu", tmp_path / "copy.fmu"
    one.write_bytes(rogue().read_bytes())
    copy.write_bytes(rogue().read_bytes())

    def with_fmu(path: Path) -> Plan:
        from orchestration.scenarios import scenario
        from orchestration.sweep.plan import plan

        (tmp_path / "mine.toml").write_text(text.replace(str(rogue()), str(path)))
        return plan(scenario.load(tmp_path / "mine.toml"))

    store(with_fmu(one), tmp_path).begin()
    assert store(with_fmu(copy), tmp_path).begin() == set()
    with pytest.raises(SweepError, match=r"\(fmus differ\)"):
        store(with_fmu(rogue(saves_state=True)), tmp_path).begin()


def test_the_summary_leaves_failed_samples_out(planned: Make, tmp_path: Path) -> None:
    made = planned(GRID)
    opened = store(made, tmp_path)
    opened.begin()
    opened.add([row(made, sample) for sample in range(4)] + [row(made, 4, "the rudder is stuck")], {})
    opened.finish()
    found, _ = table.read(opened.path)
    assert failed(found) == 1
    mean = summary(found)["mean"]  # of 0, 10, 20, 30
    assert (mean["mean"], mean["50 %"]) == (15.0, 15.0)
    assert mean["std"] == pytest.approx((500.0 / 3.0) ** 0.5, rel=1e-15)  # rounding of the root


def test_another_file_is_no_table_of_a_sweep(tmp_path: Path, planned: Make) -> None:
    path = tmp_path / "other.parquet"
    pq.write_table(table.schema(planned(GRID)).empty_table(), path)
    for each in (path, tmp_path / "none.parquet", tmp_path / "mine.toml"):
        assert not table.is_sweep(each)
        with pytest.raises(SweepError, match="expected the table of a sweep"):
            table.read(each)
