"""Experiments of the instances of an ensemble, and the vehicle that most of them run."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fmus.block import Block
from fmus.files import write_archive
from fmus.generate.archive import native_members
from fmus.generate.trace import trace
from fmus.store import record_build
from orchestration import Experiment
from orchestration.results.recording import Recording
from orchestration.run import Simulator
from tests.shared_builds import with_libraries

CONNECTIONS = [
    ("plant.measured_depth", "controller.measured_depth"),
    ("plant.depth_rate", "controller.measured_depth_rate"),
    ("controller.voltage[1]", "plant.voltage[1]"),
    ("controller.voltage[2]", "plant.voltage[2]", {"factor": 0.9, "offset": -0.05}),
]
REFERENCE, CURRENT = "controller.depth_reference", "plant.current_velocity"


def instances(
    experiment: Experiment, vary: Mapping[str, Sequence[Any]], inputs: Collection[str] = (CURRENT,)
) -> list[Experiment]:
    """The experiment with each of the values to vary: of `inputs`, of its signals, or else of parameters."""
    columns = zip(*vary.values(), strict=True)
    return [_with_values(experiment, dict(zip(vary, values, strict=True)), inputs) for values in columns]


def _with_values(experiment: Experiment, values: dict[str, Any], inputs: Collection[str]) -> Experiment:
    signals = {name: values.pop(name, signal) for name, signal in experiment.signals.items()}
    constant = {name: values.pop(name) for name in inputs if name in values}
    return replace(
        experiment,
        parameters={**experiment.parameters, **values},
        inputs={**experiment.inputs, **constant},
        signals=signals,
    )


def assert_same_bits(recorded: Recording, simulator: Simulator, experiments: Sequence[Experiment]) -> None:
    """Each run of a recording has the bits of a simulator's, and its provenance."""
    for instance, experiment in enumerate(experiments):
        one, of_ensemble = simulator.run(experiment), recorded.run(instance)
        assert of_ensemble.names == one.names
        assert of_ensemble.values.tobytes() == one.values.tobytes()
        assert of_ensemble.provenance == one.provenance


def built_for_ensembles(folder: Path, block: Block, **options: bool) -> Path:
    """A native FMU of the block, as `l1-depth build` writes it."""
    path = folder / f"{block.name}.fmu"
    write_archive(path, with_libraries(block.name, native_members(trace(block), **options)[1]))
    record_build(path.read_bytes())
    return path
