"""Instances of one FMU of ours share what cannot differ between them; those of another FMU share nothing."""

import os
import zipfile
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from fmus.files import write_archive
from fmus.fmi import description, instance
from fmus.fmi.description import describe, is_independent
from fmus.fmi.instance import FmuInstance
from fmus.store import is_own_build, record_build
from orchestration.errors import EnsembleError
from orchestration.many.ensemble import Ensemble, check_ensemble
from orchestration.run import Simulator, simulate
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.described_fmus import members

COUNT = 40
WORK = ((instance, "extract_archive"), (instance, "Library"), (description, "model_description"))


@pytest.fixture
def work(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """How often an archive is unpacked, a library is loaded and a model description is parsed."""
    calls = {name: 0 for _, name in WORK}

    def counting(function: Callable[..., Any], name: str) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            calls[name] += 1
            return function(*arguments, **options)

        return call

    for owner, name in WORK:
        monkeypatch.setattr(owner, name, counting(getattr(owner, name), name))
    return calls


def copy(fmu: Path, folder: Path) -> Path:
    """A file that nobody has read yet."""
    path = folder / "Copy.fmu"
    path.write_bytes(fmu.read_bytes())
    return path


def chain(fmu: Path) -> tuple[System, dict[str, float]]:
    """Plants of which each but the first is controlled by the output of the one before, and their inputs."""
    names = [f"p{i}" for i in range(COUNT)]
    links = [(f"{a}.output", f"{b}.control") for a, b in pairwise(names)]
    inputs = {"p0.control": 1.0, **{f"{name}.disturbance": 0.0 for name in names}}
    return System(dict.fromkeys(names, fmu), links), inputs


def test_a_chain_of_one_file_is_unpacked_loaded_and_parsed_once(
    built: Mapping[str, Path], tmp_path: Path, work: dict[str, int]
) -> None:
    system, inputs = chain(copy(built["ExamplePlant"], tmp_path))
    recording = simulate(system, inputs=inputs, stop_time=0.5, step_size=0.01)
    assert set(work.values()) == {1}
    outputs = [recording[f"p{i}.output"][-1] for i in range(3)]
    assert len(set(outputs)) == 3  # each has a state of its own


def test_of_an_fmu_of_ours_what_a_run_needs_is_unpacked(built: Mapping[str, Path]) -> None:
    """Its library and its resources, not its documentation and sources."""
    fmu = built["ExamplePlant"]
    with instance.unpacked(fmu, describe(fmu)) as opened, zipfile.ZipFile(fmu) as archive:
        files = {path.relative_to(opened.folder) for path in opened.folder.rglob("*") if path.is_file()}
        resources = {Path(name) for name in archive.namelist() if name.startswith("resources/")}
        (library,) = files - resources
        assert library.parts[0] == "binaries"
        assert resources <= files


def test_an_instance_keeps_its_state_when_another_of_its_library_is_freed(
    built: Mapping[str, Path], tmp_path: Path
) -> None:
    system = System({"p": copy(built["ExamplePlant"], tmp_path)})
    experiment = Experiment(1.0, 0.01, inputs={"p.control": 1.0, "p.disturbance": 0.0})
    alone = simulate(system, experiment)
    with Simulator(system) as simulator:
        run = simulator.start(experiment)
        simulate(system, experiment)
        while not run.is_done:
            run.step()
        assert run.recording().values.tolist() == alone.values.tolist()


def test_a_changed_file_is_read_again(
    built: Mapping[str, Path], tmp_path: Path, work: dict[str, int]
) -> None:
    path = copy(built["ExamplePlant"], tmp_path)
    assert describe(path).modelName == describe(path).modelName == "ExamplePlant"
    path.write_bytes(built["DepthReference"].read_bytes())
    assert describe(path).modelName == "DepthReference"
    assert work["model_description"] == 2


def test_another_file_of_the_same_size_and_time_is_read_again(
    built: Mapping[str, Path], tmp_path: Path, work: dict[str, int]
) -> None:
    """As a copy that keeps the time of what it copies may be."""
    path = copy(built["ExamplePlant"], tmp_path)
    describe(path)
    before, content = path.stat(), path.read_bytes()
    path.write_bytes(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    describe(path)
    assert work["model_description"] == 2


def test_instances_of_another_tools_fmu_have_a_library_each(
    linear: Callable[..., Path], work: dict[str, int]
) -> None:
    """It may hold memory that its instances share, and a fatal error of one is not one of the others."""
    fmu = linear()
    with FmuInstance("a", fmu, describe(fmu)) as a, FmuInstance("b", fmu, describe(fmu)) as b:
        assert a.library is not b.library
    assert work["extract_archive"] == 2


def test_only_native_fmus_of_ours_are_known_to_be_independent(
    built: Mapping[str, Path], python_built: Mapping[str, Path], linear: Callable[..., Path]
) -> None:
    """A block of the python flavour may be anybody's Python."""
    fmus = (built["ExamplePlant"], python_built["ExamplePlant"], linear())
    assert [is_independent(describe(fmu)) for fmu in fmus] == [True, False, False]


def with_other_equations(fmu: Path, folder: Path) -> Path:
    """A copy whose sources differ from what its library was compiled from."""
    source = "sources/model_code.h"
    equations = members(fmu)[source]
    assert b"next[0] = " in equations
    others = {source: equations.replace(b"next[0] = ", b"next[0] = 2.0 * ", 1)}
    return write_archive(folder / "Other.fmu", members(fmu) | others)


def test_a_copy_of_an_fmu_of_ours_is_ours_and_a_changed_one_runs_by_its_own_library(
    built: Mapping[str, Path], tmp_path: Path
) -> None:
    """An ensemble would compile the equations among its sources."""
    assert is_independent(describe(copy(built["ExamplePlant"], tmp_path)))
    changed = with_other_equations(built["ExamplePlant"], tmp_path)
    assert not is_independent(describe(changed))
    experiment = Experiment(1.0, 0.01, inputs={"p.control": 1.0, "p.disturbance": 0.0})
    system, refusal = System({"p": changed}), "native FMU that l1-depth build wrote for this user"
    with pytest.raises(EnsembleError, match=refusal):
        Ensemble(system)
    with pytest.raises(EnsembleError, match=refusal):
        check_ensemble(system, experiment, 8)
    runs = (simulate(one, experiment) for one in (system, System({"p": built["ExamplePlant"]})))
    of_library, of_ours = (run.values.tolist() for run in runs)
    assert of_library == of_ours


def test_an_fmu_of_another_user_s_build_is_not_ours(
    built: Mapping[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fmu = copy(built["ExamplePlant"], tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "another user's"))
    assert not is_independent(describe(fmu))


def test_a_record_of_a_build_that_others_can_write_proves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    record_build(b"an FMU")
    assert is_own_build(b"an FMU")
    assert not is_own_build(b"another FMU")
    (record,) = (tmp_path / "l1-depth" / "builds").iterdir()
    record.chmod(0o666)
    assert not is_own_build(b"an FMU")
