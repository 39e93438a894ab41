"""The prediction error of the L1 law after steps of the reference: its bound, and runs that show it."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from controller_fmu.design import lyapunov_matrix
from orchestration.margins.l1_design import Design
from orchestration.margins.margin_figure import Figure
from orchestration.run.simulator import Simulator
from orchestration.scenarios.scenario import Scenario
from orchestration.system.signals import Constant

TRANSIENT = "prediction error"
SIZES, STEPS, DURATION = (25.0, 100.0, 400.0), (1e-3, 2e-4, 2e-5), 4.0  # of the reference; s; s
RUNS = len(SIZES) * len(STEPS)
_BOOK = "Hovakimyan and Cao (2010): sqrt(4 max |theta|^2 / (lambda_min(P) Gamma))"
_ERRORS = ("prediction_error[1]", "prediction_error[2]")


def bound_figure(design: Design) -> Iterator[Figure]:
    """What |x_tilde| never exceeds, whatever the reference: the gains of the law are constant in it."""
    law = design.law
    smallest = float(np.linalg.eigvalsh(lyapunov_matrix(np.array(law.a_m), np.diag(law.q))).min())
    value = math.sqrt(4.0 * design.largest_parameters / (smallest * design.adaptation_gain))
    assumption = "continuous law, true state, constant theta and sigma within their bounds, no saturation"
    yield Figure(TRANSIENT, "bound of the prediction error", value, "", assumption, _BOOK)


def step_figures(chosen: Scenario, progress: Callable[[], object]) -> Iterator[Figure]:
    """max |x_tilde| after steps of the reference, for three step sizes; nothing where it is not an output."""
    (metric,) = [m for m in chosen.metrics.values() if m.get("reference")][:1] or [{}]
    reference = str(metric.get("reference", ""))
    if not reference.endswith(".reference"):  # that of L1Controller
        return
    errors = tuple(reference.removesuffix("reference") + name for name in _ERRORS)
    with Simulator(chosen.system) as simulator:
        for step in STEPS:
            for size in SIZES:
                experiment = replace(
                    chosen.experiment,
                    stop_time=DURATION,
                    step_size=step,
                    events=[],
                    signals={**chosen.experiment.signals, reference: Constant(size)},
                    record=errors,
                )
                recording = simulator.run(experiment)
                largest = float(max(np.abs(recording[name]).max() for name in errors))
                progress()
                assumption = f"from rest, over {DURATION:g} s, at communication points"
                name = f"largest, r = {size:g}, step {1e3 * step:g} ms"
                yield Figure(TRANSIENT, name, largest, "", assumption, "measured")
