"""An FMU is unpacked and loaded within limits, in any thread, and changes nothing outside its own folder."""

import re
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import fmpy
import numpy as np
import pytest

from fmus import files
from fmus.files import extract_archive, write_archive
from fmus.fmi.description import describe
from fmus.fmi.instance import FmuInstance
from fmus.platforms import SHARED_LIBRARY_SUFFIX, SYSTEM_PLATFORM
from orchestration.errors import FmuLoadError
from orchestration.run import simulate
from orchestration.system.system import System
from tests.described_fmus import members, redescribed
from tests.orchestration.linear_systems import coupled
from tests.shared_builds import Build


def identified(fmu: Path, path: Path, identifier: str) -> Path:
    """A copy of an FMU with another modelIdentifier."""
    stated = f'modelIdentifier="{identifier}"'
    return redescribed(fmu, path, lambda text: re.sub('modelIdentifier="[^"]*"', stated, text))


@pytest.mark.slow
@pytest.mark.parametrize(("threads", "runs"), [(2, 40), (8, 1000)])
def test_runs_in_threads_neither_fail_nor_change_the_folder(
    linear: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: int, runs: int
) -> None:
    """Each writes a file by a relative path while the others load."""
    monkeypatch.chdir(tmp_path)
    system = coupled(linear)
    expected = simulate(system, stop_time=0.1, step_size=0.01).values

    def run(number: int) -> bool:
        values = simulate(system, stop_time=0.1, step_size=0.01).values
        Path(f"{number}.txt").write_text("done")
        return np.array_equal(values, expected)

    with ThreadPoolExecutor(threads) as pool:
        assert all(pool.map(run, range(runs)))
    assert len(list(tmp_path.glob("*.txt"))) == runs


def test_a_library_that_lacks_functions_is_refused(linear: Build, tmp_path: Path) -> None:
    """Here it is FMPy's logger."""
    logger = Path(fmpy.__file__).parent / "logging" / fmpy.platform / f"logging{fmpy.sharedLibraryExtension}"
    (library,) = [name for name in members(linear()) if name.endswith(fmpy.sharedLibraryExtension)]
    write_archive(tmp_path / "no.fmu", members(linear()) | {library: logger.read_bytes()})
    with pytest.raises(FmuLoadError, match=r"lacks fmi2GetTypesPlatform, .*: expected every function of FMI"):
        FmuInstance("one", tmp_path / "no.fmu", describe(linear()))


@pytest.mark.parametrize("identifier", ["../../evil", "/tmp/evil", r"..\\\\evil", "c:evil", "..", ""])
def test_a_model_identifier_that_leads_out_of_the_archive_is_refused(
    linear: Build, tmp_path: Path, identifier: str
) -> None:
    fmu = identified(linear(), tmp_path / "evil.fmu", identifier)
    with pytest.raises(FmuLoadError, match=r"evil.fmu: modelIdentifier '.*': expected a C identifier"):
        simulate(System({"one": fmu}), inputs={"one.u[1]": 0.0}, stop_time=1.0)


@pytest.mark.parametrize("identifier", ["my-model", "1st", "a.b", "Größe 1"])
def test_a_model_identifier_that_is_no_c_identifier_runs(
    linear: Build, tmp_path: Path, identifier: str
) -> None:
    fmu = identified(linear(), tmp_path / "odd.fmu", identifier)
    library = f"binaries/{SYSTEM_PLATFORM}/linear{SHARED_LIBRARY_SUFFIX}"
    expected = f"for {SYSTEM_PLATFORM} called {identifier}, its modelIdentifier: it has {library}"
    with pytest.raises(FmuLoadError, match=expected):
        simulate(System({"one": fmu}), inputs={"one.u[1]": 0.0}, stop_time=1.0)
    other = library.replace("linear", identifier)
    named = {name.replace(library, other): data for name, data in members(fmu).items()}
    write_archive(tmp_path / "named.fmu", named)
    run = {"inputs": {"one.u[1]": 0.0}, "stop_time": 1.0, "step_size": 0.1}
    expected = simulate(System({"one": linear()}), **run)
    assert np.array_equal(simulate(System({"one": tmp_path / "named.fmu"}), **run).values, expected.values)


@pytest.mark.parametrize(
    ("limit", "complaint"),
    [
        ("_MOST_MEMBERS", "3 files: expected at most 2"),
        ("_MOST_BYTES", "3000 bytes unpacked: expected at most 2"),
    ],
)
def test_an_archive_of_too_many_or_too_large_files_is_not_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, complaint: str
) -> None:
    with zipfile.ZipFile(tmp_path / "large.fmu", "w") as archive:
        for name in "abc":
            archive.writestr(name, bytes(1000))
    monkeypatch.setattr(files, limit, 2)
    with pytest.raises(ValueError, match=complaint):
        extract_archive(tmp_path / "large.fmu", tmp_path / "folder")
    assert not (tmp_path / "folder").exists()


def test_an_archive_that_swells_is_not_unpacked(linear: Build, tmp_path: Path) -> None:
    """200 MB of zeros in 200 kB; a run that is given it names it."""
    fmu = tmp_path / "bomb.fmu"
    fmu.write_bytes(linear().read_bytes())
    with (
        zipfile.ZipFile(fmu, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("resources/zeros", "w") as stream,
    ):
        for _ in range(200):
            stream.write(bytes(1_000_000))
    with pytest.raises(FmuLoadError, match=r"bomb.fmu .*expected at most 200 times as many"):
        simulate(System({"one": fmu}), inputs={"one.u[1]": 0.0}, stop_time=1.0)
