"""The equations of the law stand in one place, and its numbers say where they come from."""

from pathlib import Path

import pytest

from controller_fmu.l1.parameters import EQUATIONS
from fmus.generate import builder

THEORY = Path(__file__).parents[3] / "docs" / "explanation" / "theory.md"
NOT_PRINTED_IN_THE_PAPER = {
    "L1Controller": ("state_matrix", "input_vector", "output_vector", "lyapunov_weight", "theta_bound"),
    "ExamplePlant": ("state_matrix", "input_vector", "output_vector", "theta"),
}


def test_the_theory_page_shows_the_equations_of_the_law() -> None:
    indented = "\n".join(f"    {line}".rstrip() for line in EQUATIONS.splitlines())
    assert indented in THEORY.read_text(encoding="utf-8")


@pytest.mark.parametrize("block", ["L1Controller", "L1DepthController"])
def test_the_documentation_inside_the_fmu_shows_the_equations_of_the_law(block: str) -> None:
    guide = builder.load_block(block).guide
    assert guide is not None
    assert guide.equations.startswith(EQUATIONS)


@pytest.mark.parametrize("block", list(NOT_PRINTED_IN_THE_PAPER))
def test_numbers_of_the_example_that_the_paper_does_not_print_are_not_called_published(block: str) -> None:
    sources = {v.name.split("[")[0]: v.source for v in builder.load_block(block).variables}
    for name in NOT_PRINTED_IN_THE_PAPER[block]:
        assert "published" not in sources[name]
        assert "not printed in the paper" in sources[name]
