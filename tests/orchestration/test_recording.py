"""A recording survives its file exactly, and a failed write leaves nothing."""

from pathlib import Path

import numpy as np
import pytest

from orchestration.recording import Recording, read_csv, write_whole


def test_csv_is_exact_and_tells_units(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    run = Recording(("a.x", "b.y[1]"), ("m/s", ""), np.arange(5) * 0.1, rng.standard_normal((5, 2)))
    run.write_csv(tmp_path / "run.csv")
    assert (tmp_path / "run.csv").read_text().splitlines()[0] == "time [s],a.x [m/s],b.y[1]"
    back = read_csv(tmp_path / "run.csv")
    assert (back.names, back.units) == (run.names, run.units)
    np.testing.assert_array_equal(back.time, run.time)
    np.testing.assert_array_equal(back.values, run.values)
    assert [path.name for path in tmp_path.iterdir()] == ["run.csv"]


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    path.write_text("old")

    def fail(stream: object) -> None:
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_whole(path, fail)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
