"""Reference results as files that other tools can replay.

FMI cross-check   NAME_in.csv, NAME_ref.csv, NAME_ref.opt beside the FMU (rules 4.1, 9.1.4 and appendix B)
FMI-LS-REF        the same tables inside, with a manifest (1.0.0-alpha.1) and an experiments file in the
                  format of MA-HS-Experiments; both are drafts of the Modelica Association
"""

import csv
import io
from xml.etree import ElementTree

from fmus.block import Value
from fmus.build.documentation.reference_results import ReferenceRun
from fmus.files import xml_document

LS_REF = "org.fmi-standard.fmi-ls-ref"
# elementary functions differ between C libraries by some 1e-16 a call; loops amplify
RELATIVE_TOLERANCE = 1e-6
_FOLDER = f"extra/{LS_REF}"
_MANIFEST_NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"


def cross_check_files(run: ReferenceRun, name: str) -> dict[str, bytes]:
    """File name -> content of what stands beside NAME.fmu for the FMI cross-check."""
    options = {
        "StartTime": 0.0,
        "StopTime": run.stop_time,
        "StepSize": run.step_size,
        "RelTol": RELATIVE_TOLERANCE,
        "SolverType": "FixedStep",
        "OutputIntervalLength": run.output_interval,
    }
    lines = "".join(f"{option}, {value}\n" for option, value in options.items())
    return _tables(run, name) | {f"{name}_ref.opt": lines.encode()}


def members(run: ReferenceRun, name: str) -> dict[str, bytes]:
    """Path inside the FMU -> content of what FMI-LS-REF describes."""
    tables = _tables(run, name)
    files = tables | {f"{name}.exp": _experiments(run, name, tables)}
    return {f"{_FOLDER}/{file}": data for file, data in files.items()} | {
        f"{_FOLDER}/fmi-ls-manifest.xml": _manifest(name, files)
    }


def _tables(run: ReferenceRun, name: str) -> dict[str, bytes]:
    tables = {f"{name}_ref.csv": _csv(run.outputs, run.output_rows)}
    return tables | ({f"{name}_in.csv": _csv(run.inputs, run.input_rows)} if run.inputs else {})


def _csv(names: tuple[str, ...], rows: tuple[tuple[Value, ...], ...]) -> bytes:
    """Names in quotes, numbers as C writes them, booleans and enumerations as integers."""
    stream = io.StringIO()
    csv.writer(stream, quoting=csv.QUOTE_ALL, lineterminator="\n").writerow(("time", *names))
    for row in rows:
        stream.write(",".join(repr(x) if isinstance(x, float) else str(int(x)) for x in row) + "\n")
    return stream.getvalue().encode()


def _experiments(run: ReferenceRun, name: str, tables: dict[str, bytes]) -> bytes:
    root = ElementTree.Element("Experiments", name=f"Reference experiment of {name}")
    description = "Parameters at their start values; inputs in straight lines between the rows"
    attributes = {"name": "reference", "description": description, "tolerance": repr(RELATIVE_TOLERANCE)}
    experiment = ElementTree.SubElement(root, "Experiment", attributes)
    times = {"startTime": "0.0", "stopTime": repr(run.stop_time), "stepSize": repr(run.step_size)}
    ElementTree.SubElement(experiment, "TransientSimulation", times)
    for tag, file in (("Stimuli", f"{name}_in.csv"), ("References", f"{name}_ref.csv")):
        if file in tables:
            ElementTree.SubElement(experiment, tag, source=file)
    return xml_document(root)


def _manifest(name: str, files: dict[str, bytes]) -> bytes:
    ElementTree.register_namespace("fmi-ls", _MANIFEST_NAMESPACE)
    attributes = {
        "name": LS_REF,
        "version": "1.0.0-alpha.1",
        "description": "Layered Standard providing information on related files included in an FMU.",
    }
    qualified = {f"{{{_MANIFEST_NAMESPACE}}}fmi-ls-{key}": value for key, value in attributes.items()}
    root = ElementTree.Element("fmiReferences", qualified)
    for file, kind, role, description in (
        (f"{name}.exp", "application/x-ma-hs-experiments", "experiment", "Experiment to try the FMU with"),
        (f"{name}_ref.csv", "text/csv", "result", "Outputs in that experiment"),
        (f"{name}_in.csv", "text/csv", "other", "Inputs in that experiment"),
    ):
        if file in files:
            related = {"type": kind, "source": file, "role": role, "description": description}
            ElementTree.SubElement(root, "Related", related)
    return xml_document(root)
