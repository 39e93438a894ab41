"""The table `[sweep]` of a scenario, checked against its FMUs, and the values of every sample.

Grids combine as full factorial, the first one slowest; at each grid point come `samples` draws.
The numbers of sample i come from SeedSequence(seed, spawn_key=(i,)) alone, one for each variable that
is drawn, in the order in which the scenario names them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fmus.errors import nearest
from orchestration.errors import ScenarioError
from orchestration.scenarios.scenario import Scenario
from orchestration.sweep.target import laid_over, target
from orchestration.sweep.varied import Varied, varied
from orchestration.system.prepared_run import prepare
from orchestration.system.system import CheckedSystem

_KEYS = ("samples", "seed", "timeout", "vary")
_TAKEN = ("sample", "error")  # columns of the table


@dataclass(frozen=True)
class Plan:
    """A scenario, its checked system and what is varied.

    draws: samples at each grid point; timeout: s that a sample may take, None for ever
    """

    scenario: Scenario
    checked: CheckedSystem
    varied: tuple[Varied, ...]
    seed: int
    draws: int
    timeout: float | None

    @cached_property
    def _shape(self) -> tuple[int, ...]:
        return (*(len(each.grid) for each in self.varied if each.draw is None), self.draws)

    @property
    def count(self) -> int:
        """Samples in all."""
        return math.prod(self._shape)

    def values(self, sample: int) -> dict[str, Any]:
        """Name -> value of what is varied, in one sample."""
        if not 0 <= sample < self.count:
            raise ScenarioError(f"sample {sample}: expected 0..{self.count - 1}")
        places = iter(np.unravel_index(sample, self._shape))
        random = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(sample,)))
        return {
            each.target.name: each.draw(random.random()) if each.draw else each.grid[next(places)]
            for each in self.varied
        }

    def settings(self, values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        """The values as a scenario file would say them: table -> key -> value."""
        tables: dict[str, dict[str, Any]] = {}
        for each in self.varied:
            tables.setdefault(each.target.table, {})[each.target.key] = values[each.target.name]
        return tables

    def of_sample(self, sample: int) -> Scenario:
        """One sample as a scenario of its own, with nothing left to draw."""
        settings = self.settings(self.values(sample))
        resolved = {key: value for key, value in self.scenario.resolved.items() if key != "sweep"}
        for table, values in settings.items():
            resolved[table] = {**resolved.get(table, {}), **values}
        return replace(
            self.scenario,
            name=f"{self.scenario.name}.sample-{sample}",
            title=f"{self.scenario.title}, sample {sample}",
            experiment=laid_over(self.scenario.experiment, settings),
            resolved=resolved,
            sweep={},
        )


def plan(scenario: Scenario) -> Plan:
    """The sweep that a scenario declares; a ScenarioError or SystemDefinitionError says what is wrong."""
    what, declared = f"{scenario.name}: sweep", scenario.sweep
    for key in declared:
        if key not in _KEYS:
            raise ScenarioError(f"{what}: unknown key {key!r}; {nearest(key, _KEYS)}")
    entries = declared.get("vary")
    if not isinstance(entries, dict) or not entries:
        raise ScenarioError(f'{what}: expected a table [sweep.vary."component.variable"], got {entries!r}')
    for name in _TAKEN:
        if name in scenario.metrics:
            raise ScenarioError(
                f"{what}: metric {name}: expected another name, the table has a column of that one"
            )
    experiment = scenario.experiment
    checked = prepare(scenario.system, experiment).system
    wanted = {
        name: each for name, each in entries.items() if each is not False
    }  # false drops one of the base
    found = tuple(varied(target(n, checked, experiment), each, f"{what}: {n}") for n, each in wanted.items())
    return Plan(
        scenario=scenario,
        checked=checked,
        varied=found,
        seed=_whole(declared, "seed", 0, 0, what),
        draws=_draws(declared, found, what),
        timeout=_timeout(declared, what),
    )


def _draws(declared: Mapping[str, Any], found: tuple[Varied, ...], what: str) -> int:
    if any(each.draw for each in found):
        return _whole(declared, "samples", None, 1, what)
    if "samples" in declared:
        raise ScenarioError(f"{what}: samples: expected none, nothing is drawn")
    return 1


def _whole(declared: Mapping[str, Any], key: str, default: int | None, least: int, what: str) -> int:
    value = declared.get(key, default)
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise ScenarioError(f"{what}: {key} = {value!r}: expected a whole number, {least} or more")
    return value


def _timeout(declared: Mapping[str, Any], what: str) -> float | None:
    value = declared.get("timeout")
    if value is None:
        return None
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not 0.0 < value < math.inf:
        raise ScenarioError(f"{what}: timeout = {value!r}: expected a number of seconds, more than 0")
    return float(value)
