"""Names of components and FMUs with blanks, %, # and other letters, in the packages that importers open."""

from pathlib import Path
from urllib.parse import quote
from xml.etree import ElementTree

import numpy as np
import pytest

from fmus.files import write_archive
from orchestration.cli.package_fmus import build_started
from orchestration.exchange import ssp_read, ssp_write
from orchestration.exchange.ssp_xml import STRUCTURE, tag
from orchestration.run import simulate
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.described_fmus import members
from tests.importers.comparison import least_difference, run_isolated, trajectory
from tests.importers.importers import IMPORTERS, ImporterJob, Trajectory
from tests.shared_builds import Fmus

pytestmark = pytest.mark.importers

FIRST, SECOND = "größe 1", "50% #2"
OUTPUT = f"{SECOND}.output"
# FMPy 0.3.32, Ecos 0.7.2 and fmucontainer 2.0 take the text for a path, as OMSimulator does (2940ef11)
DECODING = {"libcosim"}


@pytest.fixture(scope="module")
def mine(built: Fmus, tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    """Two of the paper's plants; an input of the first starts at 1, and its output drives the second."""
    folder = tmp_path_factory.mktemp("named")
    first = build_started(built["ExamplePlant"], {"control": 1.0}, folder)
    fmus = {name: folder / f"{name} plant %20.fmu" for name in (FIRST, SECOND)}
    for path, fmu in zip(fmus.values(), (first, built["ExamplePlant"]), strict=True):
        path.write_bytes(fmu.read_bytes())
    connections = [(f"{FIRST}.output", f"{SECOND}.control")]
    experiment = Experiment(1.0, 0.01, record=(OUTPUT,), open_inputs="start")
    return Scenario("mine", "", System(fmus, connections), experiment, {})


@pytest.fixture(scope="module")
def job(mine: Scenario, tmp_path_factory: pytest.TempPathFactory) -> ImporterJob:
    folder = tmp_path_factory.mktemp("package")
    package = ssp_write.package(mine, folder / "mine.ssp", lambda *_: folder)
    return ImporterJob(package, ((SECOND, "output"),), 0.0, 1.0, 0.01)


def sources(package: Path) -> list[str]:
    root = ElementTree.fromstring(members(package)[STRUCTURE])
    return [component.get("source", "") for component in root.iter(tag("ssd:Component"))]


def test_each_source_is_an_escaped_uri_and_the_name_of_a_file(job: ImporterJob, mine: Scenario) -> None:
    """No name needs an escape, which most importers do not decode."""
    assert [quote(source) for source in sources(job.package)] == sources(job.package)
    assert {*sources(job.package)} < members(job.package).keys()
    with ssp_read.opened(job.package) as loop:
        assert [fmu.read_bytes() for fmu in loop.system.components.values()] == [
            fmu.read_bytes() for fmu in mine.system.components.values()
        ]


@pytest.mark.parametrize("importer", IMPORTERS)
def test_an_importer_opens_it_and_gives_what_this_master_gives(
    importer: str, job: ImporterJob, mine: Scenario
) -> None:
    ours, answer = simulate(mine.system, mine.experiment), trajectory(importer, job)
    assert np.ptp(ours[OUTPUT]) > 1e-3
    # times that are added up differ in their rounding, which is 1e-14 of a second here
    assert least_difference(answer, ours, job)[1] < 1e-12


@pytest.mark.parametrize("importer", IMPORTERS)
def test_escapes_in_a_source_are_decoded_by_libcosim_alone(
    importer: str, job: ImporterJob, tmp_path: Path
) -> None:
    """Where this fails for another importer, the writer can keep the names of FMUs."""
    content = members(job.package)
    (source, *_) = sources(job.package)
    content["resources/a b.fmu"] = content.pop(source)
    content[STRUCTURE] = content[STRUCTURE].replace(source.encode(), b"resources/a%20b.fmu")
    escaped = ImporterJob(write_archive(tmp_path / "escaped.ssp", content), job.outputs, 0.0, 1.0, 0.01)
    assert isinstance(run_isolated(importer, escaped), Trajectory) == (importer in DECODING)
