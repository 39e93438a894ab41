"""What explain prints is the page on keys, an entry of it, or a block."""

import re
from collections import Counter
from pathlib import Path

import pytest

from orchestration.cli.explain import explain, sections

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "keys.md"


def words(text: str) -> list[str]:
    return re.findall(r"\w+", text)


@pytest.mark.parametrize("topic", ["keys", "signals", "faults", "metrics", "distributions"])
def test_a_topic_has_each_word_of_its_part_of_the_page(
    topic: str, capsys: pytest.CaptureFixture[str]
) -> None:
    explain(topic)
    shown = words(capsys.readouterr().out)
    page = PAGE.read_text(encoding="utf-8")
    for section in sections()[topic]:
        part = page.partition(f"## {section.title}\n")[2].partition("\n## ")[0]
        assert len(words(part)) > 20
        assert not Counter(words(part)) - Counter(shown)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("rmse", "sqrt(mean((signal - reference)^2))"),
        ("drop-out", "probability"),
        ("gauss-seidel", None),
        ("step_size", "Communication step size [s]."),
    ],
)
def test_one_entry_is_shown_alone(
    name: str, expected: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    if expected is None:
        with pytest.raises(SystemExit, match="2"):
            explain(name)
        return
    explain(name)
    shown = capsys.readouterr().out
    assert expected in shown
    assert shown.count("├") <= 1


def test_a_block_is_shown_by_its_equations_and_where_its_variables_are(
    capsys: pytest.CaptureFixture[str],
) -> None:
    explain("PidDepthController")
    shown = capsys.readouterr().out
    assert "u     = -k_p e" in shown
    assert "l1-depth inspect PidDepthController" in shown


def test_an_unknown_name_has_the_nearest_one_and_status_2(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        explain("rmsee")
    assert ended.value.code == 2
    assert capsys.readouterr() == ("", "l1-depth: nothing is named 'rmsee'; nearest is 'rmse'\n")
