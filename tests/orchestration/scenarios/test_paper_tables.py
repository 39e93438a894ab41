"""The tables of the paper beside ours."""

import io
import math
from collections.abc import Mapping

from rich.console import Console

from orchestration.scenarios.published import ALL_FIGURES, PUBLISHED, comparison_table


def printed(measured: Mapping[str, Mapping[str, float]]) -> str:
    # with the same lines in a console of Windows
    console = Console(width=130, record=True, file=io.StringIO(), legacy_windows=False)
    console.print(comparison_table(measured))
    return console.export_text()


def test_a_figure_stands_beside_the_values_of_both_fits_each_with_its_word() -> None:
    """The values are of the test: the word of a prediction is of the gains of the nominal row alone."""
    measured: dict[str, dict[str, float]] = {}
    for figure in PUBLISHED:
        measured.setdefault(figure.scenario, {})[figure.metric] = 0.9 * figure.value
        if figure.case != "example":
            of_all = measured.setdefault(figure.scenario + ALL_FIGURES, {})
            of_all[figure.metric] = 1.02 * figure.value
    lines = [[*map(str.strip, line.split("│"))][1:-1] for line in printed(measured).splitlines()]
    rows = {tuple(cells[1:4]): [" ".join(c.split()) for c in cells[4:]] for cells in lines if len(cells) == 7}
    assert len(rows) == len(PUBLISHED)
    of_fit, of_all = "61.2 -10.0 % predicted", "69.36 +2.0 % fitted"
    assert rows["buoyancy", "L1", "Settling time [s]"] == ["68", of_fit, of_all]
    of_fit, of_all = "3.915 -10.0 % fitted", "4.437 +2.0 % fitted"
    assert rows["nominal", "extended L1", "RMSE [cm]"] == ["4.35", of_fit, of_all]
    of_fit, of_all = "1.26 -10.0 % W - B", "1.428 +2.0 % W - B"
    assert rows["buoyancy", "extended L1", "Holding thrust [N]"] == ["1.4", of_fit, of_all]
    assert rows["example", "L1", "RMSE [1]"] == ["19.8", "17.82 -10.0 % computed", ""]


def test_a_figure_that_does_not_exist_has_a_word_and_no_deviation() -> None:
    measured = {figure.scenario: {"rmse": 1.0, "lag": 1.0, "holding_thrust": 1.0} for figure in PUBLISHED}
    for figure in PUBLISHED:
        measured[figure.scenario][figure.metric] = math.nan
    text = printed(measured)
    assert text.count("not settled") == 4
    assert "nan" not in text.replace("nominal", "")
