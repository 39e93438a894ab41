# %% [markdown]
# # A scenario file led by FMPy
#
# Python's `tomllib` reads a scenario and its bases, and the master of `orchestration/fmpy_master.py`, a page
# of calls of FMPy, runs it. It needs the FMUs that `l1-depth build L1DepthController RovDepthPlant` writes.

# %%
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

from orchestration import Constant, Cosine, Ramps, evaluate
from orchestration.fmpy_master import simulate

SIGNALS = {"constant": Constant, "cosine": Cosine, "ramps": Ramps}


def tables(path: Path) -> dict[str, Any]:
    """Returns the tables of a scenario file over those of its base."""
    own = tomllib.loads(path.read_text(encoding="utf-8"))
    merged = tables(path.parent / own.pop("base")) if "base" in own else {}
    for file in own.pop("parameter_files", ()):
        found = tomllib.loads((path.parent / file).read_text(encoding="utf-8"))["parameters"]
        own["parameters"] = {name: entry["value"] for name, entry in found.items()} | own.get(
            "parameters", {}
        )
    for key, value in own.items():
        merged[key] = merged.get(key, {}) | value if isinstance(value, dict) else value
    return merged


def signal(kind: str, **arguments: Any) -> Any:
    return SIGNALS[kind](**arguments)


# %%
scenario = tables(Path(str(files("orchestration") / "scenarios" / "nominal-extended.toml")))
if left_out := scenario.keys() & {"faults", "events"}:
    raise NotImplementedError(f"{left_out}: `l1-depth run` has them")
recording = simulate(
    {name: f"fmus-built/{model}.fmu" for name, model in scenario["components"].items()},
    [tuple(ends) for ends in scenario["connections"]],
    start_values=scenario["parameters"] | scenario["inputs"],
    signals={name: signal(**declared) for name, declared in scenario["signals"].items()},
    record=scenario["record"],
    **scenario["experiment"],
)
for name, value in evaluate(recording, scenario["metrics"]).items():
    print(f"{name}: {value:.4g}")

# %%
recording.plot("plant.depth", "plant.total_force")
