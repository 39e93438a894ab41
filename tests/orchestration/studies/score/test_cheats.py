"""Controllers that would gain by what they know of a score, or cannot be ranked."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from fmus.generate import builder
from orchestration.many.local_runs import LocalRuns
from orchestration.scenarios.vehicle import VehicleFile
from orchestration.studies.score import score_rows
from orchestration.studies.score.closed_loop import ClosedLoop, ClosedLoopRun, Controller, built_in, tuned
from orchestration.studies.score.draws import drawn_cases
from orchestration.studies.score.protocol import Protocol, on_vehicle, read_protocol
from orchestration.studies.score.run_metrics import declared, metrics_of
from orchestration.studies.score.score import score_controllers
from orchestration.studies.score.score_rows import LimitedRuns
from orchestration.studies.score.score_tables import of_metric
from orchestration.studies.vehicle import Vehicle
from orchestration.system.signals import values_at
from tests.foreign_fmus import Misdeed
from tests.orchestration.studies.score.controllers import rogue_doing
from tests.shared_builds import Build

PID = Controller("mine", "PidDepthController")
KNOWING = '''
"""A PID that may differentiate the reference, or push up by 2 N from 100 s on."""

from dataclasses import dataclass

from fmus.block import Block, variable
from fmus.numerics import where


@dataclass(frozen=True)
class Parameters:
    differentiates: bool = variable(False, "Takes the derivative of the reference itself")
    is_early: bool = variable(False, "Pushes up by 2 N from 100 s on")


@dataclass(frozen=True)
class Inputs:
    depth_reference: float = variable(0.0, "Reference", unit="m")
    measured_depth: float = variable(0.0, "Measured depth", unit="m")


@dataclass(frozen=True)
class State:
    depth: float = 0.0
    rate: float = 0.0
    reference: float = 0.0
    integral: float = 0.0
    force: float = 0.0


@dataclass(frozen=True)
class Outputs:
    control_force: float = variable(0.0, "Force", unit="N")


def initial_state(t, inputs, p, calculated):
    return State(depth=inputs.measured_depth, reference=inputs.depth_reference)


def step(t, h, state, inputs, p, calculated):
    predicted = state.depth + h * state.rate
    error = inputs.measured_depth - predicted
    depth, rate = predicted + 0.2 * error, state.rate + 0.02 * error / h
    off = depth - inputs.depth_reference
    integral = state.integral + h * off
    lead = where(p.differentiates, (inputs.depth_reference - state.reference) / h, 0.0)
    early = where(p.is_early, where(t >= 100.0, -2.0, 0.0), 0.0)
    force = early - 16.5 * off - 5.5 * integral - 14.0 * (rate - lead)
    return State(depth, rate, inputs.depth_reference, integral, force)


def output(t, state, p, calculated):
    return Outputs(control_force=state.force)


BLOCK = Block.of_module(__name__, "Knowing", "A PID that knows the protocol", step_size=0.02)
'''


@pytest.fixture(scope="module")
def knowing(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Controller]:
    """The PID that knows, with some of its parameters."""
    path = tmp_path_factory.mktemp("knowing") / "knowing.py"
    path.write_text(KNOWING, encoding="utf-8")
    fmu = str(builder.fmu_of_file(path))
    return lambda name, **parameters: Controller(name, fmu, parameters=parameters)


@pytest.fixture(scope="module")
def small(small_protocol: Callable[..., Path]) -> Protocol:
    return read_protocol(small_protocol())


@pytest.mark.slow
def test_who_differentiates_the_reference_stands_in_one_table_with_who_is_told_its_rates(
    small: Protocol, protocol: Protocol, knowing: Callable[..., Controller]
) -> None:
    mine, honest = knowing("mine", differentiates=True), knowing("honest")
    with_rates = tuned(protocol, "pid-rates")
    document = score_controllers([mine, honest], small, beside=[with_rates], seed=5).document
    rows = {row.name: row for row in document.rows}
    assert (rows["mine"].symbols, rows["pid-rates"].symbols) == ("r", "r, r', r''")
    errors = {name: row.cases["nominal"].metrics["rmse"] for name, row in rows.items()}
    assert errors["mine"] < 0.9 * errors["honest"]  # what it gains
    marks = {row.name: of_metric(document, "rmse").cells[i][0].is_best for i, row in enumerate(document.rows)}
    assert marks == {name: error == min(errors.values()) for name, error in errors.items()}


def test_no_controller_is_told_the_true_rate_in_any_case(protocol: Protocol) -> None:
    exact = replace(PID, parameters={"velocity_source": "measured"})
    with ClosedLoop(exact, protocol) as loop:
        for case in drawn_cases(protocol, 3):
            targets = {target for _, target, *_ in loop.scenario(case).system.connections}
            assert "controller.measured_depth_rate" not in targets
            assert loop.experiment(case).inputs["controller.measured_depth_rate"] == 0.0
        assert loop.connected() == [
            "depth_reference", "depth_reference_rate", "depth_reference_acceleration",
        ]  # fmt: skip


@pytest.mark.slow
def test_who_acts_at_the_known_time_of_a_step_is_too_early(
    protocol: Protocol, knowing: Callable[..., Controller]
) -> None:
    practised = protocol.cases["hold-step"]
    drawn = [case for seed in range(3) for case in drawn_cases(protocol, seed) if case.name == "hold-step"]
    with (
        ClosedLoop(knowing("honest"), protocol) as honest,
        ClosedLoop(knowing("early", is_early=True), protocol) as early,
    ):
        for case in drawn:
            force = honest.experiment(case).signals["plant.external_force"]
            times = np.array([100.0, 100.0 + case.later - 1e-6, 100.0 + case.later])
            assert values_at(force, times).tolist() == [0.0, 0.0, 2.0]
        rmse = {
            loop.controller.name: [loop.metrics(case)["rmse"] for case in (practised, *drawn)]
            for loop in (honest, early)
        }
    assert rmse["early"][0] < 0.3 * rmse["honest"][0]  # what it would gain
    assert all(early > honest for early, honest in zip(rmse["early"][1:], rmse["honest"][1:], strict=True))


@pytest.mark.slow
def test_who_is_not_deterministic_is_not_ranked(small: Protocol, rogue: Build) -> None:
    with ClosedLoop(rogue_doing(rogue(), Misdeed.NONE), small) as steady:
        assert score_rows.not_repeated(steady, small.nominal) == []
    with ClosedLoop(rogue_doing(rogue(), Misdeed.RANDOM_OUTPUT), small) as random:
        assert score_rows.not_repeated(random, small.nominal) == ["its run, repeated, gives other values"]


def test_gains_beyond_the_bounds_of_the_protocol_are_not_ranked(protocol: Protocol) -> None:
    def reasons(name: str, **parameters: float) -> list[str]:
        fmu = protocol.controllers[name].fmu
        with ClosedLoop(Controller("mine", fmu, parameters=parameters), protocol) as loop:
            return score_rows.beyond_ranges(loop)

    assert reasons("pid", kp=1000.0, ki=0.01) == []
    assert reasons("pid", kp=1001.0) == ["kp = 1001: beyond 0.1 to 1000, in which gains are tuned"]
    # plain L1 leaves it alone; its range is that of L1 with PI
    assert reasons("l1", integral_gain=0.02) == []
    assert reasons("l1", integral_gain=0.005) == [
        "integral_gain = 0.005: beyond 0.01 to 1000, in which gains are tuned"
    ]
    assert reasons("l1", **{"prediction_error_matrix[1,1]": 0.0}) == [
        "prediction_error_matrix[1,1] = 0: beyond -100 to -0.001, in which gains are tuned"
    ]


@pytest.mark.slow
def test_who_fails_the_nominal_case_has_no_delay_margin_and_no_mark(small: Protocol) -> None:
    idle = replace(built_in(small, "l1-pi"), name="idle", parameters={"voltage_limit": 1e-6})
    document = score_controllers([idle], small, beside=[tuned(small, "l1-pi")], seed=5).document
    row, other = document.rows
    assert row.unranked
    assert all(reason.startswith("Nominal: ") for reason in row.unranked)
    assert np.isnan(row.delay_margin)
    assert other.delay_margin > 0.0
    assert other.delay_margins == [other.delay_margin]  # one noise, without --full
    for table in (of_metric(document, "total_variation"), of_metric(document, "effort")):
        assert not any(cell.is_best for cell in table.cells[0])


LEARNING = """
from pathlib import Path
from tempfile import gettempdir

by_global = [False]


class {name}:
    period = 0.04
    by_class = [False]

    def reset(self):
        self.notes = Path("notes"), Path(__file__).with_name("notes"), Path(gettempdir(), "notes")
        self.learnt = any(path.exists() for path in self.notes) or self.by_class[0] or by_global[0]

    def step(self, time, inputs):
        if time > 100.0:
            self.by_class[0] = by_global[0] = True
            for path in self.notes:
                path.touch()
        pid = 8.0 * (inputs["depth_reference"] - inputs["measured_depth"])
        return {{"control_force": pid + 50.0 * self.learnt}}
"""


@pytest.mark.slow
def test_neither_a_class_attribute_nor_a_global_nor_a_file_passes_notes_between_runs(
    small: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A controller that finds a note of an earlier run, or of its sibling, pushes down by 50 N."""
    monkeypatch.chdir(tmp_path)
    rmse, errors = declared(small.nominal, small, ["rmse"]), list[float]()
    runs = [ClosedLoopRun(small.nominal, partial(metrics_of, metrics=rmse))] * 2
    for name in ("First", "Second"):
        Path(f"{name}.py").write_text(LEARNING.format(name=name), encoding="utf-8")
        with LocalRuns(1, isolate=True) as local:
            loop = ClosedLoop(Controller(name, f"{name}.py:{name}"), small, LimitedRuns(local))
            errors += [metrics["rmse"] for metrics in loop.results(runs)]
    assert len(errors) == 4
    assert len({*errors}) == 1
    assert errors[0] < 100.0  # cm, of a weak law; a push by 50 N sinks it
    assert not Path("notes").exists()


@pytest.mark.slow
def test_every_row_keeps_the_bounds_of_the_search_or_has_no_mark(small: Protocol) -> None:
    """A built-in row is held to them as a scored one is."""
    quick = Controller("quick", "PidDepthController", parameters={"kp": 110.0})
    beside = [tuned(small, "l1-pi"), replace(quick, name="built-in")]
    document = score_controllers([quick], small, beside=beside).document
    mine, good, other = document.rows
    assert good.unranked == []
    assert mine.unranked == other.unranked
    # in some noise, which is drawn, it does not settle either, which is told first
    reason = next(reason for reason in mine.unranked if reason != "Nominal: not settled")
    assert re.search(r"Nominal, practice: total_variation \d+ N, above 1000", reason)
    assert mine.unranked[-1] == "practice: not quiet with a delay of 0.1 s, the bound of the search"
    for table in (of_metric(document, "rmse"), of_metric(document, "effort")):
        assert [cell.is_best for cell, *_ in table.cells] == [False, True, False]
    assert document.seed_is_given is False


def test_the_bound_on_the_variation_is_carried_to_a_vehicle_by_its_inertia(protocol: Protocol) -> None:
    bound = protocol.tables.cost.bounds["total_variation"]
    assert on_vehicle(protocol) is protocol
    other = on_vehicle(read_protocol(vehicle=Vehicle.of("BlueRov2Plant")))
    assert other.tables.cost.bounds["total_variation"] == pytest.approx(bound * 32.18 / 5.5)
    assert other.tables.cost.bounds["overshoot"] == protocol.tables.cost.bounds["overshoot"]
    nameless = replace(other.vehicle, file=replace(other.vehicle.file, data={}), described=VehicleFile())
    unknown = on_vehicle(read_protocol(vehicle=nameless))
    assert unknown.tables.cost.bounds["total_variation"] > 1e300
    assert not unknown.scales_gains
