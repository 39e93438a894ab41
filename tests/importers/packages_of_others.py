"""Run SSP packages of others in every importer, and compare all Real outputs with this master's.

`python -m tests.importers.packages_of_others FOLDER` takes each .ssp in the folder, and each folder in it
with a SystemStructure.ssd; it prints Markdown. Twelve packages are in OMSimulator's
`testsuite/tests/resources` (2940ef11) and libcosim's `tests/data/ssp/demo` (52cc8251). OMSimulator was
built by hand.

| package | other engines: largest difference, of the output's largest value |
|---|---|
| demo | libcosim 0, bit for bit; without its bindings Ecos, fmucontainer and FMPy 1 |
| LinearTransformation | OMSimulator, libcosim 0 |
| LinearTransformation3 | OMSimulator 0; libcosim ignores bindings of systems: 0 for 182 |
| toplevelparameter1, toplevelparameter2 | OMSimulator, libcosim, Ecos, fmucontainer 0 |
| import_export_parameters1, 2, 3 | OMSimulator 0 |
| dcmotor | OMSimulator 9.0e-3, a torque at 0.011 s; 3e-6 of the speed wB at 1 s |
| embrace | OMSimulator 5.3e-2 at 0.002 s; fmucontainer, which ignores bindings, 3.3e-2 |
| embrace_TwoConf | OMSimulator 0.15; fmucontainer 1.8 |
| acvs_compositeModel | OMSimulator 505 for 0, a valve at the second point; 2.5e-4 of TLiquid at 1 s |

The other engines refuse them: version 2.0 (FMPy, Ecos), systems in systems, connectors of systems, types.
Of embrace: OMSimulator gives FMUs the new values of direct feedthrough after each step, this master at the
next one, and a relative tolerance of 1e-4. With it ECS_HW is wrong by thousands, here as well:

| at 0.1 s, steps of | 1 ms | 0.2 ms | 0.05 ms |
|---|---|---|---|
| Consumer.consumerRet.h [J/kg] here | 0.45893 | 0.46230 | 0.46278 |
| Gauss-Seidel | 0.46638 | 0.46380 | 0.46315 |
| fmu_tolerance = 1e-4 | 0.45903 | 0.46113 | 0.46220 |
| OMSimulator | 0.45791 | 0.45763 | 0.45856 |
| ECS_HW.consumerFeed.hn [J/kg] here | 3550.9 | 3509.6 | 3501.7 |
| Gauss-Seidel | 3500.6 | 3499.4 | 3499.3 |
| fmu_tolerance = 1e-4 | 3551.3 | 1656.6 | 3488.7 |
| OMSimulator | 3539.2 | 3514.1 | 3315.5 |
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from fmus.errors import OrchestrationError
from fmus.files import write_archive
from orchestration.exchange import ssp_read
from orchestration.exchange.ssp_xml import STRUCTURE
from orchestration.results.recording import Recording
from orchestration.run import simulate
from tests.importers.comparison import run_isolated
from tests.importers.importers import IMPORTERS, ImporterJob, Trajectory


def main(
    folder: Annotated[Path, typer.Argument(help="Folder of packages.", exists=True, file_okay=False)],
    importers: Annotated[list[str], typer.Option("--importer", help="Only these.")] = list(IMPORTERS),  # noqa: B006
    values: Annotated[bool, typer.Option(help="Print the last values of every output as well.")] = False,
) -> None:
    """Compare packages of others in every importer with this master."""
    print("| Package | Importer | Largest difference, of the output's largest value |\n| --- | --- | --- |")
    with tempfile.TemporaryDirectory() as extracted:
        for package in _packages(folder, Path(extracted)):
            for importer, result, table in _rows(package, importers):
                print(f"| {package.stem} | {importer} | {result} |", flush=True)
                print(*(table if values else ()), sep="\n", end="\n" if values else "")


def _packages(folder: Path, archives: Path) -> Iterator[Path]:
    yield from sorted(folder.glob("*.ssp"))
    for structure in sorted(folder.glob(f"*/{STRUCTURE}")):
        files = [file for file in structure.parent.rglob("*") if file.is_file()]
        members = {str(file.relative_to(structure.parent)): file.read_bytes() for file in files}
        yield write_archive(archives / f"{structure.parent.name}.ssp", members)


def _rows(package: Path, importers: list[str]) -> Iterator[tuple[str, str, list[str]]]:
    """Yields an importer, how far it is from this master, and its last values beside this master's."""
    try:
        with ssp_read.opened(package) as loop:
            prepared = loop.prepared.system
            ours = simulate(loop.system, loop.experiment, timeout=60.0)
    except OrchestrationError as error:
        yield "l1-depth", str(error), []
        return
    ports = [prepared.ports[name] for name in ours.names]
    outputs = tuple((p.component, p.variable.name) for p in ports if p.variable.type == "Real")
    experiment = loop.experiment
    job = ImporterJob(package, outputs, experiment.start_time, experiment.stop_time, experiment.step_size)
    for importer in importers:
        answer = run_isolated(importer, job)
        if isinstance(answer, str):
            yield importer, f"does not run: {answer}", []
        else:
            yield importer, _largest(answer, ours, job), _last(answer, ours, job)


def _largest(answer: Trajectory, ours: Recording, job: ImporterJob) -> str:
    """Returns where an importer differs most at the same communication points, labelled as it labels them."""
    points = np.rint((answer.time - job.start_time) / job.step_size).astype(int)
    there = points < len(ours.time)
    worst = (-1.0, "")
    for column, output in enumerate(job.outputs):
        name = ".".join(output)
        gap = np.abs(answer.values[there, column] - ours[name][points[there]])
        scale = float(np.max(np.abs(ours[name]))) or 1.0
        row = int(np.argmax(np.where(np.isnan(gap), np.inf, gap)))
        if not gap[row] / scale <= worst[0]:
            worst = gap[row] / scale, f"{name} at {answer.time[there][row]:.6g} s ({gap[row]:.3g})"
    return f"{worst[0]:.1e}: {worst[1]}"


def _last(answer: Trajectory, ours: Recording, job: ImporterJob) -> list[str]:
    names = [".".join(output) for output in job.outputs]
    return [
        f"  {n}: {v:.10g}, here {ours[n][-1]:.10g}" for n, v in zip(names, answer.values[-1], strict=True)
    ]


if __name__ == "__main__":
    typer.run(main)
