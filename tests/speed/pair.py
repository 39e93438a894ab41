"""Two small FMUs that exchange one signal each way, the same for every importer.

    dx/dt = drive + (signal - x) / time_constant, x(0) = 0

Explicit Euler, a step of 2^-7 s: every time and step is exact in binary, and in nanoseconds, so that all
importers do the same arithmetic. Both levels start at zero, as importers that exchange no initial values
assume, and never come to rest, so that a step too many or too few shows at any time.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from fmus.block import Block, NoValues, variable
from fmus.build import native as native_flavour
from fmus.files import write_archive
from orchestration.cli.package_fmus import build_ramp_source
from orchestration.exchange import ssp_write
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

STEP_SIZE = 2.0**-7
SIGNAL, LEVEL = "signal", "level"
PACKAGE = "pair"


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(1.0, "Longest internal step", unit="s", min=1e-6, max=10.0)
    time_constant: float = variable(3.0, "Time in which the level follows the signal", unit="s", min=1.0)
    drive: float = variable(0.1, "Rate of the level without signal", unit="1/s")


@dataclass(frozen=True)
class Inputs:
    signal: float = variable(0.0, "What the level follows")


@dataclass(frozen=True)
class State:
    level: float = 0.0


@dataclass(frozen=True)
class Outputs:
    level: float = variable(0.0, "Level")


def step(
    t: float, h: float, state: State, inputs: Inputs, parameters: Parameters, calculated: NoValues
) -> State:
    rate = parameters.drive + (inputs.signal - state.level) / parameters.time_constant
    return State(state.level + h * rate)


FIRST = Block(
    name="BenchFirst",
    description="A lag of first order that is driven",
    parameters=Parameters,
    inputs=Inputs,
    state=State,
    outputs=Outputs,
    initial_state=lambda t, inputs, parameters, calculated: State(),
    step=step,
    output=lambda t, state, parameters, calculated: Outputs(state.level),
    step_size=STEP_SIZE,
)


@dataclass(frozen=True)
class Slower(Parameters):
    time_constant: float = variable(7.0, "Time in which the level follows the signal", unit="s", min=1.0)
    drive: float = variable(-0.05, "Rate of the level without signal", unit="1/s")


SECOND = replace(FIRST, name="BenchSecond", parameters=Slower)


@dataclass(frozen=True)
class Pair:
    """The two FMUs in a folder, joined."""

    folder: Path

    @property
    def fmus(self) -> dict[str, Path]:
        """Component -> FMU."""
        blocks = {"first": FIRST, "second": SECOND}
        return {name: self.folder / f"{block.name}.fmu" for name, block in blocks.items()}

    @property
    def system(self) -> System:
        links = [(f"first.{LEVEL}", f"second.{SIGNAL}"), (f"second.{LEVEL}", f"first.{SIGNAL}")]
        return System(self.fmus, links)

    @property
    def references(self) -> tuple[int, int]:
        """Value references of input and output in both."""
        references = {v.name: v.value_reference for v in FIRST.variables}
        return references[SIGNAL], references[LEVEL]

    @property
    def package(self) -> Path:
        """The same as an SSP package."""
        return self.folder / f"{PACKAGE}.ssp"

    def experiment(self, steps: int) -> Experiment:
        return Experiment(stop_time=steps * STEP_SIZE, step_size=STEP_SIZE)


def build(folder: Path) -> Pair:
    """Write both FMUs and the package."""
    pair = Pair(folder)
    for block, path in zip((FIRST, SECOND), pair.fmus.values(), strict=True):
        _, members = native_flavour.content(block)
        write_archive(path, members | native_flavour.libraries(block.name, members, ()))
    experiment = replace(pair.experiment(1), record=(f"first.{LEVEL}", f"second.{LEVEL}"))
    ssp_write.package(
        Scenario(PACKAGE, "Two lags", pair.system, experiment, {}), pair.package, build_ramp_source
    )
    return pair
