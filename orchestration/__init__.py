"""Everything that uses FMUs, through their model descriptions alone: the master algorithm and its tools."""

from orchestration.experiment import Experiment
from orchestration.master import Simulator, simulate
from orchestration.system import System

__all__ = ["Experiment", "Simulator", "System", "simulate"]
