"""What `python -m tests.speed` measures of our own programs, and what its tables make of it.

No time is a pass or a fail.
"""

import numpy as np
import pytest
from rich.console import Console

from fmus import catalogue
from orchestration.errors import OrchestrationError
from orchestration.master import Simulator
from tests.speed import scenarios
from tests.speed.layers import Layer, layer
from tests.speed.scenarios import HOST, MASTER, MASTER_LOOP, MONOLITH, PYTHON, Loop, loop
from tests.speed.tables import tables


@pytest.mark.slow
@pytest.mark.parametrize("name", catalogue.block_names())
def test_a_block_is_measured_both_ways(name: str) -> None:
    """The C program itself checks that both ways end with the same output."""
    measured = layer(name, steps=1000, rounds=1)
    assert measured.block == name
    assert min(measured.through_fmi, measured.bare) > 0.0


@pytest.mark.slow
def test_a_scenario_is_measured_in_every_way() -> None:
    """That the host and the one C program give equal trajectories is checked on the way."""
    measured = loop("nominal-extended", rounds=1)
    assert measured.steps == 15_500
    assert min(measured.seconds[way] for way in (PYTHON, MASTER, HOST, MONOLITH)) > 0.0


def test_programs_that_differ_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Simulator, "run", lambda simulator, experiment: None)  # its time is not looked at
    given = iter([np.zeros(3), np.array([0.0, 0.0, 1e-300])])
    monkeypatch.setattr(scenarios, "read_result", lambda result, plan: next(given))
    with pytest.raises(OrchestrationError, match="differ: expected equal trajectories"):
        loop("example-l1", rounds=1)


def test_the_tables_have_the_ratios() -> None:
    layers = [Layer("Block", 3e-8, 2e-8)]
    seconds = {PYTHON: 2.0, MASTER: 8e-3, MASTER_LOOP: 6e-3, HOST: 5e-3, MONOLITH: 4e-3}
    loops = [Loop("scenario", 1000, seconds)]
    console = Console(width=150, record=True)
    for table in tables(layers, loops, []):
        console.print(table)
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in console.export_text().splitlines()]
    assert [row for row in rows if row] == [
        ["Block", "30", "20", "1.50"],
        ["scenario", "python FMUs, this master", "2000.00", "2000.00", "1/1", "500.00", "1996000"],
        ["scenario", "native FMUs, this master", "8.00", "8.00", "1/250", "2.00", "4000"],
        ["scenario", "native FMUs, its loop alone", "6.00", "6.00", "1/333", "1.50", "2000"],
        ["scenario", "native FMUs, a host in C", "5.00", "5.00", "1/400", "1.25", "1000"],
        ["scenario", "the same equations, one C program", "4.00", "4.00", "1/500", "1.00", "0"],
    ]
