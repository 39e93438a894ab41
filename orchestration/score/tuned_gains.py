"""The gains that `l1-depth tune` gave the controllers of the protocol: gains/NAME.toml."""

from dataclasses import replace
from pathlib import Path

from fmus.fmi.variable_types import FmiValue
from orchestration.scenarios.read_layers import parameter_values
from orchestration.score.loop import OWN, Controller, built_in
from orchestration.score.protocol import Protocol

FOLDER = Path(__file__).with_name("gains")


def tuned_gains(name: str) -> dict[str, FmiValue]:
    """Variable of the controller -> value; empty for one that was not tuned."""
    path = FOLDER / f"{name}.toml"
    values = parameter_values(path) if path.is_file() else {}
    return {variable.removeprefix(OWN): value for variable, value in values.items()}


def tuned(protocol: Protocol, name: str) -> Controller:
    """The controller that the protocol has under that name, with its tuned gains."""
    controller = built_in(protocol, name)
    return replace(controller, parameters={**controller.parameters, **tuned_gains(name)})
