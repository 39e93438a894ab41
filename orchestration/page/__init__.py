"""Results as one interactive HTML page that needs no network: who receives it opens it, and that is all."""

from orchestration.page.find import found_results
from orchestration.page.render import render
from orchestration.page.result import Run, Sweep

__all__ = ["Run", "Sweep", "found_results", "render"]
