"""Everything that uses FMUs, through their model descriptions alone: the master algorithm and its tools.

What is exported here is what it takes to run a system of FMUs from Python; scenarios, metrics and sweeps are
modules: `from orchestration import scenario, metrics`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orchestration.errors import OrchestrationError, SimulationError
    from orchestration.master import Simulator, simulate
    from orchestration.master.checkpoint import Checkpoints, read_checkpoint
    from orchestration.results.recording import Recording
    from orchestration.system.experiment import Event, Experiment
    from orchestration.system.faults import Delay, Drift, DropOut, Fault, Freeze, Noise, Offset, Stuck
    from orchestration.system.signals import Constant, Cosine, Ramps, Samples
    from orchestration.system.system import System

__all__ = [
    "Checkpoints",
    "Constant",
    "Cosine",
    "Delay",
    "Drift",
    "DropOut",
    "Event",
    "Experiment",
    "Fault",
    "Freeze",
    "Noise",
    "Offset",
    "OrchestrationError",
    "Ramps",
    "Recording",
    "Samples",
    "SimulationError",
    "Simulator",
    "Stuck",
    "System",
    "read_checkpoint",
    "simulate",
]

# imported when they are asked for: the pytest plugin of the compliance checks must load nothing heavy
_HOMES = {
    "Checkpoints": "orchestration.master.checkpoint",
    "Constant": "orchestration.system.signals",
    "Cosine": "orchestration.system.signals",
    "Delay": "orchestration.system.faults",
    "Drift": "orchestration.system.faults",
    "DropOut": "orchestration.system.faults",
    "Event": "orchestration.system.experiment",
    "Experiment": "orchestration.system.experiment",
    "Fault": "orchestration.system.faults",
    "Freeze": "orchestration.system.faults",
    "Noise": "orchestration.system.faults",
    "Offset": "orchestration.system.faults",
    "OrchestrationError": "orchestration.errors",
    "Ramps": "orchestration.system.signals",
    "Recording": "orchestration.results.recording",
    "Samples": "orchestration.system.signals",
    "SimulationError": "orchestration.errors",
    "Simulator": "orchestration.master",
    "Stuck": "orchestration.system.faults",
    "System": "orchestration.system.system",
    "read_checkpoint": "orchestration.master.checkpoint",
    "simulate": "orchestration.master",
}


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
