"""The tables of docs/explanation/identification.md and its figure, made from the results of the study."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from orchestration.results.figures import BLUE, GREY, ORANGE, figure_style, panel_grid, write_figure
from orchestration.results.formats import FigureFormat
from orchestration.study.open_numbers import FREE, FREQUENCY, HALF_A_DIGIT, VALUES, Columns
from orchestration.study.vehicle_runs import SEEDS

_NAMES = {
    "nominal-l1": "nominal, L1",
    "nominal-extended": "nominal, extended",
    "buoyancy-l1": "+0.2 N, L1",
    "buoyancy-extended": "+0.2 N, extended",
}
_LEAST_DRAWS = 10  # of which a range is given
_METRICS = {"settling_time": "settling time [s]", "rmse": "RMSE [cm]"}


def tables(document: Mapping[str, Any]) -> dict[str, str]:
    """Markdown tables by name."""
    return {
        "predictions": _predictions(document["variants"]),
        "gains": _gains(document["variants"]),
        "fits": _fits(document["fits"]),
        "left out": _left_out(document["fits"]),
        "one seed": _one_seed(document["one_seed"]),
        "effects": _effects(document["effects"]),
    }


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


def _range(five: Sequence[float]) -> str:
    return f"{five[1]:.2g} to {five[3]:.2g}" if five else "none"


def _predictions(variants: Mapping[str, Any]) -> str:
    changes = [(controller, metric) for metric in _METRICS for controller in ("l1", "extended")]
    head = ["agrees with the nominal row", *(f"{c}, {_METRICS[m]}" for c, m in changes), "fast", "draws"]
    published = [
        f"{VALUES[f'buoyancy-{c}', m] - VALUES[f'nominal-{c}', m]:+.2f}".rstrip("0").rstrip(".")
        for c, m in changes
    ]
    rows = [["published", *published, "", ""]]
    for name, variant in variants.items():
        share, draws = f"{100.0 * variant['fast_share']:.3g} %", variant["effective_draws"]
        fast_draws = variant["fast_share"] * draws
        for kind, label in (("all", name), ("fast", "of these the fast ones")):
            ranges = [_range(variant[kind][f"change-{c} {m}"]) for c, m in changes]
            if kind == "all":
                rows.append([label, *ranges, share, f"{draws:.0f}"])
            elif fast_draws >= _LEAST_DRAWS:
                rows.append([label, *ranges, "", f"{fast_draws:.0f}"])
    return _table(head, rows)


def _gains(variants: Mapping[str, Any]) -> str:
    variant = next(iter(variants.values()))
    rows = []
    for free in FREE:
        if free.name != "plant.buoyancy_change":
            _, low, median, high, _ = variant["all"][free.name]
            ranges = f"{free.low:g} to {free.high:g}", f"{low:g} to {high:g}"
            rows.append(
                [f"`{free.name}` [{free.unit}]", *ranges, f"{median:g}", variant["narrowed"][free.name]]
            )
    return _table(["number", "range", "95 % of the points", "median", "narrowed to"], rows)


def _fits(fits: Mapping[str, Any]) -> str:
    rows = []
    for figure, value in VALUES.items():
        means = [fit["all"]["figures"][" ".join(figure)][0] for fit in fits.values()]
        rows.append([_label(figure), f"{value:g}", *(f"{mean:.4g}" for mean in means)])
    rows.append(["half the sum of squares", "", *(f"{fit['all']['cost']:g}" for fit in fits.values())])
    return _table([f"mean of {len(SEEDS)} seeds", "published", *fits], rows)


def _left_out(fits: Mapping[str, Any]) -> str:
    rows = []
    for figure, value in VALUES.items():
        predicted = [
            fit["left_out"][" ".join(figure)]["figures"][" ".join(figure)][0] for fit in fits.values()
        ]
        rows.append(
            [
                _label(figure),
                f"{value:g}",
                *(f"{x:.4g} ({100.0 * (x / value - 1.0):+.1f} %)" for x in predicted),
            ]
        )
    return _table(["figure left out", "published", *(f"predicted, {name}" for name in fits)], rows)


def _one_seed(fits: Mapping[str, Any]) -> str:
    rows = []
    for figure, value in VALUES.items():
        one = fits["seed 1"]["figures"][" ".join(figure)][0]
        _, low, high = fits["five seeds"]["figures"][" ".join(figure)]
        rows.append([_label(figure), f"{value:g}", f"{one:.4g}", f"{low:.4g} to {high:.4g}"])
    for name, label in _NAMES.items():
        spreads = [fits[seeds]["figures"][f"{name} hold_spread"] for seeds in fits]
        rows.append(
            [
                f"{label}: spread in hold [mm]",
                "",
                f"{spreads[0][0]:.3g}",
                f"{spreads[1][1]:.3g} to {spreads[1][2]:.3g}",
            ]
        )
    return _table(["", "published", "seed 1", f"seeds 1 to {len(SEEDS)}"], rows)


def _effects(effects: Sequence[Mapping[str, Any]]) -> str:
    figures = [figure for figure in VALUES if figure[0].startswith("buoyancy")]
    rows = [["published", "", *(f"{VALUES[figure]:g}" for figure in figures)]]
    for effect in effects:
        size = f"{effect['size']:.3g} {effect['unit']}" + ("" if effect["reached"] else ", not enough")
        rows.append([effect["effect"], size, *(f"{effect[' '.join(figure)]:.4g}" for figure in figures)])
    return _table(["in the run with +0.2 N", "needed", *map(_label, figures)], rows)


def _label(figure: tuple[str, str]) -> str:
    return f"{_NAMES[figure[0]]}: {_METRICS[figure[1]]}"


def write_points(sets: Mapping[str, Columns], path: Path, formats: Sequence[FigureFormat]) -> list[Path]:
    """The figure of the points of some variants: what they predict, and what they are."""
    with figure_style():
        figure, panels = panel_grid(2, 2, 2.6)
        for (name, points), colour in zip(sets.items(), (BLUE, ORANGE), strict=True):
            rows = _representative(points, 1000)
            dots: dict[str, Any] = {"s": 3.0, "linewidths": 0.0, "color": colour, "alpha": 0.5, "label": name}
            for panel, (x, y) in zip(panels, _PANELS, strict=True):
                panel.scatter(points[x][rows], points[y][rows], **dots)
        for panel, (x, y) in zip(panels, _PANELS, strict=True):
            panel.set_xlabel(_axis(x))
            panel.set_ylabel(_axis(y))
            _mark_published(panel, x, y)
            if _is_logarithmic(x):
                panel.set_xscale("log")
            if _is_logarithmic(y):
                panel.set_yscale("log")
            if x in _LIMITS:
                panel.set_xlim(_LIMITS[x])
            if y in _LIMITS:
                panel.set_ylim(_LIMITS[y])
        panels[0].legend(loc="lower right", markerscale=2.0)
        return write_figure(figure, path, formats)


def _representative(points: Columns, count: int) -> np.ndarray:
    """The rows of so many points, drawn as often as their density says, some of them twice."""
    share = points["density"] / np.sum(points["density"])
    return np.random.default_rng(3).choice(len(share), size=count, p=share)


# what is beyond does not settle, or hardly
_LIMITS = {
    "buoyancy-l1 rmse": (12.0, 18.0),
    "buoyancy-extended rmse": (4.2, 6.4),
    "buoyancy-l1 settling_time": (60.0, 90.0),
    "buoyancy-extended settling_time": (42.0, 50.0),
}
_PANELS = (
    ("buoyancy-l1 rmse", "buoyancy-extended rmse"),
    ("buoyancy-l1 settling_time", "buoyancy-extended settling_time"),
    (FREQUENCY, "buoyancy-l1 rmse"),
    ("controller.filter_bandwidth", "controller.rate_feedback_gain"),
)


def _axis(name: str) -> str:
    scenario, _, metric = name.partition(" ")
    if metric:
        return f"{_NAMES[scenario]}: {_METRICS[metric]}"
    (free,) = (free for free in FREE if free.name == name)
    return f"{name.rpartition('.')[2].replace('_', ' ')} [{free.unit}]"


def _is_logarithmic(name: str) -> bool:
    return any(free.logarithmic for free in FREE if free.name == name)


def _mark_published(panel: Any, x: str, y: str) -> None:
    """The printed figures with what rounding can hide, as a point with bars or as a line."""
    across, up = _figure_named(x), _figure_named(y)
    if across and up:
        bars: dict[str, Any] = {"xerr": HALF_A_DIGIT[across], "yerr": HALF_A_DIGIT[up], "capsize": 3.0}
        point: dict[str, Any] = {"fmt": "o", "color": "black", "markersize": 3.0, "label": "published"}
        panel.errorbar(VALUES[across], VALUES[up], **bars, **point)
    elif up:
        panel.axhline(VALUES[up], color=GREY, linestyle="--")


def _figure_named(name: str) -> tuple[str, str] | None:
    scenario, _, metric = name.partition(" ")
    return (scenario, metric) if metric else None
