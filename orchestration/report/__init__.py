"""Results as one interactive HTML page that opens in a browser and needs no network."""

from orchestration.report.find import found_results
from orchestration.report.render import render
from orchestration.report.result import RunResult, SweepResult

__all__ = ["RunResult", "SweepResult", "found_results", "render"]
