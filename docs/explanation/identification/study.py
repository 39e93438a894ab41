"""What the paper's eight figures determine: the study of docs/explanation/identification.md.

    l1-depth build --cache
    python docs/explanation/identification/study.py identifiability

writes identification.json, tables.md, all-figures.toml and identification.png to that folder, after these
parts:

1  points that agree with the nominal row, for each variant of what the paper does not state, and what they
   predict for the row with added buoyancy
2  fits to all eight figures, and to seven, which predict the eighth
3  a fit to one seed of the noise that looks at nothing but the figures
4  effects that the run with added buoyancy would need if the gains were those that are shipped
5  mechanisms that explain the row with added buoyancy, weighed

The points, which take nearly all of the time, stay in points-N.npz and are read there when it runs again.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from fits import (
    EFFECTS,
    SHIPPED_RANGES,
    SHIPPED_START,
    SMALL_BOUNDS,
    SMALL_BOUNDS_START,
    WIDE,
    fits,
    needed,
    one_seed,
    tolerance,
)
from mechanisms import MECHANISMS, WINDOWS, weigh
from posterior import VARIANTS, Effort, posterior
from summary import nearest, summary
from tables import tables, write_points
from vehicle import BY_NAME, SEEDS, Columns, Vehicle, variables


def study(folder: Path, effort: Effort | None = None) -> dict[str, Any]:
    """Computes all parts; writes their results to the folder and returns them."""
    folder.mkdir(parents=True, exist_ok=True)
    sets = {variant.name: points_of(i, folder, effort or Effort()) for i, variant in enumerate(VARIANTS)}
    first = sets[VARIANTS[0].name]
    with (
        Vehicle() as vehicle,
        Vehicle(noise=False) as exact,
        Vehicle(noise=False, windows=WINDOWS) as windowed,
    ):
        document = {
            "variants": {name: summary(points) for name, points in sets.items()},
            "fits": {
                "shipped ranges": fits(vehicle, exact, SHIPPED_RANGES, SHIPPED_START),
                "wide ranges": fits(vehicle, exact, WIDE, nearest(first, tolerance)),
                "small bounds": fits(vehicle, exact, SMALL_BOUNDS, SMALL_BOUNDS_START),
            },
            "one_seed": one_seed(vehicle),
            "effects": [needed(vehicle, effect) for effect in EFFECTS],
            "mechanisms": {name: weigh(windowed, free) for name, free in MECHANISMS.items()},
        }
    (folder / "identification.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    text = "\n".join(f"{name}\n\n{table}" for name, table in tables(document).items())
    (folder / "tables.md").write_text(text, encoding="utf-8")
    parameters = parameter_file(document["fits"]["small bounds"]["all"]["values"])
    (folder / "all-figures.toml").write_text(parameters, encoding="utf-8")
    write_points(
        {variant.name: sets[variant.name] for variant in VARIANTS[:2]}, folder / "identification.png"
    )
    return document


def points_of(index: int, folder: Path, effort: Effort) -> Columns:
    """Returns the points of a variant, from the file of an earlier run if there is one."""
    path, variant = folder / f"points-{index}.npz", VARIANTS[index]
    if not path.exists():
        with Vehicle(variant.task, noise=False) as vehicle:
            points: dict[str, Any] = posterior(vehicle, variant, effort)
        print(f"{variant.name}: {vehicle.runs} runs", flush=True)
        np.savez(path, **points)
    with np.load(path) as file:
        return dict(file)


def parameter_file(values: dict[str, float]) -> str:
    """Returns the parameter file of a fit to all eight figures, provenance beside each value."""
    source = (
        "identified: least squares on all eight figures of Tables 1 and 2 of Maalouf et al. (2013), "
        f"mean of {len(SEEDS)} sensor seeds; not a published value"
    )
    parameters = {
        name: {
            "value": float(f"{value:.4g}"),
            "unit": BY_NAME[name].unit if name in BY_NAME else "1",
            "source": source,
        }
        for name, value in variables(values).items()
    }
    return tomli_w.dumps({"parameters": parameters})


if __name__ == "__main__":
    study(Path(sys.argv[1]))
