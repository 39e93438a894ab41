"""The whole system at one communication point as one file, and a run that continues from it.

The file holds the FMUs' serialised states, the values of every connection, and the record so far. A run that
continues from it gives the same record, to the last bit, as a run without interruption. Its past must be the
same; its future, a later stop time for instance, may differ.
"""

import hashlib
import json
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fmus.files import open_atomically
from orchestration.errors import OrchestrationError, SystemDefinitionError
from orchestration.run.loop_data import CHANGING, CHANGING_OF_CONNECTIONS, Report
from orchestration.run.run import Progress, Run
from orchestration.system.system import CheckedSystem

_VERSION = 6
_HEAD = ("position", "time", "step_control", "past", "strings")  # members of a checkpoint that are plain data


@dataclass(frozen=True)
class Checkpoint:
    """A saved system.

    Parameters
    ----------
    position : int
        Index of the communication point.
    time : float
        Its time [s].
    step_control : mapping
        `StepControl.state`.
    past : mapping
        Part of the run -> digest of its data until then.
    strings : list of str
        The table of `Strings`, whose numbers are in the arrays.
    states : mapping
        Component -> serialised state of its FMU.
    arrays : mapping
        Name -> array of the loop.
    """

    position: int
    time: float
    step_control: Mapping[str, Any]
    past: Mapping[str, str]
    strings: list[str]
    states: Mapping[str, bytes]
    arrays: Mapping[str, np.ndarray]

    def write(self, path: str | Path) -> None:
        """Writes the file; an older one is replaced when the new one is complete.

        Parameters
        ----------
        path : str or Path
            The file.
        """
        head = {name: getattr(self, name) for name in _HEAD}
        head |= {"version": _VERSION, "components": list(self.states)}
        content: dict[str, Any] = {
            f"state {i}": np.frombuffer(state, np.uint8) for i, state in enumerate(self.states.values())
        }
        content |= {f"array {name}": array for name, array in self.arrays.items()}
        content["head"] = np.frombuffer(json.dumps(head).encode(), np.uint8)
        with open_atomically(Path(path)) as stream:
            np.savez(stream, **content)


def read_checkpoint(path: str | Path) -> Checkpoint:
    """Returns the checkpoint of a file, from which `simulate` continues a run.

    Parameters
    ----------
    path : str or Path
        File of `Checkpoint.write`.

    Returns
    -------
    Checkpoint

    Raises
    ------
    OrchestrationError
        For a missing file, another file, or another version.
    """
    try:
        with np.load(path, allow_pickle=False) as content:
            head = json.loads(content["head"].tobytes())
            if head["version"] != _VERSION:
                raise OrchestrationError(
                    f"{path}: checkpoint of version {head['version']}: expected {_VERSION}"
                )
            return Checkpoint(
                **{name: head[name] for name in _HEAD},
                states={n: content[f"state {i}"].tobytes() for i, n in enumerate(head["components"])},
                arrays={n[6:]: content[n] for n in content.files if n.startswith("array ")},
            )
    except FileNotFoundError:
        raise OrchestrationError(f"no checkpoint {path}") from None
    except (zipfile.BadZipFile, OSError, KeyError, ValueError, TypeError, AttributeError, EOFError) as error:
        raise OrchestrationError(f"{path} is not a checkpoint, or is damaged: {error}") from error


def check_can_save(system: CheckedSystem) -> None:
    """Raises SystemDefinitionError if an FMU cannot serialise its state."""
    incapable = system.components_without("canSerializeFMUstate")
    if incapable:
        raise SystemDefinitionError(
            f"checkpoint: {', '.join(incapable)} cannot serialise its state: expected canSerializeFMUstate"
        )


def capture(run: Run) -> Checkpoint:
    """Captures the system at the present point; OrchestrationError where no run can continue."""
    wiring, position = run.wiring, run.point
    is_last = position == len(wiring.points) - 1
    if is_last and np.any(position % wiring.periods):
        raise OrchestrationError(
            "at the end of the run components are between communication points of their own"
        )
    state, instances = run.save(), run.wired.instances.items()
    states = {
        name: fmu.serialize_fmu_state(state.snapshot.memory[c]) for c, (name, fmu) in enumerate(instances)
    }
    return Checkpoint(
        position=position,
        time=run.time,
        step_control=state.step_control,
        past=_past(run, position),
        strings=run.wired.strings.table,
        states=states,
        arrays={name: array.copy() for name, array in _saved_arrays(run, position).items()},
    )


def restore(checkpoint: Checkpoint, run: Run) -> None:
    """Sets an initialised run to the checkpoint; OrchestrationError if it belongs to another run."""
    position, past = checkpoint.position, _past(run, checkpoint.position)
    different = [part for part in past if past[part] != checkpoint.past.get(part)]
    if different:
        raise OrchestrationError(
            f"the checkpoint belongs to another run, of which {', '.join(different)} differ: "
            "expected the same past"
        )
    if position >= len(run.wiring.points):
        raise OrchestrationError(
            f"the checkpoint is at t = {checkpoint.time:.9g} s: expected a stop time behind that"
        )
    for name, array in _saved_arrays(run, position).items():
        saved = checkpoint.arrays.get(name)
        if saved is None or (saved.shape, saved.dtype) != (array.shape, array.dtype):
            raise OrchestrationError(f"the checkpoint is damaged: expected {name} of shape {array.shape}")
        array[:] = saved
    run.wired.strings.table = checkpoint.strings
    run.wiring.report[Report.RECORDED] = position
    for name, instance in run.wired.instances.items():
        state = instance.deserialize_fmu_state(checkpoint.states[name])
        instance.set_fmu_state(state)
        instance.free_fmu_state(state)
    run.wiring.report[Report.POSITION] = position
    if run.step_control:
        run.step_control.state = checkpoint.step_control


def _saved_arrays(run: Run, position: int) -> dict[str, np.ndarray]:
    wiring = run.wiring
    return {
        **{name: getattr(wiring, name) for name in CHANGING},
        **{name: getattr(wiring.connections, name) for name in CHANGING_OF_CONNECTIONS},
        "rows": wiring.rows[:position],
        "history": wiring.faults.history[:, : position + 1],
    }


def _past(run: Run, position: int) -> dict[str, str]:
    """Returns the digests of everything that determines a run up to a communication point."""
    prepared, wiring, until = run.prepared, run.wiring, position + 1
    faults = wiring.faults
    periods, modes = (array.tobytes() for array in (wiring.periods, wiring.connections.input_mode))
    settings = [(port.name, value) for port, value in prepared.settings]
    experiment = prepared.experiment
    of_fmus = [experiment.fmu_tolerance] if experiment.fmu_tolerance else []
    changes = [
        (index, port.name, value)
        for index, values in sorted(prepared.changes.items())
        for port, value in values
        if index < position
    ]
    parts: dict[str, list[object]] = {
        "the FMUs": [(name, d.guid) for name, d in prepared.system.descriptions.items()],
        # without a tolerance of the FMUs as in checkpoints from before there was one
        "the algorithm": [wiring.gauss_seidel, periods, modes, experiment.tolerance, *of_fmus],
        "the communication points": [wiring.points[:until].tobytes()],
        "the connections": [*run.wired.bus.connections, sorted(prepared.system.transformations.items())],
        "the record": list(prepared.recorded),
        "the signals": [wiring.signal_values[:, :until].tobytes()],
        "the faults": [x[:, :until].tobytes() for x in (faults.source, faults.weight, faults.addition)],
        "parameters, inputs and events": [settings, changes],
    }
    return {name: hashlib.sha256(repr(part).encode()).hexdigest() for name, part in parts.items()}


@dataclass(frozen=True)
class Checkpoints:
    """Checkpoints to save when the run is interrupted, and at intervals.

    Parameters
    ----------
    path : str or Path
        The file; each checkpoint replaces the one before.
    every : float
        Simulated time between checkpoints [s]; by default only an interrupted run is saved.

    Raises
    ------
    OrchestrationError
        For an interval that is not above 0.
    """

    path: str | Path
    every: float = math.inf

    def __post_init__(self) -> None:
        if not self.every > 0.0:
            raise OrchestrationError(f"a checkpoint every {self.every!r} s: expected more than 0")

    def save(self, run: Run) -> None:
        """Writes a checkpoint of the present communication point.

        Parameters
        ----------
        run : Run
            The run to save.
        """
        capture(run).write(self.path)

    def save_until_done(self, run: Run, progress: Progress | None = None) -> None:
        """Advances a run to its end, and saves when due.

        Parameters
        ----------
        run : Run
            The run to save.
        progress : callable, optional
            See `Run.advance`.
        """
        # a shorter interval would lead to the point where the run is
        every = max(self.every, 2.0 * run.prepared.experiment.time_resolution())
        while True:
            run.advance(run.time + every, progress)
            if run.is_done:
                return
            self.save(run)

    def save_interrupted(self, run: Run) -> str:
        """Saves an interrupted run.

        Parameters
        ----------
        run : Run
            The run to save.

        Returns
        -------
        str
            End of its error message.
        """
        try:
            self.save(run)
        except (OrchestrationError, OSError) as error:
            return f"; not saved: {error}"
        return f"; saved in {self.path}"
