"""Shipped results keep their numbers: a digest of the bytes of each, and numbers where bytes may differ.

`SAME_RESULTS=write pytest -n 0 tests/orchestration/test_same_results.py` writes `same_results.json` anew; a
change that needs this is listed in the changelog with its reason.
"""

import hashlib
import inspect
import json
import math
import os
import platform
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import tomli_w

from orchestration import Recording
from orchestration.scenarios import scenario
from orchestration.studies.score.protocol import read_protocol
from tests.shared_builds import slow_but

FILE = Path(__file__).with_name("same_results.json")
C_LIBRARY = " ".join(platform.libc_ver())
# Sines and logarithms of another C library differ in the last bit, which rounding in the sensor may enlarge
# to a step of its resolution: of the numbers of a whole run, 1e-3 is left by that.
OTHER_LIBRARY = 1e-3
# The sines of one C library differ in the last bit with and without fused multiply-add (FMA). A loop that is
# not rounded by a sensor keeps the difference small: 1.9e-11 in a recording, 2e-12 of a total variation.
OTHER_SINES = 1e-10
# Another processor adds and rounds in another order: lags, which Fourier transforms give, differ by 3e-16 of
# their value, numbers of a score by 3e-14.
OTHER_PROCESSOR = 1e-12
LAG = re.compile(r"(^|\.)lag(\.|$)")
TIMED = "microseconds"

Values = Mapping[str, np.ndarray]


def processor() -> str:
    """Returns a digest of model and features of the processor, by which libraries choose functions."""
    path = Path("/proc/cpuinfo")
    text = path.read_text() if path.exists() else platform.processor()
    told = {*re.findall(r"^(?:model name|flags)\s*:.*$", text, re.MULTILINE)} or {text}
    return hashlib.sha256("".join(sorted(told)).encode()).hexdigest()[:16]


def sines() -> str:
    """Returns a digest of results of functions that the C library chooses by processor and settings.

    A processor may have FMA that a setting of this process switches off.
    """
    functions = math.sin, math.cos, math.tan, math.atan, math.exp, math.log, math.tanh
    results = [function(0.37 + 0.0173 * i) for function in functions for i in range(4000)]
    return hashlib.sha256(np.array(results, "<f8").tobytes()).hexdigest()[:16]


def tolerance(document: Mapping[str, Any], here: Mapping[str, Any]) -> float:
    """Returns the relative tolerance of results that were stored elsewhere; 0.0 if bytes are compared."""
    if document["c_library"] != here["c_library"]:
        return OTHER_LIBRARY
    if document["sines"] != here["sines"]:
        return OTHER_SINES
    return OTHER_PROCESSOR if document["processor"] != here["processor"] else 0.0


def entry(values: Values) -> dict[str, Any]:
    """Returns the digest of named arrays but lags, and the root mean square of each."""
    digest = hashlib.sha256()
    for name, array in values.items():
        if not LAG.search(name):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    rms = {name: float(np.sqrt(np.mean(np.square(array)))) for name, array in values.items()}
    return {"sha256": digest.hexdigest(), "rms": rms}


def numbers_of(document: object, where: str = "") -> Iterator[tuple[str, float]]:
    """Yields the path and value of every number of a JSON document, but what is timed."""
    if isinstance(document, dict):
        for key, value in document.items():
            if key != TIMED:
                yield from numbers_of(value, f"{where}.{key}" if where else key)
    elif isinstance(document, list):
        for i, value in enumerate(document):
            yield from numbers_of(value, f"{where}[{i}]")
    elif isinstance(document, (int, float)) and not isinstance(document, bool):
        yield where, float(document)


def values_of(document: object) -> Values:
    """Returns each of these numbers as an array."""
    return {name: np.array([value]) for name, value in numbers_of(document)}


Check = Callable[[str, Values], None]
Command = Callable[..., object]


@pytest.fixture
def is_same() -> Check:
    """Asserts that results are those of the file, or writes them there."""

    def check(name: str, values: Values) -> None:
        now = entry(values)
        document = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
        here = {"c_library": C_LIBRARY, "processor": processor(), "sines": sines()}
        if os.environ.get("SAME_RESULTS") == "write":
            results = document.get("results", {}) | {name: now}
            document = {**here, "results": dict(sorted(results.items()))}
            FILE.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
            return
        expected = document["results"][name]
        if rel := tolerance(document, here):
            assert now["rms"] == pytest.approx(expected["rms"], rel=rel, nan_ok=True)
            return
        for metric in filter(LAG.search, values):
            lag = pytest.approx(expected["rms"][metric], rel=OTHER_PROCESSOR, abs=0.0)
            assert now["rms"][metric] == lag
            expected["rms"][metric] = now["rms"][metric]
        assert now == expected

    return check


@pytest.mark.skipif(not C_LIBRARY.startswith("glibc"), reason="the setting is one of this C library")
def test_sines_without_fma_are_noticed_on_a_processor_that_has_it() -> None:
    """Also where the processor has none: then there are the same sines with the setting and without it."""
    code = f"import hashlib, math\nimport numpy as np\n{inspect.getsource(sines)}\nprint(sines())"
    setting = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4"}
    others = subprocess.check_output([sys.executable, "-c", code], env=os.environ | setting, text=True)
    cpu = Path("/proc/cpuinfo").read_text()
    assert (others.strip() != sines()) is (" fma " in cpu and not os.environ.get("GLIBC_TUNABLES"))


@pytest.mark.parametrize("name", [name for name in scenario.shipped() if name != "monte-carlo"])
@pytest.mark.usefixtures("scenario_fmus")
def test_a_shipped_scenario_has_the_same_recording(
    name: str, command: Command, is_same: Check, tmp_path: Path
) -> None:
    command("run", name, "--format", "parquet", "--formats", "none", "--out", tmp_path)
    recording = Recording.read(tmp_path / f"{name}.parquet")
    is_same(name, {"time": recording.time, **{signal: recording[signal] for signal in recording.names}})


@pytest.mark.parametrize("where", slow_but(("vectors", "processor"), ("vectors", "processor", "processes")))
@pytest.mark.usefixtures("scenario_fmus")
def test_a_shipped_sweep_has_the_same_rows_wherever_they_run(
    where: str, command: Command, is_same: Check, tmp_path: Path
) -> None:
    """The first 20 samples: two whole groups of an ensemble, and a group that is not full."""
    path = tmp_path / "first.toml"
    path.write_text('base = "monte-carlo"\n[sweep]\nsamples = 20\n', encoding="utf-8")
    command("sweep", path, "--out", tmp_path, "--where", where)
    rows = pq.read_table(tmp_path / "first.sweep.parquet").drop(["warned", "error"]).to_pydict()
    is_same("monte-carlo", {name: np.array(column, float) for name, column in rows.items()})


def small_protocol(repetitions: int, path: Path) -> Path:
    """Writes a protocol of three cases, one controller and nine plants."""
    data = dict(read_protocol().file.data)
    names = ("nominal", "hold-step", "noise")
    data["cases"] = {name: case for name, case in data["cases"].items() if name in names}
    data["cost"] = {**data["cost"], "cases": ["nominal"]}
    data["controllers"] = {"l1-pi": data["controllers"]["l1-pi"]}
    data["plants"] = {**data["plants"], "count": 9}
    data["repetitions"] = repetitions
    path.write_text(tomli_w.dumps(data), encoding="utf-8")
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "repetitions", "workers"),
    [("score of 8", 8, 1), pytest.param("score", 24, 2, marks=pytest.mark.slow)],
)
@pytest.mark.usefixtures("scenario_fmus")
def test_a_score_has_the_same_numbers(
    name: str, repetitions: int, workers: int, command: Command, is_same: Check, tmp_path: Path
) -> None:
    """Of one group of an ensemble, and of three that two processes share."""
    protocol = small_protocol(repetitions, tmp_path / "small.toml")
    options = ("--full", "--seed", "1", "--protocol", protocol, "--workers", workers, "--out", tmp_path)
    command("score", "PidDepthController", *options)
    is_same(name, values_of(json.loads((tmp_path / "score.json").read_text(encoding="utf-8"))["rows"]))


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.usefixtures("scenario_fmus")
def test_a_tuning_has_the_same_gains_and_costs(
    workers: int, command: Command, is_same: Check, tmp_path: Path
) -> None:
    command("tune", "pid", "--evaluations", "3", "--seeds", "1", "--workers", workers, "--out", tmp_path)
    (path,) = tmp_path.rglob("*.toml")
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    is_same("tune", values_of({"parameters": document["parameters"], "cost": document["tuning"]["cost"]}))


@pytest.mark.usefixtures("scenario_fmus")
def test_the_tables_of_the_paper_have_the_same_numbers(
    command: Command, is_same: Check, tmp_path: Path
) -> None:
    command("reproduce", "--formats", "none", "--out", tmp_path)
    is_same("reproduce", values_of(json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))))
