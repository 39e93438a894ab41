"""The vehicle's depth loop as one continuous system without noise, for many sets of gains at once.

    M v' = u - F + c max(-z, 0) - (D + D_q |v|) v,   z' = v,   u = -k_z y - k_v v + u_a + u_p,   y = z - a v
    x_tilde'   = A_m x_tilde + (0, (eta + u_a + u_p) / M_d - c_1 y - c_2 v - v'),   eta = theta phi + sigma
    sigma'     = Gamma Proj(sigma, -s),   theta' = Gamma Proj(theta, -s phi),   s = x_tilde' P B_m
    u_a'       = -w (u_a + eta - k_z r),   u_p = -K_P e - K_I int e,   e = y - r,   phi = max(|y|, |v|)

F is B - W, c the stiffness of the free surface, A_m = [[0, 1], [-c_1, -c_2]], M_d the inertia that the design
assumes. Of the sensor there is the mean age a of a sample alone; observer, noise, thruster lag and saturation
are left out; `l1-depth identifiability` states the error against runs of the FMUs. The equations are written
anew, from the paper and not from the blocks, and solved in depth_loop_model.c (compiled at its first use).

Source: Maalouf et al. (2013), (1) to (7) and (10) to (15); Hovakimyan and Cao (2010) for Proj and P.
"""

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fmus import compiled_library
from fmus.user_cache import cache_folder
from orchestration.scenarios import scenario
from orchestration.system.prepared_run import prepare, values_of
from orchestration.system.signals import values_at

Values = Mapping[str, np.ndarray | float]
"""Name of a variable, "component.variable" -> its values, one for each run, or one for all."""

STEP = 0.2  # s, for modes below 10 rad/s

VARIABLES = (
    "plant.inertia",
    "plant.linear_damping",
    "plant.quadratic_damping",
    "plant.net_weight",
    "plant.buoyancy_change",
    "plant.initial_depth",
    "controller.model_inertia",
    "controller.model_damping",
    "controller.depth_feedback_gain",
    "controller.rate_feedback_gain",
    "controller.filter_bandwidth",
    "controller.adaptation_gain",
    "controller.sigma_bound",
    "controller.theta_bound[1]",
    "controller.proportional_gain",
    "controller.integral_gain",
)
"""Every variable of the model, in the order of depth_loop_model.c."""


@cache
def shipped_values(name: str = "nominal-l1") -> Mapping[str, float]:
    """The variables of plant and controller in a shipped scenario; without the extension the PI is 0."""
    loaded = scenario.load(scenario.find(name))
    prepared = prepare(loaded.system, loaded.experiment)
    values = {
        f"{component}.{variable}": value
        for component in ("plant", "controller")
        for variable, value in values_of(prepared, component).items()
    }
    if values["controller.augmentation"] != "pi":
        values |= {"controller.proportional_gain": 0.0, "controller.integral_gain": 0.0}
    return values


@dataclass(frozen=True)
class DepthTask:
    """What the vehicle is to do and how it is judged.

    reference: r [m] at 0, h/2, h, ... of `step` h [s]; settling: target, band [m] and end of the window [s]
    """

    reference: np.ndarray
    step: float
    target: float
    band: float
    window_end: float


@cache
def depth_task(name: str = "nominal-extended", step: float = STEP) -> DepthTask:
    """That of a shipped scenario of the vehicle."""
    loaded = scenario.load(scenario.find(name))
    count = round(loaded.experiment.stop_time / step)
    times = 0.5 * step * np.arange(2 * count + 1)
    reference = values_at(loaded.experiment.signals["controller.depth_reference"], times)
    settling = loaded.metrics["settling_time"]
    return DepthTask(reference, step, settling["target"], settling["band"], settling["window"][1])


def adaptation_vector(values: Values) -> tuple[np.ndarray, np.ndarray]:
    """P B_m of A_m' P + P A_m = -I, for the A_m that the gains give."""
    inertia = np.asarray(values["controller.model_inertia"])
    c_1 = values["controller.depth_feedback_gain"] / inertia
    c_2 = (values["controller.model_damping"] + values["controller.rate_feedback_gain"]) / inertia
    return 0.5 / c_1 / inertia, 0.5 * (1.0 + 1.0 / c_1) / c_2 / inertia


def figures(task: DepthTask, values: Values) -> dict[str, np.ndarray]:
    """Settling time [s], RMSE [cm] and overshoot [%] of every run, as the scenarios define them.

    values: what differs from the shipped scenario of plain L1
    A run that does not settle has not a number there; one that diverges has it everywhere.
    """
    given = {**shipped_values(), **values}
    columns = np.broadcast_arrays(*(np.atleast_1d(np.asarray(given[name], np.float32)) for name in VARIABLES))
    table = dict(zip(VARIABLES, columns, strict=True))
    table["plant.buoyancy_change"] = table["plant.buoyancy_change"] - table.pop("plant.net_weight")
    rows = np.ascontiguousarray(list(table.values()), np.float32)
    measured = np.empty((3, rows.shape[1]))
    reference = np.ascontiguousarray(task.reference, np.float32)
    settings = _Task(
        task.step, task.target, task.band, task.window_end, reference.ctypes.data, len(reference) // 2
    )
    _library().depth_loop_runs(
        ctypes.byref(settings),
        ctypes.c_int64(rows.shape[1]),
        ctypes.c_void_p(rows.ctypes.data),
        ctypes.c_void_p(measured.ctypes.data),
    )
    settled, rmse, deepest = measured
    overshoot = 100.0 * np.maximum(deepest - task.target, 0.0) / task.target
    return {"settling_time": settled, "rmse": 100.0 * rmse, "overshoot": overshoot}


class _Task(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_double) for name in ("step", "target", "band", "window_end")),
        ("reference", ctypes.c_void_p),
        ("steps", ctypes.c_int64),
    )


@cache
def _library() -> ctypes.CDLL:
    source = Path(__file__).with_suffix(".c")
    return compiled_library.load(source, cache_folder("libraries"))
