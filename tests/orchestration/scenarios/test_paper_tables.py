"""The tables of the paper beside ours."""

import io
import math

from rich.console import Console

from orchestration.scenarios.published import PUBLISHED, comparison_table


def test_a_figure_that_does_not_exist_has_a_word_and_no_deviation() -> None:
    measured = {figure.scenario: {"rmse": 1.0, "lag": 1.0, "holding_thrust": 1.0} for figure in PUBLISHED}
    for figure in PUBLISHED:
        measured[figure.scenario][figure.metric] = math.nan
    console = Console(width=160, record=True, file=io.StringIO())
    console.print(comparison_table(measured))
    text = console.export_text()
    assert text.count("not settled") == 4
    assert "nan" not in text.replace("nominal", "")
