"""The tables of docs/explanation/identification.md and its figure, made from the results of the study."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import NullFormatter
from vehicle import BY_NAME, CHANGE, FREE, FREQUENCY, SEEDS, VALUES, Columns, Figure, half_a_digit

_NAMES = {
    "nominal-l1": "nominal, L1",
    "nominal-extended": "nominal, extended",
    "buoyancy-l1": "+0.2 N, L1",
    "buoyancy-extended": "+0.2 N, extended",
}
_METRICS = {"settling_time": "settling time [s]", "rmse": "RMSE [cm]"}
_LEAST_DRAWS = 10  # of which a range is given


def tables(document: Mapping[str, Any]) -> dict[str, str]:
    """Returns Markdown tables by name."""
    fits = document["fits"]
    return {
        "predictions": _predictions(document["variants"]),
        "gains": _gains(next(iter(document["variants"].values()))),
        "fits": _fits(fits),
        "left out": _left_out(fits),
        "one seed": _one_seed(document["one_seed"]),
        "effects": _effects(document["effects"]),
        "mechanisms": _mechanisms(document["mechanisms"]),
        "measurements": _measurements(document["mechanisms"]),
    }


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


def _label(figure: Figure) -> str:
    return f"{_NAMES[figure[0]]}: {_METRICS[figure[1]]}"


def _range(five: Sequence[float]) -> str:
    return f"{five[1]:.2g} to {five[3]:.2g}" if five else "none"


def _predictions(variants: Mapping[str, Any]) -> str:
    changes = [(controller, metric) for metric in _METRICS for controller in ("l1", "extended")]
    head = ["agrees with the nominal row", *(f"{c}, {_METRICS[m]}" for c, m in changes), "fast", "draws"]
    published = [f"{VALUES[f'buoyancy-{c}', m] - VALUES[f'nominal-{c}', m]:+.3g}" for c, m in changes]
    rows = [["published", *published, "", ""]]
    for name, variant in variants.items():
        ranges = {
            kind: [_range(variant[kind][f"change-{c} {m}"]) for c, m in changes] for kind in ("all", "fast")
        }
        share, draws = variant["fast_share"], variant["effective_draws"]
        rows.append([name, *ranges["all"], f"{100.0 * share:.3g} %", f"{draws:.0f}"])
        if share * draws >= _LEAST_DRAWS:
            rows.append(["of these the fast ones", *ranges["fast"], "", f"{share * draws:.0f}"])
    return _table(head, rows)


def _gains(variant: Mapping[str, Any]) -> str:
    rows = []
    for free in (free for free in FREE if free.name != CHANGE):
        _, low, median, high, _ = variant["all"][free.name]
        ranges = f"{free.low:g} to {free.high:g}", f"{low:g} to {high:g}", f"{median:g}"
        rows.append([f"`{free.name}` [{free.unit}]", *ranges, variant["narrowed"][free.name]])
    return _table(["number", "range", "95 % of the points", "median", "narrowed to"], rows)


def _fits(fits: Mapping[str, Any]) -> str:
    ends = [fit["all"] for fit in fits.values()]
    rows = [
        [_label(figure), f"{value:g}", *(f"{end['figures'][' '.join(figure)][0]:.4g}" for end in ends)]
        for figure, value in VALUES.items()
    ]
    rows.append(["half the sum of squares", "", *(f"{end['cost']:g}" for end in ends)])
    return _table([f"mean of {len(SEEDS)} seeds", "published", *fits], rows)


def _left_out(fits: Mapping[str, Any]) -> str:
    rows = []
    for figure, value in VALUES.items():
        name = " ".join(figure)
        predicted = [fit["left_out"][name]["figures"][name][0] for fit in fits.values()]
        cells = [f"{x:.4g} ({100.0 * (x / value - 1.0):+.1f} %)" for x in predicted]
        rows.append([_label(figure), f"{value:g}", *cells])
    return _table(["figure left out", "published", *(f"predicted, {name}" for name in fits)], rows)


def _one_seed(ends: Mapping[str, Any]) -> str:
    one, five = (ends[name]["figures"] for name in ("seed 1", "five seeds"))
    rows = []
    for figure, value in VALUES.items():
        name = " ".join(figure)
        rows.append(
            [_label(figure), f"{value:g}", f"{one[name][0]:.4g}", "{1:.4g} to {2:.4g}".format(*five[name])]
        )
    for scenario, label in _NAMES.items():
        name = f"{scenario} hold_spread"
        cells = f"{one[name][0]:.3g}", "{1:.3g} to {2:.3g}".format(*five[name])
        rows.append([f"{label}: spread in hold [mm]", "", *cells])
    return _table(["", "published", "seed 1", f"seeds 1 to {len(SEEDS)}"], rows)


def _effects(effects: Sequence[Mapping[str, Any]]) -> str:
    figures = [figure for figure in VALUES if figure[0].startswith("buoyancy")]
    rows = [["published", "", *(f"{VALUES[figure]:g}" for figure in figures)]]
    for effect in effects:
        size = f"{effect['size']:.3g} {effect['unit']}" + ("" if effect["reached"] else ", not enough")
        rows.append([effect["effect"], size, *(f"{effect[' '.join(figure)]:.4g}" for figure in figures)])
    return _table(["in the run with +0.2 N", "needed", *map(_label, figures)], rows)


def _mechanisms(mechanisms: Mapping[str, Any]) -> str:
    rows = []
    for name, one in mechanisms.items():
        largest = max(abs(one["figures"][m][s] / value - 1.0) for (s, m), value in VALUES.items())
        cells = f"{100.0 * largest:.1f} %", f"{min(one['costs']):.1f}", f"{one['log_share']:.1f}"
        rows.append([name, *cells, f"{one['log_evidence']:.1f}"])
    head = ["mechanism", "largest deviation", "half the sum of squares", "log of the share"]
    return _table([*head, "log of the evidence"], rows)


def _measurements(mechanisms: Mapping[str, Any]) -> str:
    rows = []
    for name, one in mechanisms.items():
        figures, half = one["figures"], one["with half of the added buoyancy"]["rmse"]
        rmse, hold, early = (figures[metric] for metric in ("rmse", "hold at 0.4 m", "first 10 s"))
        change, of_half = (r["buoyancy-l1"] - r["nominal-l1"] for r in (rmse, half))
        holds = (f"{hold[f'buoyancy-{law}']:.0f}" for law in ("l1", "extended"))
        first = early["buoyancy-extended"] - early["nominal-extended"]
        rows.append([name, *holds, f"{first:.0f}", f"{100.0 * of_half / change:.0f} %"])
    columns = ["hold at 0.4 m, L1 [mm]", "the same, extended [mm]", "first 10 s, extended [mm]"]
    return _table(["+0.2 N", *columns, "share of the change of RMSE at +0.1 N, L1"], rows)


# across and up; limits beyond which a run does not settle, or hardly
_PANELS = (
    ("buoyancy-l1 rmse", (12.0, 18.0), "buoyancy-extended rmse", (4.2, 6.4)),
    ("buoyancy-l1 settling_time", (60.0, 90.0), "buoyancy-extended settling_time", (42.0, 50.0)),
    (FREQUENCY, (0.1, 6.0), "buoyancy-l1 rmse", (12.0, 18.0)),
    ("controller.filter_bandwidth", (0.05, 2.0), "controller.rate_feedback_gain", (0.5, 30.0)),
)


def write_points(sets: Mapping[str, Columns], path: Path) -> None:
    """Writes the figure of the points of some variants: what they predict, and what they are."""
    figure, panels = plt.subplots(2, 2, figsize=(7.2, 6.4), layout="constrained")
    for letter, panel, (x, across, y, up) in zip("abcd", panels.flat, _PANELS, strict=True):
        for name, points in sets.items():
            # a thousand points, drawn as often as their density tells, some of them twice
            share = points["density"] / np.sum(points["density"])
            rows = np.random.default_rng(3).choice(len(share), size=1000, p=share)
            panel.scatter(points[x][rows], points[y][rows], s=3.0, linewidths=0.0, alpha=0.5, label=name)
        scales = {f"{axis}scale": "log" for axis, name in (("x", x), ("y", y)) if name in BY_NAME}
        panel.set(xlabel=_axis(x), ylabel=_axis(y), xlim=across, ylim=up, **scales)
        # labels of minor ticks of a decade or two overlap
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.set_title(f"({letter})", loc="left", fontweight="bold")
        _mark_published(panel, x, y)
    figure.legend(
        *panels.flat[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, markerscale=2.0
    )
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _axis(name: str) -> str:
    if name in BY_NAME:
        return f"{name.rpartition('.')[2].replace('_', ' ')} [{BY_NAME[name].unit}]"
    scenario, _, metric = name.partition(" ")
    return _label((scenario, metric)).replace(": ", ":\n")  # longer than a panel is high


def _mark_published(panel: Any, x: str, y: str) -> None:
    """Marks the printed figures with what rounding can hide, as a point with bars or as a line."""
    across, up = (tuple(name.split(" ")) for name in (x, y))
    if across in VALUES and up in VALUES:
        bars = {"xerr": half_a_digit(across), "yerr": half_a_digit(up), "capsize": 3.0}
        panel.errorbar(
            VALUES[across], VALUES[up], fmt="o", color="black", markersize=3.0, label="published", **bars
        )
    elif up in VALUES:
        panel.axhline(VALUES[up], color="grey", linestyle="--")
