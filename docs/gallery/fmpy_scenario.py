# %% [markdown]
# # A scenario file led by FMPy
#
# Python's `tomllib` reads a scenario and its bases, and the master of `orchestration/fmpy_master.py`, a page
# of calls of FMPy, runs it. It needs the FMUs that `l1-depth build L1DepthController RovDepthPlant` writes.
# Faults, events, replaced components and other kinds of signals are left to `l1-depth run`.

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
    merged = tables((path.parent / own.pop("base")).with_suffix(".toml")) if "base" in own else {}
    if isinstance(own.get("connections"), list):  # the other form is a table
        own["connections"] = {target: source for source, target in own["connections"]}
    if isinstance(own.get("record"), list):
        own["record"] = dict.fromkeys(own["record"], True)
    for file in own.pop("parameter_files", ()):
        found = tomllib.loads((path.parent / file).read_text(encoding="utf-8"))["parameters"]
        own["parameters"] = {name: entry["value"] for name, entry in found.items()} | own.get(
            "parameters", {}
        )
    if merged.get("components", {}).keys() & own.get("components", {}).keys():
        raise NotImplementedError(f"{path}: `l1-depth run` replaces components")
    for key, value in own.items():
        merged[key] = merged.get(key, {}) | value if isinstance(value, dict) else value
    return merged


def signal(kind: str, **arguments: Any) -> Any:
    return SIGNALS[kind](**arguments)


# %%
scenario = tables(Path(str(files("orchestration") / "scenarios" / "nominal-extended.toml")))
conditions = scenario.get("when_set", ())
if any(scenario["parameters"].get(one["parameter"]) in one["values"] for one in conditions):
    raise NotImplementedError("[[when_set]]: `l1-depth run` has it")
if left_out := scenario.keys() & {"faults", "events"}:
    raise NotImplementedError(f"{left_out}: `l1-depth run` has them")
recording = simulate(
    {name: f"fmus-built/{model}.fmu" for name, model in scenario["components"].items()},
    [(source, target) for target, source in scenario["connections"].items()],
    start_values=scenario["parameters"] | scenario["inputs"],
    signals={name: signal(**declared) for name, declared in scenario["signals"].items()},
    record=[name for name, is_recorded in scenario["record"].items() if is_recorded],
    **scenario["experiment"],
)
for name, value in evaluate(recording, scenario["metrics"]).items():
    print(f"{name}: {value:.4g}")

# %%
recording.plot("plant.depth", "plant.total_force")
