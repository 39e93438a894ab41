"""Other people's importers run FMUs of FMI 3.0 for co-simulation as our master runs those of FMI 2.0."""

from pathlib import Path

import numpy as np
import pytest

from fmus.fmi.process import Worker
from fmus.generate import builder
from orchestration import Experiment, System, simulate
from orchestration.exchange import ssp_write
from orchestration.scenarios.scenario import Scenario
from tests.importers.comparison import run_isolated
from tests.importers.fmi3_loops import STEP, Link, Loop, run_in_container, run_in_ecos
from tests.importers.importers import IMPORTERS, ImporterJob, Trajectory
from tests.isolated import answer_of
from tests.shared_builds import Fmus, LazyFmus, session_folder

pytestmark = pytest.mark.importers

STEPS = 1000
PLANT, CONTROLLER, REFERENCE, ALLOCATION = NAMES = (
    "RovDepthPlant", "PidDepthController", "DepthReference", "ThrustAllocation",
)  # fmt: skip
OUTPUT = f"{PLANT}.depth"
DEPTHS = (
    (f"{REFERENCE}.depth_reference", f"{CONTROLLER}.depth_reference"),
    (f"{PLANT}.measured_depth", f"{CONTROLLER}.measured_depth"),
    (f"{CONTROLLER}.demanded_force", f"{ALLOCATION}.control_force"),
)
ELEMENTS = tuple((f"{ALLOCATION}.voltage[{i}]", f"{PLANT}.voltage[{i}]") for i in (1, 2))
ARRAY = ((f"{ALLOCATION}.voltage", f"{PLANT}.voltage"),)

# Ecos adds up its steps, which moves the depth by 6e-13 m in 20 s
ROUNDING_OF_TIME = 1e-11


@pytest.fixture(scope="session")
def fmi3(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return _built(session_folder(tmp_path_factory, "fmi 3"))


@pytest.fixture(scope="session")
def of_scalars(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return _built(session_folder(tmp_path_factory, "scalars"), scalars=True)


def _built(folder: Path, scalars: bool = False) -> dict[str, Path]:
    """FMUs of FMI 3.0 by block."""

    def build(name: str, where: Path) -> Path:
        return builder.build_block(builder.load_block(name), where, fmi=3, scalars=scalars)

    return dict(LazyFmus(NAMES, folder, build))


EXPERIMENT = Experiment(stop_time=STEPS * STEP, step_size=STEP, record=(OUTPUT,), open_inputs="start")


@pytest.fixture(scope="module")
def ours(built: Fmus) -> np.ndarray:
    system = System({name: built[name] for name in NAMES}, [*DEPTHS, *ELEMENTS])
    return simulate(system, EXPERIMENT)[OUTPUT]


def answer(worker: Worker, loop: Loop, *others: object) -> np.ndarray:
    result = answer_of(worker, (loop, *others) if others else loop, 120.0)
    assert isinstance(result, np.ndarray), result
    return result


def loop(fmus: dict[str, Path], *links: Link) -> Loop:
    return Loop(fmus, (*DEPTHS, *links), OUTPUT, STEPS)


@pytest.mark.parametrize("version", [2, 3])
def test_fmucontainer_connects_arrays(fmi3: dict[str, Path], ours: np.ndarray, version: int) -> None:
    """In containers that are FMUs of FMI 2.0 and 3.0."""
    values = answer(run_in_container, loop(fmi3, *ARRAY), version)
    assert np.ptp(values) > 0.1
    np.testing.assert_allclose(values, ours, rtol=0.0, atol=ROUNDING_OF_TIME)


def test_ecos_mixes_both_standards(built: Fmus, fmi3: dict[str, Path], ours: np.ndarray) -> None:
    """FMUs of FMI 3.0 take and give scalars."""
    mixed = {name: (fmi3 if name in (CONTROLLER, REFERENCE) else built)[name] for name in NAMES}
    values = answer(run_in_ecos, loop(mixed, *ELEMENTS))
    assert np.ptp(values) > 0.1
    np.testing.assert_allclose(values, ours, rtol=0.0, atol=ROUNDING_OF_TIME)


def test_ecos_connects_scalars_of_fmi_3(of_scalars: dict[str, Path], ours: np.ndarray) -> None:
    values = answer(run_in_ecos, loop(of_scalars, *ELEMENTS))
    np.testing.assert_allclose(values, ours, rtol=0.0, atol=ROUNDING_OF_TIME)


def test_fmucontainer_connects_scalars_of_fmi_3(of_scalars: dict[str, Path], ours: np.ndarray) -> None:
    values = answer(run_in_container, loop(of_scalars, *ELEMENTS), 3)
    np.testing.assert_allclose(values, ours, rtol=0.0, atol=ROUNDING_OF_TIME)


def test_ecos_does_not_connect_arrays(fmi3: dict[str, Path]) -> None:
    """Ecos 0.7.2 reports no error, and nothing moves; its page must change when this fails."""
    assert not np.any(answer(run_in_ecos, loop(fmi3, *ARRAY)))


@pytest.mark.parametrize("importer", IMPORTERS)
def test_packages_of_scalars_of_fmi_3_run_where_the_importer_knows_fmi_3(
    importer: str, of_scalars: dict[str, Path], ours: np.ndarray, tmp_path: Path
) -> None:
    """Ecos and fmucontainer; FMPy's master for packages, and libcosim, load FMUs of FMI 2.0 alone."""
    system = System(of_scalars, [*DEPTHS, *ELEMENTS])
    mine = Scenario("mine", "", system, EXPERIMENT, {})
    package = ssp_write.package(mine, tmp_path / "mine.ssp", lambda *_: tmp_path)
    result = run_isolated(importer, ImporterJob(package, ((PLANT, "depth"),), 0.0, STEPS * STEP, STEP))
    if importer in ("fmpy_ssp", "libcosim"):
        assert isinstance(result, str)
        return
    assert isinstance(result, Trajectory), result
    np.testing.assert_allclose(result.values[:, 0], ours, rtol=0.0, atol=ROUNDING_OF_TIME)
