"""Prints docs/explanation/comparison.json: what the page reads of a comparison by `l1-depth compare --full`.

    python .ci/comparison_page.py results/comparison.json > docs/explanation/comparison.json

The metrics of a case keep eight digits. The values on each plant stay where a test computes from them again.
"""

import json
import sys
from pathlib import Path
from typing import Any

from orchestration.score.compare import PAPERS

_DIGITS = 8
_WITH_PLANTS = (PAPERS, "tuned/pid")
_WITH_VALUES = "rmse"


def reduced(document: dict[str, Any]) -> dict[str, Any]:
    """Returns the document with rounded metrics, and the plants' values of two controllers alone."""
    return {
        **document,
        "rows": [_row(row) for row in document["rows"]],
        "differences": [entry for entry in document["differences"] if entry["metric"] == _WITH_VALUES],
    }


def _row(row: dict[str, Any]) -> dict[str, Any]:
    plants = row["plants"]
    metrics = {
        name: {**_rounded(metric | {"values": []}), "values": _values(row["name"], name, metric["values"])}
        for name, metric in plants["metrics"].items()
    }
    return {**row, "cases": _rounded(row["cases"]), "plants": {**plants, "metrics": metrics}}


def _values(controller: str, metric: str, values: list[float]) -> list[float]:
    return values if controller in _WITH_PLANTS and metric == _WITH_VALUES else []


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def written(document: dict[str, Any]) -> str:
    """Returns the document as JSON, with a line for each row and each difference."""
    parts = [f"{json.dumps(key)}: {_part(value)}" for key, value in document.items()]
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _part(value: Any) -> str:
    if not isinstance(value, list):
        return json.dumps(value)
    return "[\n" + ",\n".join(json.dumps(item, separators=(",", ":")) for item in value) + "\n]"


if __name__ == "__main__":
    print(written(reduced(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))), end="")
