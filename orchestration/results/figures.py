"""Tables, figures and the summary of a reproduction. The only room that imports a plotting library."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from rich.markup import escape
from rich.table import Table

from orchestration.results.recording import Recording
from orchestration.scenarios.published import PUBLISHED

mpl.use("Agg")
mpl.rcParams["svg.hashsalt"] = "l1-depth"  # the same figure is the same file
import matplotlib.pyplot as plt  # noqa: E402  (the backend is chosen first)

_CONTROLLERS = {"l1": ("L1", "--"), "extended": ("extended L1", "-")}
_CASES = {"nominal": ("nominal", "--"), "buoyancy": ("buoyancy +0.2 N", "-")}
_FORMATS = {"png": {"Software": None}, "svg": {"Date": None}}

Measured = Mapping[str, Mapping[str, float]]
Recordings = Mapping[str, Recording]


def summary(measured: Measured) -> dict[str, dict[str, dict[str, float]]]:
    """{case: {controller: metrics}} of the paper's experiments."""
    return {
        case: {controller: dict(measured[f"{case}-{controller}"]) for controller in _CONTROLLERS}
        for case in ("nominal", "buoyancy", "example")
    }


def comparison_table(measured: Measured) -> Table:
    """Every published figure beside ours, with the deviation."""
    table = Table(title="Published and reproduced", title_justify="left")
    for heading in ("Source", "Case", "Controller", "Figure"):
        table.add_column(heading)
    for heading in ("Reference", "Ours", "Deviation", "in %"):
        table.add_column(heading, justify="right")
    table.add_column("Ours is")
    before = None
    for figure in PUBLISHED:
        ours = measured[figure.scenario][figure.metric]
        deviation = ours - figure.value
        if before not in (None, figure.where):
            table.add_section()
        before = figure.where
        table.add_row(
            figure.where,
            figure.case,
            _CONTROLLERS[figure.controller][0],
            escape(figure.label),
            f"{figure.value:.4g}",
            f"{ours:.4g}",
            f"{deviation:+.2g}",
            f"{100.0 * deviation / figure.value:+.1f}",
            figure.status,
        )
    return table


def metrics_table(title: str, measured: Mapping[str, float]) -> Table:
    """The metrics of one run."""
    table = Table(title=escape(title), title_justify="left")
    table.add_column("Metric")
    table.add_column("Value", justify="right")
    for name, value in measured.items():
        table.add_row(escape(name), f"{value:.5g}")
    return table


def figure_3(recordings: Recordings, path: Path) -> list[Path]:
    """The illustrative example: both controllers against the reference, and their errors."""
    figure, (outputs, errors) = plt.subplots(2, 1, sharex=True, figsize=(10, 6), layout="constrained")
    plain = recordings["example-l1"]
    reference = plain["controller.reference"]
    for controller, (label, line) in _CONTROLLERS.items():
        run = recordings[f"example-{controller}"]
        outputs.plot(run.time, run["plant.output"], line, label=label)
        errors.plot(run.time, run["plant.output"] - reference, line, label=label)
    outputs.plot(plain.time, reference, "r:", label="reference")
    outputs.set_ylabel("output y [1]")
    errors.set_ylabel("tracking error e = y - r [1]")
    errors.set_xlabel("time [s]")
    return _finish(figure, "Illustrative example (paper: Fig. 3)", [outputs, errors], path)


def figure_5(recordings: Recordings, path: Path) -> list[Path]:
    """Nominal conditions: plain and extended L1."""
    runs = {label: (recordings[f"nominal-{c}"], line) for c, (label, line) in _CONTROLLERS.items()}
    return _vehicle_figure("Nominal conditions (paper: Fig. 5)", runs, path)


def figure_6(recordings: Recordings, path: Path) -> list[Path]:
    """Extended L1 with and without the added buoyancy."""
    runs = {label: (recordings[f"{c}-extended"], line) for c, (label, line) in _CASES.items()}
    return _vehicle_figure("Extended L1, change of buoyancy (paper: Fig. 6)", runs, path)


def run_figure(title: str, recording: Recording, path: Path) -> list[Path]:
    """Every signal of any run, those of one unit together."""
    units = list(dict.fromkeys(recording.units))
    figure, axes = plt.subplots(
        len(units), 1, sharex=True, squeeze=False, figsize=(10, 2.5 * len(units)), layout="constrained"
    )
    for unit, axis in zip(units, axes[:, 0], strict=True):
        names = [n for n, u in zip(recording.names, recording.units, strict=True) if u == unit]
        for name in sorted(names, key=_roughness(recording), reverse=True):  # smooth ones on top
            axis.plot(recording.time, recording[name], label=name, linewidth=0.8)
        axis.set_ylabel(f"[{unit or '1'}]")
    axes[-1, 0].set_xlabel("time [s]")
    return _finish(figure, title, list(axes[:, 0]), path)


def _roughness(recording: Recording) -> Callable[[str], float]:
    return lambda name: float(np.abs(np.diff(recording[name])).sum())


def _vehicle_figure(title: str, runs: Mapping[str, tuple[Recording, str]], path: Path) -> list[Path]:
    figure, axes = plt.subplots(4, 1, sharex=True, figsize=(10, 10), layout="constrained")
    depth, force, theta, sigma = axes
    for label, (run, line) in runs.items():
        depth.plot(run.time, run["plant.depth"], line, label=label)
        force.plot(run.time, run["plant.total_force"], line, label=label, linewidth=0.7)
        theta.plot(run.time, run["controller.theta_hat[1]"], line, label=label, linewidth=0.7)
        sigma.plot(run.time, run["controller.sigma_hat"], line, label=label, linewidth=0.7)
    first, _ = next(iter(runs.values()))
    depth.plot(first.time, first["controller.depth_reference"], "r:", label="reference")
    depth.invert_yaxis()
    depth.set_ylabel("depth z [m], down")
    force.set_ylabel("thrust [N], down")
    theta.set_ylabel(r"$\hat\theta$ [N]")
    sigma.set_ylabel(r"$\hat\sigma$ [N]")
    sigma.set_xlabel("time [s]")
    return _finish(figure, title, list(axes), path)


def _finish(figure: Any, title: str, axes: list[Any], path: Path) -> list[Path]:
    figure.suptitle(title)
    for axis in axes:
        axis.grid(alpha=0.3)
        axis.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    path.parent.mkdir(parents=True, exist_ok=True)
    written = []
    for extension, metadata in _FORMATS.items():
        file = path.with_name(f"{path.name}.{extension}")
        figure.savefig(file, dpi=150, metadata=metadata)
        written.append(file)
    plt.close(figure)
    return written
