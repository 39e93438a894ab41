"""The table `[sweep]` of a scenario, checked against its FMUs, and the values of every sample.

Grids combine as full factorial, the first one slowest; at each grid point come `samples` draws.
The numbers of sample i come from SeedSequence(seed, spawn_key=(i,)) alone, one for each variable that
is drawn, in the order in which the scenario names them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fmus.fmi.variable_types import FmiValue
from orchestration.errors import ScenarioError
from orchestration.results.metrics import evaluate
from orchestration.run.run_recording import make_recording
from orchestration.scenarios.changes import tables_of_values, with_values
from orchestration.scenarios.file_tables import Table
from orchestration.scenarios.scenario import Scenario
from orchestration.scenarios.toml_file import KeyPath, placed
from orchestration.sweep.varied import (
    MOST_VALUES,
    SweepTable,
    Varied,
    sweep_table,
    target,
    varied,
)
from orchestration.system.prepared_run import prepare
from orchestration.system.system import CheckedSystem

_COLUMNS = ("sample", "warned", "error")  # of the table, beside columns of metrics and varied values


@dataclass(frozen=True)
class Plan:
    """A plan of a sweep: a scenario, its checked system and what is varied.

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
        return (*(len(entry.grid) for entry in self.varied if entry.draw is None), self.draws)

    @property
    def count(self) -> int:
        """Count of all samples."""
        return math.prod(self._shape)

    def values(self, sample: int) -> dict[str, FmiValue]:
        """Returns name -> value of what is varied, in one sample."""
        if not 0 <= sample < self.count:
            raise ScenarioError(f"sample {sample}: expected 0..{self.count - 1}")
        return self.block([sample])[0]

    def block(self, samples: Sequence[int]) -> list[dict[str, FmiValue]]:
        """Returns the `values` of several samples at once."""
        grid_indices = iter(np.unravel_index(samples, self._shape))
        uniforms = iter(zip(*map(self._uniforms, samples), strict=True))
        columns = [
            entry.draw(next(uniforms)) if entry.draw else [entry.grid[i] for i in next(grid_indices)]
            for entry in self.varied
        ]
        names = [entry.target.name for entry in self.varied]
        return [
            {name: column[i] for name, column in zip(names, columns, strict=True)}
            for i in range(len(samples))
        ]

    def _uniforms(self, sample: int) -> list[float]:
        """Returns a number in [0, 1) for each variable that is drawn."""
        count = sum(entry.draw is not None for entry in self.varied)
        sequence = np.random.SeedSequence(self.seed, spawn_key=(sample,))
        return np.random.default_rng(sequence).random(count).tolist()

    def of_sample(self, sample: int) -> Scenario:
        """Returns one sample as a scenario, with nothing left to draw."""
        values, experiment = self.values(sample), self.scenario.experiment
        resolved = {key: value for key, value in self.scenario.resolved.items() if key != "sweep"}
        for table, entries in tables_of_values(values, experiment).items():
            resolved[table] = {**resolved.get(table, {}), **entries}
        return replace(
            self.scenario,
            name=f"{self.scenario.name}.sample-{sample}",
            title=f"{self.scenario.title}, sample {sample}",
            experiment=with_values(experiment, values),
            resolved=resolved,
            sweep={},
        )


def plan(scenario: Scenario) -> Plan:
    """Returns the sweep that a scenario declares; ScenarioError or SystemDefinitionError for a wrong one.

    A metric that can be computed of no recording is refused here, not in each sample.
    """

    def at(keys: KeyPath) -> str:
        """Returns where a key of the table stands: in the uppermost file that has it."""
        for length in range(len(keys), -1, -1):
            for file in scenario.files:
                if ("sweep", *keys[:length]) in file.lines:
                    return f"{file.at(('sweep', *keys[:length]))}: sweep"
        return f"{scenario.name}: sweep"

    where = at(())
    table = sweep_table(scenario.sweep, at)
    for name in _COLUMNS:
        if name in scenario.metrics:
            raise ScenarioError(
                f"{where}: metric {name}: expected another name, the table has a column of that one"
            )
    experiment = scenario.experiment
    prepared = prepare(scenario.system, experiment)
    if "experiment.stop_time" not in table.vary:  # another end may be what a metric needs
        rows = np.zeros(prepared.shape)
        evaluate(make_recording(prepared, rows, len(rows), is_final=True), scenario.metrics)
    with placed(scenario.files):
        targets = {name: target(name, prepared.system, experiment) for name in table.vary}
    entries = tuple(
        varied(targets[name], declared, f"{at(('vary', name))}: {name}")
        for name, declared in table.vary.items()
        if isinstance(declared, Table)
    )
    plan = Plan(scenario, prepared.system, entries, table.seed, _draws(table, entries, where), table.timeout)
    if plan.count > MOST_VALUES:
        raise ScenarioError(
            f"{where}: {plan.count} samples, the product of samples and grids: expected at most {MOST_VALUES}"
        )
    return plan


def _draws(table: SweepTable, entries: tuple[Varied, ...], where: str) -> int:
    is_given = "samples" in table.model_fields_set
    if any(entry.draw for entry in entries):
        if not is_given:
            raise ScenarioError(f"{where}: samples is missing")
        return table.samples
    if table.samples > 1:
        raise ScenarioError(f"{where}: samples = {table.samples}: expected 1 or none, nothing is drawn")
    return 1
