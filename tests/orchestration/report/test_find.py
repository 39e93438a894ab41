"""From paths to results: what is found, what is refused, what they are called."""

import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from markupsafe import escape

from orchestration.errors import OrchestrationError
from orchestration.report.find import found_results
from orchestration.report.render import render
from orchestration.report.result import RunResult, SweepResult
from orchestration.results.recording import Recording
from orchestration.sweep import table

from .made_up import PROVENANCE, SCENARIO, recording, write_run, write_sweep


def names(*paths: Path) -> list[str]:
    return [result.name for result in found_results(paths)]


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_run_is_found_by_either_of_its_files_and_once(ending: str, tmp_path: Path) -> None:
    document = write_run(tmp_path, "dive", ending=ending)
    data = document.with_suffix(f".{ending}")
    (run,) = found_results([document, data, tmp_path, document])
    assert isinstance(run, RunResult)
    assert (run.name, run.title) == ("dive", "A made-up dive")
    assert (run.scenario, run.provenance) == (SCENARIO, PROVENANCE)
    np.testing.assert_array_equal(run.recording.values, recording().values)


def test_a_recording_that_the_document_does_not_name_stands_alone(tmp_path: Path) -> None:
    """What an earlier run in the other format has left must not be shown with this run's scenario."""
    write_run(tmp_path, "dive", ending="parquet")
    recording(phase=0.1).write(tmp_path / "dive.csv")
    (run,) = found_results([tmp_path / "dive.csv"])
    assert isinstance(run, RunResult)
    assert (run.scenario, run.metrics) == ({}, {})
    assert names(tmp_path) == ["dive.csv", "dive.json"]


@pytest.mark.parametrize("ending", ["csv", "parquet"])
@pytest.mark.parametrize("given", ["dive.json", "dive.{ending}", "."])
def test_the_recording_of_another_run_is_refused(given: str, ending: str, tmp_path: Path) -> None:
    """As a run leaves it that was killed between its two files; another result of the folder is right."""
    write_run(tmp_path, "dive", ending=ending)
    write_run(tmp_path, "other")
    last = recording().values[-1, -1]
    recording(phase=1e-15).write(tmp_path / f"dive.{ending}")
    assert Recording.read(tmp_path / f"dive.{ending}").values[-1, -1] == pytest.approx(last, rel=1e-12)
    with pytest.raises(OrchestrationError) as refusal:
        found_results([tmp_path / given.format(ending=ending)])
    assert str(refusal.value).startswith(f"{tmp_path / 'dive.json'}: sha256 = ")
    assert f"of dive.{ending}: it is of another run" in str(refusal.value)
    (tmp_path / "dive.json").unlink()  # as the message says
    assert names(tmp_path) == ["dive", "other"]


def test_the_same_run_in_both_formats_is_one(tmp_path: Path) -> None:
    write_run(tmp_path, "dive", ending="csv")
    write_run(tmp_path, "dive", ending="parquet")
    for ending in ("csv", "parquet"):
        recording(points=3).write(tmp_path / f"alone.{ending}")
    assert names(tmp_path) == ["alone", "dive"]
    alone, dive = found_results([tmp_path])
    assert alone.provenance == dive.provenance == PROVENANCE  # of the files that hold it
    assert names(tmp_path / "alone.csv", tmp_path / "alone.parquet") == ["alone"]


def test_a_folder_gives_its_runs_sweeps_and_recordings_and_nothing_else(tmp_path: Path) -> None:
    write_run(tmp_path, "dive")
    write_sweep(tmp_path, 3)
    recording().write(tmp_path / "failed.partial.csv")
    (tmp_path / "summary.json").write_text("{}")
    (tmp_path / "figure_3.png").touch()
    (tmp_path / "prices.csv").write_text("what,price\nthruster,100\n")
    pq.write_table(pa.table({"x": [1.0]}), tmp_path / "other.parquet")
    assert names(tmp_path) == ["dive", "failed.partial", "monte-carlo.sweep"]
    assert [type(result) for result in found_results([tmp_path])] == [RunResult, RunResult, SweepResult]


def test_equal_names_are_told_apart_by_their_folders(tmp_path: Path) -> None:
    for folder in ("before/x", "after/x", "other"):
        (tmp_path / folder).mkdir(parents=True)
        write_run(tmp_path / folder, "dive")
    paths = [tmp_path / folder / "dive.json" for folder in ("before/x", "after/x", "other")]
    assert names(*paths) == ["before/x/dive", "after/x/dive", "other/dive"]


def test_a_missing_file_offers_the_nearest(tmp_path: Path) -> None:
    write_run(tmp_path, "nominal")
    (tmp_path / "nominal.png").touch()
    with pytest.raises(OrchestrationError, match=r"nearest is 'nominal\.json'"):
        found_results([tmp_path / "nominl.json"])
    with pytest.raises(OrchestrationError, match="known: none"):
        found_results([tmp_path / "no" / "folder.json"])


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("x.png", b"", "expected a result: a .json, .csv or .parquet file"),
        ("x.json", b"", "expected the .json that l1-depth run writes"),
        ("x.json", b"{}", "expected the .json that l1-depth run writes"),
        ("x.json", b"[1]", "expected the .json that l1-depth run writes"),
        ("x.json", b"\xff", "expected the .json that l1-depth run writes"),
        ("x.json", b'{"run": {', "expected the .json that l1-depth run writes"),
        ("x.csv", b"", "expected a first line of titles, got numbers or nothing"),
        ("x.csv", b"0.0,1.0\n", "expected a first line of titles, got numbers or nothing"),
        ("x.csv", b"a,b\n", "expected at least one communication point"),
        ("x.csv", b"a,b\nx,1\n", ":2: expected a number in column 1, got 'x'"),
        ("x.csv", b"a,b\n0,1\n1,2,3\n", ":3: 3 cells: expected 2"),
        ("x.csv", b"a,b,b\n0,1,2\n", ":1: two columns 'b'"),
        ("x.csv", b"a,b\n2,1\n2,2\n1,3\n", ":4: earlier time 1 s after 2 s"),
        ("x.csv", b"a [m],b\n0,1\n", "a: unit 'm': expected s or a unit of its dimension"),
        ("x.csv", b"time [s],a.x\n", "expected at least one communication point"),
        ("x.csv", b"time [s],a.x\n0.0,1.0\n0.0,1.0\n", "expected times that increase"),
        ("x.csv", b"time [s],a.x\nnan,1.0\n", "expected finite times"),
        ("x.parquet", b"", "expected a Parquet file"),
    ],
)
def test_what_is_no_result_is_refused(name: str, content: bytes, complaint: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(OrchestrationError) as refusal:
        found_results([tmp_path / name])
    assert complaint in str(refusal.value)
    assert name in str(refusal.value)


def test_a_log_of_another_program_has_the_units_of_the_runs_beside_it(tmp_path: Path) -> None:
    """A German one: its depth is in cm; a column of texts is left out, an empty cell is no reading."""
    log = tmp_path / "dive.csv"
    log.write_text(
        "Zeit;Tiefe [cm];Strom [mA];Notiz\n"
        "2026-05-04T12:00:00;12,5;300;los\n"
        "2026-05-04T12:00:00.5;;310;\n"
        "2026-05-04T12:00:02;-1;320;Ende\n"
    )
    run, measured = found_results([write_run(tmp_path, "run"), log])
    assert isinstance(run, RunResult)
    assert isinstance(measured, RunResult)
    assert (run.is_measured, measured.is_measured, measured.name) == (False, True, "dive")
    kept = measured.recording
    reason = f"{log}:2: expected a number in column 4, got 'los'"
    assert measured.provenance == {"left_out": {"Notiz": reason}, "fmus": {}}
    assert f"<dt>left out: Notiz</dt><dd>{escape(reason)}</dd>" in render([measured])
    assert (kept.names, kept.units) == (("Tiefe", "Strom"), ("m", "mA"))  # no run has a current
    np.testing.assert_array_equal(kept.time, [0.0, 0.5, 2.0])
    np.testing.assert_array_equal(kept["Tiefe"], [0.125, math.nan, -0.01])
    (alone,) = found_results([log])
    assert isinstance(alone, RunResult)
    assert alone.recording.units == ("cm", "mA")
    assert names(tmp_path) == ["run"]  # in a folder, what l1-depth writes


def test_a_recording_beside_half_a_document_is_refused(tmp_path: Path) -> None:
    document = write_run(tmp_path, "dive")
    document.write_text(document.read_text()[:-40])
    for path in (document.with_suffix(".csv"), document, tmp_path):
        with pytest.raises(OrchestrationError, match=r"dive\.json: .*: expected the \.json that"):
            found_results([path])


def test_a_log_may_jump(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,u\n0,1\n0.5,1\n0.5,-2\n1,3\n")
    (log,) = found_results([tmp_path / "log.csv"])
    assert isinstance(log, RunResult)
    assert log.recording.time.tolist() == [0.0, 0.5, 0.5, 1.0]
    assert log.recording["u"].tolist() == [1.0, 1.0, -2.0, 3.0]


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("sha256", "", r"dive\.json: sha256 = '': .* of an earlier version; run again"),
        *((key, ["no table"], f"{key} = .*: expected a table") for key in ("scenario", "run", "metrics")),
        ("metrics", {"rmse": 4.35}, r"metrics\.rmse = 4\.35: expected a table"),
    ],
)
def test_a_document_with_something_else_in_an_entry_is_refused(
    key: str, value: object, message: str, tmp_path: Path
) -> None:
    """One of an earlier version has no hash, and a metric no unit."""
    document = write_run(tmp_path, "dive")
    content = json.loads(document.read_text()) | {key: value}
    document.write_text(json.dumps({name: entry for name, entry in content.items() if entry != ""}))
    with pytest.raises(OrchestrationError, match=message):
        found_results([tmp_path])


def test_a_run_that_did_not_settle_says_so_on_the_page(tmp_path: Path) -> None:
    document = write_run(tmp_path, "dive", measured={"rmse": 4.35, "settling_time": math.nan})
    assert json.loads(document.read_text())["metrics"]["settling_time"] == {"value": None, "unit": "s"}
    page = render(found_results([document]))
    assert 'data-label="settling_time [s]" data-value="" title="nan">not settled</td>' in page


def test_a_sweep_counts_the_samples_that_settled_and_says_where_none_did(tmp_path: Path) -> None:
    path = write_sweep(tmp_path, 4)
    rows, columns = table.read(path)[0].to_pylist(), table.read(path)[0].schema
    for row in rows:
        row["settling_time"] = math.nan
    rows[1]["rmse"] = math.nan
    table.write((json.dumps(row).encode() for row in rows), columns, path)
    text = render(found_results([path])).replace("<wbr>", "")
    cells = re.sub(r"<[^>]*>", " ", text).split()
    start = cells.index("settling_time", cells.index("largest"))
    assert cells[start : start + 5] == ["settling_time", "s", "0", "not", "settled"]
    start = cells.index("rmse", start)
    assert cells[start : start + 3] == ["rmse", "cm", "3"]


def test_a_document_whose_recording_is_gone_is_refused(tmp_path: Path) -> None:
    document = write_run(tmp_path, "dive")
    (tmp_path / "dive.csv").unlink()
    with pytest.raises(OrchestrationError, match=r"no file .*dive\.csv"):
        found_results([document])


def test_an_empty_folder_and_an_empty_sweep_are_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(OrchestrationError, match="no result in this folder"):
        found_results([tmp_path / "empty"])
    path = write_sweep(tmp_path, 1)
    pq.write_table(pq.read_table(path).slice(0, 0), path)
    with pytest.raises(OrchestrationError, match="expected at least one sample"):
        found_results([path])


def test_equal_results_give_equal_pages(tmp_path: Path) -> None:
    write_run(tmp_path, "dive")
    write_sweep(tmp_path, 20)
    assert render(found_results([tmp_path])) == render(found_results([tmp_path]))


def test_a_page_names_what_is_on_it(tmp_path: Path) -> None:
    run = write_run(tmp_path, "dive")
    sweep = write_sweep(tmp_path, 20)
    bare = Recording(("a.x",), ("m",), np.arange(2.0), np.ones((2, 1)))
    assert "<title>A made-up dive</title>" in render(found_results([run]))
    assert "<title>1 run and 1 sweep</title>" in render(found_results([run, sweep]))
    assert "<title>2 runs</title>" in render([RunResult("a", bare), RunResult("b", bare)])
    assert "<title>For the customer</title>" in render(found_results([run]), "For the customer")


@pytest.mark.slow
def test_each_missing_library_is_one_line_with_the_extra_and_none_of_other_extras_is_needed() -> None:
    """In one process, which imports the report anew for each library that it does not find."""
    needed = ("jinja2", "markupsafe", "pyarrow")
    code = f"""
import sys
sys.modules.update(dict.fromkeys(("dask", "distributed", "elftools", "lxml", "pandas", "xarray")))
for library in {needed!r} + ("none",):
    loaded = {{name: sys.modules.pop(name) for name in list(sys.modules) if name.split(".")[0] == library}}
    sys.modules[library] = None
    try:
        import orchestration.report.find, orchestration.report.render
    except ImportError as error:
        print(error)
    del sys.modules[library]
    sys.modules.update(loaded)
    for name in [name for name in sys.modules if name.startswith("orchestration")]:
        del sys.modules[name]
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "".join(
        f"a report needs {library}: pip install 'l1-depth[report]'\n" for library in needed
    )
