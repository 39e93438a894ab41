"""Results as one interactive HTML page that needs no network: who receives it opens it, and that is all."""

from orchestration.report.find import found_results
from orchestration.report.render import render
from orchestration.report.result import RunResult, SweepResult

__all__ = ["RunResult", "SweepResult", "found_results", "render"]
