"""A recording survives its file exactly and becomes what others work with; a failed write leaves nothing."""

import base64
import io
import json
import math
import re
import sys
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from orchestration.errors import OrchestrationError
from orchestration.results.files import is_recording, reserved
from orchestration.results.recording import Recording

PROVENANCE = {"fmus": {"plant": {"guid": "1-2"}}, "algorithm": "jacobi", "communication_step_size_s": 0.1}
ENDINGS = pytest.mark.parametrize("ending", ["csv", "parquet"])


def a_run() -> Recording:
    rng = np.random.default_rng(1)
    names = ("a.x", "b.y[1,2]", "odd [name", "odd name]", "odd [name]")
    units = ("m/s", "", "m", "", "")
    return Recording(names, units, np.arange(5) * 0.1, rng.standard_normal((5, 5)), PROVENANCE)


@ENDINGS
def test_a_file_is_exact_and_tells_units(ending: str, tmp_path: Path) -> None:
    run, path = a_run(), tmp_path / f"run.{ending}"
    run.write(path)
    back = Recording.read(path)
    assert (back.names, back.units) == (run.names, run.units)
    np.testing.assert_array_equal(back.time, run.time)
    np.testing.assert_array_equal(back.values, run.values)
    assert back.provenance == (PROVENANCE if ending == "parquet" else {})
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    assert is_recording(path)


def test_the_heading_of_a_csv_is_plain(tmp_path: Path) -> None:
    a_run().write(tmp_path / "run.csv")
    heading = (tmp_path / "run.csv").read_text().splitlines()[0]
    assert heading == 'time [s],a.x [m/s],"b.y[1,2]",odd [name [m],odd name],odd [name] []'


@ENDINGS
@given(values=arrays(np.float64, (3, 2), elements=st.floats(width=64)))
def test_every_double_survives(
    ending: str, tmp_path_factory: pytest.TempPathFactory, values: np.ndarray
) -> None:
    path = tmp_path_factory.mktemp("doubles") / f"run.{ending}"
    Recording(("a.x", "a.y"), ("", ""), np.arange(3.0), values).write(path)
    np.testing.assert_array_equal(Recording.read(path).values, values)  # nan equals nan here
    assert (
        np.array_equal(np.signbit(Recording.read(path).values), np.signbit(values)) or np.isnan(values).any()
    )


@ENDINGS
def test_a_run_of_no_points_or_no_signals_survives(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"run.{ending}"
    Recording(("a.x",), ("m",), np.empty(0), np.empty((0, 1))).write(path)
    assert Recording.read(path).values.shape == (0, 1)
    Recording((), (), np.arange(2.0), np.empty((2, 0))).write(path)
    assert Recording.read(path).values.shape == (2, 0)


def test_other_tools_read_the_parquet(tmp_path: Path) -> None:
    run = a_run()
    run.write(tmp_path / "run.parquet")
    table = pd.read_parquet(tmp_path / "run.parquet")
    assert list(table.columns) == ["time", *run.names]
    np.testing.assert_array_equal(table["a.x"], run["a.x"])


def test_pandas_has_the_time_as_index_and_units_as_attributes() -> None:
    run = a_run()
    table = run.to_pandas()
    assert (table.index.name, tuple(table.columns)) == ("time", run.names)
    np.testing.assert_array_equal(table.index, run.time)
    np.testing.assert_array_equal(table.to_numpy(), run.values)
    assert table.attrs["units"]["a.x"] == "m/s"
    assert table.attrs["provenance"] == PROVENANCE
    table.iloc[0, 0] = math.inf
    assert np.isfinite(run.values).all()  # the table is a copy


def test_xarray_has_a_coordinate_units_and_provenance() -> None:
    run = a_run()
    data = run.to_xarray()
    assert tuple(data.data_vars) == run.names
    assert (data.time.attrs["units"], data["a.x"].attrs["units"]) == ("s", "m/s")
    np.testing.assert_array_equal(data.time, run.time)
    np.testing.assert_array_equal(data["b.y[1,2]"], run["b.y[1,2]"])
    assert json.loads(data.attrs["provenance"]) == PROVENANCE
    data["a.x"][0] = math.inf
    assert np.isfinite(run.values).all()


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("run.csv", b"", "expected 'time [s]' as first column, got []"),
        ("run.csv", b"a,b\n1,2\n", "expected 'time [s]' as first column, got ['a']"),
        ("run.csv", b"time [s],a.x\n0.0,1.0\n0.1,fast\n", "expected a table of numbers"),
        ("run.csv", b"time [s],a.x\n0.0,1.0\n0.1\n", "expected a table of numbers"),
        ("run.csv", b"time [s],a.x\n0.0,1.0,2.0\n", "expected 2 columns, got 3"),
        ("run.csv", b"time [s],\xff\xfe\n", "expected a table of numbers"),
        ("run.parquet", b"PAR1 but no more", "expected a Parquet file"),
        ("run.txt", b"time [s],a.x\n", "expected a file ending in csv or parquet"),
    ],
)
def test_a_file_that_is_no_recording_is_refused(
    name: str, content: bytes, complaint: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(OrchestrationError) as refusal:
        Recording.read(tmp_path / name)
    assert complaint in str(refusal.value)
    assert name in str(refusal.value)


def test_the_parquet_of_something_else_is_refused(tmp_path: Path) -> None:
    pq.write_table(pa.table({"time": [0.0], "a.x": [1.0]}), tmp_path / "other.parquet")
    assert not is_recording(tmp_path / "other.parquet")
    with pytest.raises(OrchestrationError, match="expected a recording"):
        Recording.read(tmp_path / "other.parquet")


def test_a_missing_file_offers_the_nearest(tmp_path: Path) -> None:
    a_run().write(tmp_path / "nominal.csv")
    (tmp_path / "nominal.png").touch()
    with pytest.raises(OrchestrationError, match=r"nearest is 'nominal\.csv'"):
        Recording.read(tmp_path / "nominl.csv")


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """The kernel refuses larger files, as a full disk does. No compiled module is written, and cut off."""
    import resource  # which Windows lacks

    before, writes = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    sys.dont_write_bytecode = True
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = writes


@ENDINGS
def test_a_run_whose_recording_has_no_room_is_refused_before_it_begins(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"run.{ending}"
    with largest_file(1_000_000):
        with reserved(path, (1000, 4)):
            links = [link for link in Path("/proc/self/fd").iterdir() if link.exists()]
            (placeholder,) = [link for link in links if str(tmp_path) in str(link.readlink())]
            assert placeholder.stat().st_size >= 1000 * 5 * 8
            assert not list(tmp_path.iterdir())  # and nothing is left, whatever ends the process
        with pytest.raises(OrchestrationError, match=f"run.{ending}: the recording needs about"):
            reserved(path, (100_000, 4)).__enter__()
    with pytest.raises(OrchestrationError, match=r"needs about 4e\+13 MB|needs about 1e\+14 MB"):
        reserved(path, (10**18, 4)).__enter__()
    assert not list(tmp_path.iterdir())


def test_a_csv_is_written_in_blocks(tmp_path: Path) -> None:
    """All rows at once would take some 40 bytes a value, 4 MB."""
    run = Recording(tuple("abcd"), ("",) * 4, np.arange(20_000.0), np.full((20_000, 4), 1.0 / 3.0))
    tracemalloc.start()
    run.write(tmp_path / "run.csv")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1_000_000
    np.testing.assert_array_equal(Recording.read(tmp_path / "run.csv").values, run.values)


def test_a_parquet_is_written_in_groups_and_is_exact(tmp_path: Path) -> None:
    """A group is what is copied at a time."""
    count = 280_000
    values = np.random.default_rng(1).standard_normal((count, 2))
    Recording(("a", "b"), ("", ""), np.arange(count) * 0.1, values).write(tmp_path / "run.parquet")
    metadata = pq.read_metadata(tmp_path / "run.parquet")
    rows = [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)]
    assert (sum(rows), max(rows)) == (count, rows[0])
    assert max(rows) < count / 2
    assert np.array_equal(Recording.read(tmp_path / "run.parquet").values, values)


def test_a_value_that_is_held_is_written_as_any_other(tmp_path: Path) -> None:
    """And zeros of either sign are two values."""
    held = np.repeat([0.1, 0.0, -0.0, 1e22, 5e-324, 0.1], 3)
    run = Recording(("held",), ("",), np.arange(float(len(held))), held[:, None])
    run.write(tmp_path / "run.csv")
    lines = (tmp_path / "run.csv").read_text().splitlines()[1:]
    assert lines == [
        f"{time!r},{value!r}" for time, value in zip(run.time.tolist(), held.tolist(), strict=True)
    ]


def test_numbers_of_every_size_are_written_as_python_writes_them(tmp_path: Path) -> None:
    """Where the exponent begins, beside powers of two and ten, and what is no number."""
    powers = np.concatenate(
        [10.0 ** np.arange(-7, 19), 3.0 * 10.0 ** np.arange(14, 18), 2.0 ** np.arange(-20, 60)]
    )
    drawn = np.random.default_rng(5)
    sizes = drawn.standard_normal(2000) * 10.0 ** drawn.integers(-8, 20, 2000)
    numbers = np.concatenate([powers, np.nextafter(powers, 0.0), np.nextafter(powers, np.inf), sizes])
    numbers = np.concatenate([numbers, -numbers, [np.nan, np.inf, -np.inf, 5e-324, 1.7976931348623157e308]])
    run = Recording(("value",), ("",), np.arange(float(len(numbers))), numbers[:, None])
    run.write(tmp_path / "run.csv")
    written = [line.split(",")[1] for line in (tmp_path / "run.csv").read_text().splitlines()[1:]]
    assert written == [repr(number) for number in numbers.tolist()]


def test_an_unknown_signal_offers_the_nearest() -> None:
    with pytest.raises(OrchestrationError, match=r"nearest is 'a\.x'"):
        a_run()["a.z"]
    with pytest.raises(OrchestrationError, match=r"nearest is 'a\.x\[1\]'"):
        recording().unit("a.y[1]")
    assert recording().unit("a.x[1]") == "m/s"


def test_a_recording_is_a_collection_of_its_signals() -> None:
    run = a_run()
    assert [key in run for key in ("a.x", "time", "a.z", 0)] == [True, True, False, False]
    assert tuple(run) == run.names
    assert len(run) == 5
    assert run.keys() == tuple(run)


def recording(count: int = 2, points: int = 3) -> Recording:
    names = tuple(f"a.x[{i}]" for i in range(count))
    values = np.outer(np.arange(points) - 1.0, np.arange(count) + 1.0)
    return Recording(names, ("m/s",) * count, 0.25 * np.arange(points), values)


def test_text_tells_the_span_and_each_signal() -> None:
    assert repr(recording()).splitlines() == [
        "Recording of 2 signals at 3 points, 0..0.5 s",
        "  signal  unit  least  largest  last",
        "  a.x[0]  m/s   -1     1        1",
        "  a.x[1]  m/s   -2     2        2",
    ]


def test_text_shows_what_is_not_finite_counts_many_signals_and_needs_no_points() -> None:
    run = recording(1)
    run.values[1, 0] = np.nan
    assert repr(run).splitlines()[-1].split() == ["a.x[0]", "m/s", "nan", "nan", "1"]
    assert repr(recording(32)).splitlines()[-1] == "and 2 more signals"
    assert repr(recording(31)).splitlines()[-1].split()[0] == "a.x[30]"  # a number would hide one alone
    assert repr(recording(1, 0)).splitlines()[0] == "Recording of 1 signal at 0 points"
    assert recording(1, 0)._repr_html_()


def test_a_notebook_shows_the_same() -> None:
    run = Recording(("a.<b>",), ("m",), np.array([0.0]), np.array([[7.5]]))
    shown = run._repr_html_()
    assert shown.startswith("<pre>Recording of 1 signal at 1 point")
    assert "a.&lt;b&gt;" in shown
    assert "<img" not in shown  # a single point is no curve


def test_a_notebook_shows_a_small_picture_below_the_text() -> None:
    shown = recording(8)._repr_html_()
    picture = re.search(r'src="data:image/png;base64,([^"]+)"', shown)
    assert picture
    with Image.open(io.BytesIO(base64.b64decode(picture[1]))) as image:
        assert 400 < image.width < 1000
    assert len(shown) < 100_000
