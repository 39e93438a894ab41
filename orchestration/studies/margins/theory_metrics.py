"""The metrics that follow from the design of an L1 controller: L1-norm condition and linear margins."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from controller_fmu.design import (
    NO_EXTENSION,
    Extension,
    l1_condition,
    lyapunov_matrix,
    proportional_gain_range,
    smallest_bandwidth,
)
from orchestration.run.simulator import Simulator
from orchestration.scenarios.scenario import Scenario
from orchestration.studies.margins.code_loop import CodeLoop
from orchestration.studies.margins.fmu_margins import DELAYS, GAINS, Metric, search
from orchestration.studies.margins.l1_design import Design
from orchestration.studies.margins.l1_loop import Law, Plant, loop
from orchestration.studies.margins.linear_margins import margins
from orchestration.system.signals import Constant

CONDITION, LINEAR = "L1-norm condition", "linear loop"
_BOOK = "Hovakimyan and Cao (2010)"
_EXTENDED = "derived in docs/explanation/margins.md; not in the paper"
_NYQUIST = "frequency response of the linear loop; limit after Hovakimyan and Cao (2010)"
# input gains tried over their box: the norm need not be monotonic in omega
_OMEGAS = 9


def design_metrics(design: Design, gains: Sequence[float]) -> Iterator[Metric]:
    """Yields the metrics of the design alone; gains: of the adaptation, for the delay margin."""
    yield from norm_metrics(design)
    yield from linear_metrics(design)
    if design.has_gain and design.has_rest:
        yield from gamma_metrics(design, gains)
    if design.has_gain:
        yield from bound_metric(design)


def norm_metrics(design: Design) -> Iterator[Metric]:
    """Yields |G|_L1 L with and without the extension, and where the condition is lost."""
    law = design.law
    omegas = np.unique(np.linspace(*design.omegas, _OMEGAS)).tolist()
    box = f"omega in {omegas[0]:g}..{omegas[-1]:g}, " + (f"{len(omegas)} values; " if omegas[1:] else "")
    state = f"{box}L = {design.lipschitz:g}, perfect measurement, no delay and no lag; it holds below 1"
    common = np.array(law.a_m), np.array(law.b), law.filter_order, law.bandwidth, design.lipschitz

    def condition(name: str, extension: Extension, assumption: str, source: str) -> Metric:
        value = _or_none(l1_condition, *common, extension, omegas)
        return Metric(CONDITION, name, value, "1", assumption, source)

    yield condition("norm of G times L, without the extension", NO_EXTENSION, state, _BOOK)
    for gain in design.frozen_gains:
        frozen = Extension(law.c, gain)
        name = f"norm of G times L, nonlinear P frozen at {gain:.4g}"
        yield condition(name, frozen, f"{state}; a norm at a frozen gain is no guarantee", _EXTENDED)
    is_pi = bool(design.extension.proportional_gain or design.extension.integral_gain)
    bandwidths = {"without": (NO_EXTENSION, _BOOK)}
    if is_pi and not design.frozen_gains:
        bandwidths["with"] = design.extension, _EXTENDED
        yield condition("norm of G times L, with the extension", design.extension, state, _EXTENDED)
    extension = replace(design.extension, proportional_gain=0.0) if is_pi else Extension(law.c)
    least, largest = proportional_gain_range(*common, extension, omegas)
    note = "of a linear P in place of the nonlinear one; " if design.frozen_gains else ""
    note += "K_I as it is, up to 1e4 k_g" if extension.integral_gain else "K_I = 0, up to 1e4 k_g"
    if least > 0.0:
        yield Metric(CONDITION, "K_P from which it holds", least, design.gain_unit, state, _EXTENDED, note)
    yield Metric(CONDITION, "K_P up to which it holds", largest, design.gain_unit, state, _EXTENDED, note)
    a_m, b, order, _, lipschitz = common
    for label, (chosen, source) in bandwidths.items():
        least = _or_none(smallest_bandwidth, a_m, b, order, lipschitz, extension=chosen, omegas=omegas)
        name = f"bandwidth from which it holds, {label} the extension"
        yield Metric(CONDITION, name, least, "rad/s", state, source)


def _or_none(function: Callable[..., float], *arguments: Any, **options: Any) -> float:
    """Returns the value; not a number for an unstable G, or where no bandwidth satisfies the condition."""
    try:
        return function(*arguments, **options)
    except ValueError:
        return math.nan


def linear_metrics(design: Design) -> Iterator[Metric]:
    """Yields the margins of the loop in the limit of fast adaptation, and at the adaptation gain."""
    for label, (law, plant, limit) in linear_loops(design).items():
        yield from _margins(label, law, plant, limit, bool(design.frozen_gains))


def linear_loops(design: Design) -> dict[str, tuple[Law, Plant, str]]:
    """Returns name -> law, plant and assumption of each linear loop; the last one leaves out least."""
    law, true_state = replace(design.law, kappa=math.inf), replace(design.law, kappa=math.inf, observer=None)
    lagging, prompt = design.plant, design.plant.without_lag()
    limit, has_lag = "limit of fast adaptation", lagging != prompt
    loops = {"ideal": (true_state, prompt, limit)}
    if has_lag:
        loops["thruster lag"] = true_state, lagging, limit
    if law.observer:
        loops["observer"] = law, prompt, limit
    if law.observer and has_lag:
        loops["lag and observer"] = law, lagging, limit
    if law.observer:
        sampled = replace(law, observer=replace(law.observer, sampled=True))
        loops["lag and sampled observer" if has_lag else "sampled observer"] = sampled, lagging, limit
    if design.has_rest:
        at_rest = f"kappa = {design.law.kappa:g} at rest, theta_hat = 0"
        loops["at this adaptation gain"] = design.law, lagging, at_rest
    return loops


def gamma_metrics(design: Design, gains: Sequence[float]) -> Iterator[Metric]:
    """Yields the delay margin of the linear loop against the adaptation gain."""
    for gain in gains:
        law = replace(design.law, kappa=design.law.kappa * gain / design.adaptation_gain)
        at_rest = f"adaptation_gain = {gain:g}"
        first, *_ = _margins(at_rest, law, design.plant, "at rest, theta_hat = 0", bool(design.frozen_gains))
        yield first


def _margins(label: str, law: Law, plant: Plant, limit: str, frozen: bool) -> Iterator[Metric]:
    """Yields the margins of one loop; delays of the control and of every measurement give the same poles."""
    known = "true state"
    if law.observer:
        known = f"{'bilinear' if law.observer.sampled else 'continuous'} equivalent of the observer"
    known += f"; nonlinear P linear about e = 0, gain {law.proportional_gain:.4g}" if frozen else ""
    assumption = (
        f"{limit}; {known}; linear at rest, no quadratic damping, saturation, sampling or delay of the sensor"
    )
    loop_margins = margins(loop(law, plant))
    at = f"lost at {loop_margins.frequency:.3g} rad/s" if math.isfinite(loop_margins.delay) else ""
    yield Metric(LINEAR, f"delay margin, {label}", loop_margins.delay, "s", assumption, _NYQUIST, at)
    yield Metric(LINEAR, f"largest gain, {label}", loop_margins.high_gain, "1", assumption, _NYQUIST)
    yield Metric(LINEAR, f"smallest gain, {label}", loop_margins.low_gain, "1", assumption, _NYQUIST)


CODE = "linear loop of the code"
_FINE = 1e-4  # s, and of factors


def code_metrics(loop: CodeLoop) -> Iterator[Metric]:
    """Yields the margins of the loop as the blocks' code makes it."""
    assumption = "about the state after the hold, no noise; sampling, exchange and adaptation as in a run"
    delays = replace(DELAYS, largest=2.0, resolution=_FINE)
    gains = replace(GAINS, resolution=1.0 + _FINE)
    searches = {
        "delay margin": ("s", delays, lambda value: loop.is_stable(delay=value)),
        "largest gain": ("1", gains, lambda value: loop.is_stable(gain=value)),
        "smallest gain": (
            "1",
            replace(gains, largest=1.0 / gains.largest),
            lambda value: loop.is_stable(gain=value),
        ),
    }
    for name, (unit, grid, is_stable) in searches.items():
        margin, lost, _ = search(is_stable, grid, only_first_loss=True)
        # not lost up to the end of the grid, or nothing to lose
        value = margin if math.isfinite(lost) else math.inf
        yield Metric(
            CODE, f"{name} of the code", value, unit, f"{assumption}; up to {grid.largest:g}", "eigenvalues"
        )


TRANSIENT = "prediction error"
SIZES, STEPS, DURATION = (25.0, 100.0, 400.0), (1e-3, 2e-4, 2e-5), 4.0  # of the reference; s; s
_BOUND = "Hovakimyan and Cao (2010): sqrt(4 max |theta|^2 / (lambda_min(P) Gamma))"
_ERRORS = ("prediction_error[1]", "prediction_error[2]")


def bound_metric(design: Design) -> Iterator[Metric]:
    """Yields the bound of |x_tilde|, for any reference: the gains of the law are constant in it."""
    law = design.law
    smallest = float(np.linalg.eigvalsh(lyapunov_matrix(np.array(law.a_m), np.diag(law.q))).min())
    value = math.sqrt(4.0 * design.largest_parameters / (smallest * design.adaptation_gain))
    assumption = "continuous law, true state, constant theta and sigma within their bounds, no saturation"
    yield Metric(TRANSIENT, "bound of the prediction error", value, "", assumption, _BOUND)


def step_metrics(chosen: Scenario, progress: Callable[[], object]) -> Iterator[Metric]:
    """Yields max |x_tilde| after steps of the reference, for three step sizes, if it is an output."""
    (metric,) = [m for m in chosen.metrics.values() if m.get("reference")][:1] or [{}]
    reference = str(metric.get("reference", ""))
    if not reference.endswith(".reference"):  # of L1Controller, whose prediction errors are outputs
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
                yield Metric(TRANSIENT, name, largest, "", assumption, "measured")
