# %% [markdown]
# # A scenario file run by FMPy
#
# Python's `tomllib` reads a scenario and its bases, and the master of `orchestration/fmpy_master.py` runs it.
# It needs the FMUs that `l1-depth build L1DepthController RovDepthPlant` writes. Faults, events, replaced
# components and most kinds of signals are left to `l1-depth run`.

# %%
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

from fmpy import read_model_description

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


def joined(scenario: dict[str, Any], names: set[str]) -> dict[str, Any]:
    """Returns the tables with what joins the inputs that they do not drive, by the table [interface].

    names: "component.variable" of all FMUs
    """
    connections, inputs = {**scenario.get("connections", {})}, {**scenario.get("inputs", {})}
    for target, sources in scenario["interface"]["inputs"].items():
        if target in names - connections.keys() - inputs.keys() - scenario["signals"].keys():
            for source in sources:
                if isinstance(source, dict):  # under a condition
                    unless = source.get("unless", {}).items()
                    if source.get("where") in names or any(
                        scenario["parameters"].get(name, value) != value for name, value in unless
                    ):
                        raise NotImplementedError(f"{target}: `l1-depth run` has {source}")
                elif not isinstance(source, str):
                    inputs[target] = source
                    break
                elif source in names:
                    connections[target] = source
                    break
    return scenario | {"connections": connections, "inputs": inputs}


def signal(kind: str, **arguments: Any) -> Any:
    return SIGNALS[kind](**arguments)


# %%
scenario = tables(Path(str(files("orchestration") / "scenarios" / "nominal-extended.toml")))
fmus = {name: f"fmus-built/{model}.fmu" for name, model in scenario["components"].items()}
descriptions = {name: read_model_description(fmu) for name, fmu in fmus.items()}
names = {f"{name}.{one.name}" for name, found in descriptions.items() for one in found.modelVariables}
scenario = joined(scenario, names)
if left_out := scenario.keys() & {"faults", "events"}:
    raise NotImplementedError(f"{left_out}: `l1-depth run` has them")
recording = simulate(
    fmus,
    [(source, target) for target, source in scenario["connections"].items()],
    start_values=scenario["parameters"] | scenario["inputs"],
    signals={name: signal(**declared) for name, declared in scenario["signals"].items()},
    record=[name for name, is_recorded in scenario["record"].items() if is_recorded and name in names],
    **scenario["experiment"],
)
for name, value in evaluate(recording, scenario["metrics"]).items():
    print(f"{name}: {value:.4g}")

# %%
recording.plot("plant.depth", "plant.total_force")
