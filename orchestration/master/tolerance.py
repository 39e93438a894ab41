"""The error that a run with a tolerance may have, and which outputs it is estimated from."""

from dataclasses import dataclass

import numpy as np

from orchestration.master.wiring import NamedWiring
from orchestration.system.prepared_run import PreparedRun


@dataclass(frozen=True)
class Tolerance:
    """The permitted error, relative to max(|value|, nominal).

    order: of the exchange in the step size; duration: of the run [s]
    bus_index, nominal: of the outputs from which the error is estimated, shape (m,)
    has_feedthrough: whether the output may depend directly on an input, shape (m,). The error of such an
    output does not add up from step to step: it is compared with the whole tolerance.
    """

    relative: float
    order: int
    duration: float
    bus_index: np.ndarray
    nominal: np.ndarray
    has_feedthrough: np.ndarray

    def error_ratio(self, coarse: np.ndarray, fine: np.ndarray, size: float) -> float:
        """Estimated error of the fine values over the permitted error of a step of `size` [s].

        A step is accepted up to a ratio of 1. A value that is not finite in both is left out.
        """
        share = np.where(self.has_feedthrough, 1.0, size / self.duration)
        scale = self.relative * np.maximum(np.abs(fine), self.nominal) * share
        with np.errstate(invalid="ignore"):
            ratio = np.abs(fine - coarse) / (2.0**self.order - 1.0) / scale
        ratio[~(np.isfinite(coarse) | np.isfinite(fine))] = 0.0
        ratio[np.isnan(ratio)] = np.inf
        return float(np.max(ratio, initial=0.0))


def tolerance_of(prepared: PreparedRun, named: NamedWiring) -> Tolerance | None:
    """The tolerance of a run, if it has one, for all Real outputs that are exchanged or recorded."""
    experiment, ports = prepared.experiment, prepared.system.ports
    if not experiment.tolerance:
        return None
    exchanged = {name for group in named.bus.outputs if group.type == "Real" for name in group.names}
    names = [name for name in ports if name in exchanged]
    nominal = [abs(float(ports[name].variable.nominal or 1.0)) for name in names]
    driven = {target for _, target in named.bus.connections}
    return Tolerance(
        relative=experiment.tolerance,
        order=1 + experiment.extrapolation,
        duration=experiment.stop_time - experiment.start_time,
        bus_index=np.array([named.bus.index[name] for name in names], np.int64),
        nominal=np.array(nominal),
        has_feedthrough=np.array([_has_feedthrough(prepared, name, driven) for name in names], bool),
    )


def _has_feedthrough(prepared: PreparedRun, output: str, driven: set[str]) -> bool:
    """Whether an output may depend directly on a driven input in step mode; true if not declared."""
    port = prepared.system.ports[output]
    for unknown in prepared.system.descriptions[port.component].outputs:
        if unknown.variable is port.variable and unknown.dependencies is not None:
            return any(f"{port.component}.{variable.name}" in driven for variable in unknown.dependencies)
    return any(name.startswith(f"{port.component}.") for name in driven)
