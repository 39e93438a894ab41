"""The energy that exchanging values at communication points creates on a power bond.

A power bond is two outputs whose product is a power, such as a force and a velocity, each an input of the
other component. Between two points the one component uses u_e with its own flow, the other uses u_f with its
own effort; u is the other's last output, held or extrapolated. The powers differ by

    u_e(t) flow(t) - effort(t) u_f(t),

which no component delivers. This power enters the system if effort * flow is the power from the component of
the effort to the other, and leaves it if effort * flow has the other direction. Its integral over a step
assumes that effort and flow are lines between the points.

Source: S. Sadjina, L. T. Kyllingstad, S. Skjong, E. Pedersen, Energy conservation and power bonds in
co-simulations, Engineering with Computers 33 (2017), arXiv 1602.06434 (ECCO); its residual is the value at
the end of the step times the step.
"""

import numpy as np

from orchestration.errors import ScenarioError
from orchestration.results.recording import Recording


def energy_residuals(recording: Recording, effort: str, flow: str) -> np.ndarray:
    """Returns the energy that each step creates, in the unit of effort * flow * s, shape (points - 1,).

    effort, flow: outputs of two components, each an input of the other, connected without factors
    Raises ScenarioError for a recording without provenance, and for a run with faults, with steps between its
    points, or with step sizes other than the communication step.
    """
    _check(recording)
    size = np.diff(recording.time)
    e, f = recording[effort], recording[flow]
    first = _is_first(recording, effort, flow)
    u_e = _given(recording, e, size, is_new=first)
    u_f = _given(recording, f, size, is_new=first is False)
    return size * (_mean_product(*u_e, f[:-1], f[1:]) - _mean_product(*u_f, e[:-1], e[1:]))


def _is_first(recording: Recording, effort: str, flow: str) -> bool | None:
    """Whether the component of the effort steps before the other one; None if they step together."""
    if recording.provenance["algorithm"] == "jacobi":
        return None
    order = list(recording.provenance["fmus"])
    return order.index(effort.partition(".")[0]) < order.index(flow.partition(".")[0])


def _given(
    recording: Recording, output: np.ndarray, size: np.ndarray, is_new: bool | None
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the input of the other component at the start and at the end of each step.

    is_new: whether the output at the end of the step is known
    """
    start, end = output[:-1], output[1:]
    if recording.provenance["extrapolation"] == 0:
        return (end, end) if is_new else (start, start)
    if is_new:
        return start, end
    # the first step has no earlier output to extrapolate from: it is held
    slope = np.concatenate([[0.0], np.diff(output)[:-1] / size[:-1]])
    # as the loop does: for a step above twice the interval of the slope
    longest = 2.0 * np.concatenate([size[:1], size[:-1]])
    slope = np.where(size > longest, slope * longest / size, slope)
    return start, start + slope * size


def _mean_product(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Returns the mean of the product of a line from a to b and one from c to d."""
    return (2.0 * (a * c + b * d) + a * d + b * c) / 6.0


def _check(recording: Recording) -> None:
    if "algorithm" not in recording.provenance:
        raise ScenarioError("energy_residual: expected a recording with its provenance, as Parquet keeps it")
    for key in ("tolerance", "step_sizes_s", "steps_between_points", "faults"):
        if key in recording.provenance:
            raise ScenarioError(
                "energy_residual: expected a run with steps of one size and without faults, "
                f"got one with {key}"
            )
