"""In what the scenarios of several runs differ."""

import json
from collections.abc import Mapping
from typing import Any

from orchestration.report.result import RunResult

_ABSENT = "not said"
_FEW = 3
_NEVER_TELLING = ("title",)  # it always differs, and is shown


def differences(runs: list[RunResult]) -> dict[str, dict[str, str]]:
    """Setting -> value as text -> who has it; of the settings that differ, sorted, rare values first."""
    settings = {run.name: flat({**run.scenario, "run": run.provenance}) for run in runs if run.scenario}
    found: dict[str, dict[str, str]] = {}
    for key in sorted({key for values in settings.values() for key in values} - set(_NEVER_TELLING)):
        names: dict[str, list[str]] = {}
        for name, values in settings.items():
            names.setdefault(values.get(key, _ABSENT), []).append(name)
        if len(names) > 1:
            by_rarity = sorted(names.items(), key=lambda item: len(item[1]))
            found[key] = {value: ", ".join(who) for value, who in by_rarity}
            most, who = by_rarity[-1]
            if len(who) > _FEW:
                found[key][most] = f"the other {len(who)}"
    return found


def flat(content: Mapping[str, Any], before: str = "") -> dict[str, str]:
    """Nested tables as one: "experiment: step_size" -> its value as text."""
    found: dict[str, str] = {}
    for key, value in content.items():
        if isinstance(value, Mapping):
            found |= flat(value, f"{before}{key}: ")
        else:
            found[f"{before}{key}"] = (
                value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
            )
    return found
