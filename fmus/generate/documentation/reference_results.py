"""Reference results: the outputs of a block in the experiment of its guide, and the files that hold them.

`BlockInstance` computes them, so that an FMU of either flavour is checked against the block itself.

FMI cross-check   NAME_in.csv, NAME_ref.csv, NAME_ref.opt beside the FMU (rules 4.1, 9.1.4 and appendix B)
FMI-LS-REF        the same tables inside, with a manifest (1.0.0-alpha.1) and an experiments file in the
                  format of MA-HS-Experiments; both are drafts of the Modelica Association
"""

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from xml.etree import ElementTree

from fmus.block import Block
from fmus.block.instance import BlockInstance
from fmus.block.variables import BlockVariable, Value
from fmus.errors import ExportError, nearest
from fmus.files import xml_document
from fmus.numerics import ramps

Stimuli = dict[str, tuple[tuple[float, ...], ...]]
"""Name of an input that moves -> (times [s], values)."""

_MOST_INTERVALS = 400
# minutes of a build: a step takes Python ten microseconds or more
_MOST_STEPS = 1e7


@dataclass(frozen=True)
class ReferenceRun:
    """The experiment of a block in numbers: times in s, rows of (time, value, ...)."""

    stop_time: float
    step_size: float
    output_interval: float
    inputs: tuple[str, ...]
    input_rows: tuple[tuple[Value, ...], ...]
    outputs: tuple[str, ...]
    output_rows: tuple[tuple[Value, ...], ...]


def reference_run(block: Block) -> ReferenceRun:
    """Returns the inputs and outputs of the experiment of a block's guide.

    Outputs are those before the inputs of the same time are set, as every master records them; a start
    value or stimulus outside its range raises BlockError, a stimulus that fits no Real input or an experiment
    of too many steps ExportError.
    """
    experiment = block.guide.experiment
    step_size = float(experiment.step_size or block.step_size)
    stop_time = float(experiment.stop_time or block.stop_time)
    if not stop_time / step_size <= _MOST_STEPS:
        guide = f"guide=Guide(experiment=Experiment(stop_time={1000 * step_size:g})) from fmus.block.guide"
        raise ExportError(
            f"block {block.name!r}: {stop_time / step_size:.3g} steps of {step_size!r} s to {stop_time!r} s: "
            f"expected at most {_MOST_STEPS:.0e} of the reference results; shorten stop_time or add {guide}"
        )
    count = max(1, round(stop_time / step_size))
    fewest = math.ceil(count / _MOST_INTERVALS)
    every = next(steps for steps in range(fewest, count + 1) if count % steps == 0)
    stimuli = _stimuli(block)
    return ReferenceRun(
        stop_time=count * step_size,
        step_size=step_size,
        output_interval=every * step_size,
        inputs=tuple(v.name for v in block.of_causality("input")),
        input_rows=tuple(_input_rows(block, stimuli, count * step_size)),
        outputs=tuple(v.name for v in block.of_causality("output")),
        output_rows=tuple(_trajectory(block, stimuli, step_size, count, every)),
    )


def _stimuli(block: Block) -> Stimuli:
    names = [v.name for v in block.of_causality("input") if v.type == "Real"]
    stimuli = {}
    for name, points in block.guide.experiment.stimuli:
        if name not in names:
            raise ExportError(f"guide of {block.name}: no Real input {name!r}; {nearest(name, names)}")
        if not points or any(b[0] <= a[0] for a, b in pairwise(points)):
            raise ExportError(f"guide of {block.name}: {name}: expected points at increasing times")
        stimuli[name] = tuple(tuple(map(float, numbers)) for numbers in zip(*points, strict=True))
    return stimuli


def _value_at(v: BlockVariable, stimuli: Stimuli, t: float) -> Value:
    """Returns the value of an input at time t [s]."""
    return ramps(t, *stimuli[v.name], smooth=False) if v.name in stimuli else v.start


def _trajectory(
    block: Block, stimuli: Stimuli, step_size: float, count: int, every: int
) -> Iterator[tuple[Value, ...]]:
    instance, inputs = BlockInstance(block), block.of_causality("input")
    references = [v.value_reference for v in block.of_causality("output")]
    moving = [v for v in inputs if v.name in stimuli]

    def drive(t: float, variables: Sequence[BlockVariable]) -> None:
        for v in variables:
            instance.set(v.value_reference, _value_at(v, stimuli, t))

    instance.start(0.0)
    drive(0.0, inputs)
    instance.exit_initialization_mode()
    for i in range(count + 1):
        t = i * step_size
        if i % every == 0:
            yield (t, *(instance.get(reference) for reference in references))
        if i < count:
            drive(t, moving)
            instance.do_step(t, step_size)


def _input_rows(block: Block, stimuli: Stimuli, stop_time: float) -> Iterator[tuple[Value, ...]]:
    """Yields a row wherever an input bends: between rows, straight lines."""
    inputs = block.of_causality("input")
    bends = {t for times, _ in stimuli.values() for t in times if 0.0 < t < stop_time}
    for t in sorted({0.0, stop_time} | bends) if inputs else ():
        yield (t, *(_value_at(v, stimuli, t) for v in inputs))


LS_REF = "org.fmi-standard.fmi-ls-ref"
# elementary functions differ between C libraries by some 1e-16 a call; loops amplify
RELATIVE_TOLERANCE = 1e-6
_FOLDER = f"extra/{LS_REF}"
_MANIFEST_NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"


def cross_check_files(run: ReferenceRun, name: str) -> dict[str, bytes]:
    """Returns file name -> content of the files beside NAME.fmu for the FMI cross-check."""
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
    """Returns path inside the FMU -> content of the files of FMI-LS-REF."""
    tables = _tables(run, name)
    files = tables | {f"{name}.exp": _experiments(run, name, tables)}
    return {f"{_FOLDER}/{file}": data for file, data in files.items()} | {
        f"{_FOLDER}/fmi-ls-manifest.xml": _manifest(name, files)
    }


def _tables(run: ReferenceRun, name: str) -> dict[str, bytes]:
    tables = {f"{name}_ref.csv": _csv(run.outputs, run.output_rows)}
    return tables | ({f"{name}_in.csv": _csv(run.inputs, run.input_rows)} if run.inputs else {})


def _csv(names: tuple[str, ...], rows: tuple[tuple[Value, ...], ...]) -> bytes:
    """Returns a table: names in quotes, numbers as C writes them, booleans and enumerations as integers."""
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
