"""A rogue and a lag that feed each other, and experiments in which the rogue misbehaves."""

from typing import Any

from orchestration.results.recording import Recording
from orchestration.run import Simulator
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.shared_builds import Build


def run(system: System, experiment: Experiment) -> Recording:
    """Returns the recording of a run."""
    with Simulator(system) as loaded:
        return loaded.run(experiment)


def pair(linear: Build, rogue: Build, saves_state: bool = True, **of_the_lag: Any) -> System:
    """x' = y_lag, lag' = 1 - lag - x: the rogue gives x, the lag answers with -x of the start."""
    lag = linear(b=(-1.0,), saves_state=saves_state, **of_the_lag)
    components = {"rogue": rogue(saves_state=saves_state), "lag": lag}
    return System(components, (("rogue.y", "lag.u[1]"), ("lag.y[1]", "rogue.u")))


def doing(misdeed: Misdeed, time: float = 0.5, longest_step: float = 0.0, h: float = 0.1) -> Experiment:
    parameters = {"rogue.misdeed": misdeed.name.lower(), "rogue.misdeed_time": time}
    return Experiment(1.0, h, parameters=parameters | {"rogue.longest_step": longest_step})
