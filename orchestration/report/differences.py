"""In what the scenarios of several runs differ."""

import json
from collections.abc import Mapping
from typing import Any

from orchestration.report.result import RunResult

_ABSENT = "absent"
_FEW = 3
_NEVER_TELLING = ("title",)  # it always differs, and is shown


def differences(runs: list[RunResult]) -> dict[str, dict[str, str]]:
    """Setting -> value as text -> names of the runs with it, where these differ; rare values first."""
    settings = {run.name: flat({**run.scenario, "run": run.provenance}) for run in runs if run.scenario}
    values_by_setting: dict[str, dict[str, str]] = {}
    for key in sorted({key for values in settings.values() for key in values} - set(_NEVER_TELLING)):
        names: dict[str, list[str]] = {}
        for name, values in settings.items():
            names.setdefault(values.get(key, _ABSENT), []).append(name)
        if len(names) > 1:
            by_rarity = sorted(names.items(), key=lambda item: len(item[1]))
            values_by_setting[key] = {value: ", ".join(members) for value, members in by_rarity}
            most, members = by_rarity[-1]
            if len(members) > _FEW:
                values_by_setting[key][most] = f"the other {len(members)}"
    return values_by_setting


def flat(content: Mapping[str, Any], before: str = "") -> dict[str, str]:
    """Nested tables as one: "experiment: step_size" -> its value as text."""
    texts: dict[str, str] = {}
    for key, value in content.items():
        if isinstance(value, Mapping):
            texts |= flat(value, f"{before}{key}: ")
        else:
            texts[f"{before}{key}"] = (
                value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
            )
    return texts
