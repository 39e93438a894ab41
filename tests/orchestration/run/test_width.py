"""What a run costs before its first step grows with the width of its FMUs, and not with its square."""

import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from orchestration.run import simulate
from orchestration.system.experiment import Event, Experiment
from orchestration.system.system import System
from tests.described_fmus import redescribed
from tests.shared_builds import Build


def widened(fmu: Path, path: Path, width: int, declares_dependencies: bool) -> Path:
    """A copy of y = x, x' = u with so many names for u and for y."""

    def change(text: str) -> str:
        variables = ""
        for name, causality, start in (("u", "input", ' start="0"'), ("y", "output", "")):
            element = next(e for e in re.findall("<ScalarVariable[^>]*>", text) if f'name="{name}[1]"' in e)
            (reference,) = re.findall('valueReference="([^"]*)"', element)
            kind = f'valueReference="{reference}" causality="{causality}" variability="continuous"'
            for i in range(width):
                variables += f'<ScalarVariable name="{name}{i}" {kind}><Real{start}/></ScalarVariable>'
        unknowns = ""
        for i in range(width):
            dependencies = f' dependencies="{i + 1}"' if declares_dependencies else ""
            unknowns += f'<Unknown index="{width + i + 1}"{dependencies}/>'
        head = text[: text.index("<ModelVariables>")]
        return (
            f"{head}<ModelVariables>{variables}</ModelVariables><ModelStructure><Outputs>{unknowns}</Outputs>"
            f"<InitialUnknowns>{unknowns}</InitialUnknowns></ModelStructure></fmiModelDescription>"
        )

    return redescribed(fmu, path, change)


def operations(run: Callable[[], object]) -> int:
    """How many operations of Python's machine a call takes, the same in every run."""
    count = 0

    def trace(frame: FrameType, event: str, argument: Any) -> Any:
        nonlocal count
        frame.f_trace_opcodes = True
        count += event == "opcode"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        run()
    finally:
        sys.settrace(before)
    return count


@pytest.mark.slow
@pytest.mark.parametrize(("declares_dependencies", "tolerance"), [(True, None), (False, 1e-3)])
def test_twice_the_width_costs_twice_as_much(
    linear: Build, tmp_path: Path, declares_dependencies: bool, tolerance: float | None
) -> None:
    base = linear(saves_state=True)

    def cost(width: int) -> int:
        fmu = widened(base, tmp_path / f"{width}.fmu", width, declares_dependencies)
        system = System({"a": fmu, "b": fmu}, [(f"a.y{i}", f"b.u{i}") for i in range(width)])
        inputs = {f"a.u{i}": 0.0 for i in range(width)}
        settings: dict[str, Any] = {"events": [Event(0.01, inputs)], "tolerance": tolerance}
        experiment = Experiment(0.02, 0.01, inputs=inputs, record=["b.y0"], **settings)
        return operations(lambda: simulate(system, experiment))

    cost(2)  # what is imported or compiled once
    once, twice, four_times = cost(20), cost(40), cost(80)
    # What does not depend on the width cancels; a quadratic part alone would make the second difference twice
    # the first.
    assert (four_times - twice) / 2 < 1.05 * (twice - once)
