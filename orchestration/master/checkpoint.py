"""A whole system at one communication point as one file, and a run that goes on from it.

It holds the FMUs' serialised states, what every connection carries, and the record so far. A run that goes
on from it gives the same record, to the last bit, as one that was never interrupted. Its past must be the
same; its future, a later stop time for instance, may be another.
"""

import hashlib
import json
import math
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fmus.files import open_atomically
from orchestration.errors import OrchestrationError
from orchestration.fmi.instance import FmuInstance
from orchestration.master.loop import RECORDED
from orchestration.master.snapshot import moving_arrays
from orchestration.master.stepping import MOST_STEPS, Run

_VERSION = 1


@dataclass(frozen=True)
class Checkpoint:
    """position, time: the communication point, its number and its time [s]

    step_size: the next that the error allows [s]

    past: part of the run -> digest of what it was until then; states: component -> its serialised state
    """

    position: int
    time: float
    step_size: float
    past: Mapping[str, str]
    states: Mapping[str, bytes]
    arrays: Mapping[str, np.ndarray]

    def write(self, path: str | Path) -> None:
        head = {
            "version": _VERSION,
            "position": self.position,
            "time": self.time,
            "step_size": self.step_size,
            "past": dict(self.past),
            "components": list(self.states),
        }
        content: dict[str, Any] = {
            f"state {i}": np.frombuffer(each, np.uint8) for i, each in enumerate(self.states.values())
        }
        content |= {f"array {name}": array for name, array in self.arrays.items()}
        content["head"] = np.frombuffer(json.dumps(head).encode(), np.uint8)
        with open_atomically(Path(path)) as stream:
            np.savez(stream, **content)


def read_checkpoint(path: str | Path) -> Checkpoint:
    """The inverse of `Checkpoint.write`; OrchestrationError for another file."""
    try:
        with np.load(path, allow_pickle=False) as content:
            head = json.loads(content["head"].tobytes())
            if head["version"] != _VERSION:
                raise OrchestrationError(
                    f"{path}: checkpoint of version {head['version']}: expected {_VERSION}"
                )
            return Checkpoint(
                position=head["position"],
                time=head["time"],
                step_size=head["step_size"],
                past=head["past"],
                states={n: content[f"state {i}"].tobytes() for i, n in enumerate(head["components"])},
                arrays={n[6:]: content[n] for n in content.files if n.startswith("array ")},
            )
    except FileNotFoundError:
        raise OrchestrationError(f"no checkpoint {path}") from None
    except (zipfile.BadZipFile, OSError, KeyError, ValueError, TypeError, AttributeError, EOFError) as error:
        raise OrchestrationError(f"{path} is not a checkpoint, or is damaged: {error}") from error


def capture(run: Run, components: Mapping[str, FmuInstance]) -> Checkpoint:
    """The system where it is. OrchestrationError where that is no place to go on from."""
    last = run.position == len(run.wiring.points) - 1
    if last and np.any(run.position % run.wiring.period):
        raise OrchestrationError(
            "at the end of the run components are between communication points of their own"
        )
    states = {}
    for name, component in components.items():
        state = component.get_fmu_state()
        states[name] = component.serialize_fmu_state(state)
        component.free_fmu_state(state)
    w, i = run.wiring, run.position
    arrays = {name: array.copy() for name, array in moving_arrays(w).items()}
    arrays |= {"rows": w.rows[:i].copy(), "history": w.faults.history[:, : i + 1].copy()}
    step_size = run.shorter.step_size if run.shorter else 0.0
    return Checkpoint(i, float(w.points[i]), step_size, past(run, i), states, arrays)


def restore(checkpoint: Checkpoint, run: Run, components: Mapping[str, FmuInstance]) -> None:
    """Bring a run that has been initialised to the checkpoint."""
    w, i = run.wiring, checkpoint.position
    present = past(run, i)
    other = [part for part in present if present[part] != checkpoint.past.get(part)]
    if other:
        raise OrchestrationError(
            f"the checkpoint belongs to another run, of which {', '.join(other)} differ: "
            "expected the same past"
        )
    if i >= len(w.points):
        raise OrchestrationError(
            f"the checkpoint is at t = {checkpoint.time:.9g} s: expected a stop time behind that"
        )
    places = {**moving_arrays(w), "rows": w.rows[:i], "history": w.faults.history[:, : i + 1]}
    for name, place in places.items():
        found = checkpoint.arrays.get(name)
        if found is None or (found.shape, found.dtype) != (place.shape, place.dtype):
            raise OrchestrationError(f"the checkpoint is damaged: expected {name} of shape {place.shape}")
        place[:] = found
    w.report[RECORDED] = i
    for name, component in components.items():
        state = component.deserialize_fmu_state(checkpoint.states[name])
        component.set_fmu_state(state)
        component.free_fmu_state(state)
    run.position = i
    if run.shorter:
        run.shorter.step_size = checkpoint.step_size


def past(run: Run, position: int) -> dict[str, str]:
    """Digests of all that made a run what it is at a communication point."""
    w, until = run.wiring, position + 1
    parts: dict[str, list[object]] = {
        "the FMUs": [(name, each.guid) for name, each in run.prepared.system.descriptions.items()],
        "the algorithm": [
            w.gauss_seidel,
            w.period.tobytes(),
            w.links.carried.tobytes(),
            run.prepared.experiment.tolerance,
        ],
        "the communication points": [w.points[:until].tobytes()],
        "the connections": list(run.loom.links),
        "the record": list(run.loom.recorded),
        "the signals": [w.signals[:, :until].tobytes()],
        "the faults": [w.faults.source[:, :until].tobytes(), w.faults.addition[:, :until].tobytes()],
        "parameters, inputs and events": [_settings(run), run.changes_before(position)],
    }
    return {name: hashlib.sha256(repr(part).encode()).hexdigest() for name, part in parts.items()}


def _settings(run: Run) -> list[tuple[str, Any]]:
    return [(port.name, value) for port, value in run.prepared.settings]


@dataclass(frozen=True)
class Checkpoints:
    """Where to save the system: when the run is interrupted, and every so many simulated seconds."""

    path: str | Path
    every: float = math.inf

    def __post_init__(self) -> None:
        if not self.every > 0.0:
            raise OrchestrationError(f"a checkpoint every {self.every!r} s: expected more than 0")

    def save(self, run: Run, components: Mapping[str, FmuInstance]) -> None:
        capture(run, components).write(self.path)

    def keeper(self, run: Run, components: Mapping[str, FmuInstance]) -> Callable[[int], int]:
        """For `Run.go`: saves at the points that are due, and tells how far it is to the next."""
        points = run.wiring.points
        due = float(points[run.position]) + self.every

        def keep(position: int) -> int:
            nonlocal due
            if points[position] >= due:
                self.save(run, components)
                due = float(points[position]) + self.every
            return min(max(1, int(np.searchsorted(points, due)) - position), MOST_STEPS)

        return keep
