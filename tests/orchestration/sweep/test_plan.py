"""What a sweep draws and lays out, and what it is told when its table says something wrong."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from orchestration.errors import OrchestrationError
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.sweep.distributions import (
    Distribution,
    choice,
    integers,
    lognormal,
    loguniform,
    normal,
    triangular,
    uniform,
)
from orchestration.sweep.plan import Plan, plan
from orchestration.system.signals import Constant
from tests.described_fmus import described, redescribed

Make = Callable[..., Plan]
MANY = 2000


def of_u(declared: str, samples: int = MANY) -> str:
    return f'[sweep]\nsamples = {samples}\nseed = 3\n[sweep.vary."r.u"]\n{declared}\n'


def drawn(made: Plan, name: str = "r.u") -> list:
    return [made.values(number)[name] for number in range(made.count)]


@pytest.mark.parametrize(
    ("declared", "values"),
    [
        ('distribution = "normal"\nmean = 3.0\nstd = 0.5', [3.0519424429725666, 2.360180400861264]),
        ('distribution = "uniform"\nlow = -1.0\nhigh = 2.0', [0.6241089477901831, -0.6989919140152008]),
        ('distribution = "lognormal"\nmedian = 2.0\nsigma = 0.4', [2.0848588079287222, 1.198764569736133]),
        ('distribution = "loguniform"\nlow = 0.1\nhigh = 10.0', [1.209871644906887, 0.15873476644406492]),
        (
            'distribution = "triangular"\nlow = 0.0\nmode = 1.0\nhigh = 4.0',
            [1.6540323512803363, 0.6335172567865843],
        ),
    ],
)
def test_a_seed_gives_the_draws_of_earlier_releases(
    planned: Make, declared: str, values: list[float]
) -> None:
    """But for last bits, in which exp, log and the inverse of the normal distribution may differ."""
    assert drawn(planned(of_u(declared, 2))) == pytest.approx(values, rel=1e-15, abs=0.0)


@pytest.mark.parametrize(
    ("made", "law", "ends"),
    [
        (normal(0.0, 0.1, -0.3, 0.3), stats.norm(0.0, 0.1), (-0.3, 0.3)),
        (lognormal(7.0, 0.35, high=20.0), stats.lognorm(0.35, scale=7.0), (0.0, 20.0)),
        (uniform(-0.7, 2.3), stats.uniform(-0.7, 2.3 - -0.7), (-0.7, 2.3)),
        (loguniform(0.0003, 0.002), stats.loguniform(0.0003, 0.002), (0.0003, 0.002)),
        (triangular(5.0, 5.5, 7.0), stats.triang(0.25, 5.0, 2.0), (5.0, 7.0)),
    ],
)
def test_draws_are_the_quantiles_of_scipy(made: Distribution, law: Any, ends: tuple) -> None:
    """But for rounding: of the probabilities of the ends, times at most 230 (1 / density) at 3 std. At 0 it
    is the lower end.
    """
    uniforms = np.random.default_rng(1).random(MANY)
    begin, end = law.cdf(ends)
    expected = law.ppf(begin + uniforms * (end - begin)).clip(*ends)
    np.testing.assert_allclose(made.quantile(uniforms.tolist()), expected, rtol=1e-13, atol=1e-13 * ends[1])
    assert made.quantile([0.0]) == [ends[0]]


@pytest.mark.parametrize(
    "made", [normal(3.0, 0.5, 2.0, 4.0), lognormal(2.0, 0.4, 1.0), loguniform(3e-4, 2e-3)]
)
def test_a_draw_at_the_end_of_its_range_is_not_rounded_beyond_it(made: Distribution) -> None:
    """Without a limit each of these is: at the least or at the largest number that is drawn."""
    first, last = made.quantile([0.0, math.nextafter(1.0, 0.0)])
    assert made.reach[0] <= first < last <= made.reach[1]


def test_a_choice_without_weight_is_never_taken_and_each_begins_where_the_one_before_ends() -> None:
    assert choice(["never", "first", "second", "neither"], [0, 1, 3, 0]).quantile(
        [0.0, math.nextafter(0.25, 0.0), 0.25, math.nextafter(1.0, 0.0)]
    ) == ["first", "first", "second", "second"]  # fmt: skip


def test_each_integer_has_an_equal_part_of_the_draws_both_ends_included() -> None:
    draws = [0.0, math.nextafter(0.25, 0.0), 0.25, 0.5, 0.75, math.nextafter(1.0, 0.0)]
    assert integers(3, 6).quantile(draws) == [3, 3, 4, 5, 6, 6]


@pytest.mark.usefixtures("scenario_fmus")
def test_a_seed_is_a_whole_number_from_the_range_of_its_variable(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    seeds = '[sweep]\nsamples = 50\n[sweep.vary."plant.sensor_seed"]\ndistribution = "seed"\n'
    path.write_text('base = "nominal-extended"\n' + seeds)
    seeds = drawn(plan(scenario.load(path)), "plant.sensor_seed")
    assert all(isinstance(seed, int) and 1 <= seed <= 2147483397 for seed in seeds)
    assert len(set(seeds)) == 50


def test_a_sample_depends_on_the_seed_and_its_number_alone(planned: Make) -> None:
    short, long = planned(), planned(name="long", sweep=_drawn(samples=100))
    assert [short.values(i) for i in range(12)] == [long.values(i) for i in reversed(range(12))][::-1]
    other = planned(name="other", sweep=_drawn(seed=8))
    assert not set(drawn(short)) & set(drawn(other))
    assert len(set(drawn(long))) == 100


def test_a_block_of_samples_is_that_of_each_alone_to_the_last_bit(planned: Make) -> None:
    laws = [
        'distribution = "normal"\nmean = 3.0\nstd = 0.5\nlow = 2.0',
        'distribution = "lognormal"\nmedian = 2.0\nsigma = 0.4',
        'distribution = "loguniform"\nlow = 0.1\nhigh = 10.0',
        'distribution = "triangular"\nlow = 0.0\nmode = 1.0\nhigh = 4.0',
        'distribution = "choice"\nvalues = [1.0, 5.0, 9.0]',
    ]
    for law in laws:
        made = planned(of_u(law, 50) + '[sweep.vary."r.longest_step"]\nvalues = [0.1, 0.2]\n')
        alone = [made.values(number) for number in (99, 3, 50)]
        assert made.block([99, 3, 50]) == alone


def test_a_variable_that_is_added_at_the_end_leaves_the_draws_of_the_others(planned: Make) -> None:
    added = '[sweep.vary."r.longest_step"]\ndistribution = "uniform"\nlow = 0\nhigh = 1\n'
    assert drawn(planned(_drawn() + added, name="more")) == drawn(planned())


def test_variables_of_one_sample_are_independent(planned: Make) -> None:
    made = planned(_drawn(samples=MANY))
    correlation: Any = stats.pearsonr(drawn(made), drawn(made, "r.misdeed_time"))
    assert correlation.pvalue > 1e-3  # of a fixed seed


def test_grids_combine_as_full_factorial_the_first_one_slowest(planned: Make) -> None:
    grid = '[sweep.vary]\n"r.u" = { linspace = [0, 1, 3] }\n"r.misdeed" = { values = ["none", "warning"] }\n'
    made = planned(grid)
    samples = [tuple(made.values(i).values()) for i in range(made.count)]
    assert samples == [(u, misdeed) for u in (0.0, 0.5, 1.0) for misdeed in ("none", "warning")]


def test_a_grid_beside_a_distribution_gets_its_samples_at_each_point(planned: Make) -> None:
    made = planned(_drawn(samples=5) + '[sweep.vary."r.longest_step"]\nvalues = [0.1, 0.2]\n')
    assert drawn(made, "r.longest_step") == 5 * [0.1] + 5 * [0.2]
    assert len(set(drawn(made))) == 10


def test_relative_values_are_factors_of_the_scenarios_own(planned: Make) -> None:
    assert drawn(planned('[sweep.vary."r.u"]\nrelative = true\nvalues = [0.5, 1, 2]\n')) == [1.0, 2.0, 4.0]


@pytest.mark.usefixtures("scenario_fmus")
def test_truncation_keeps_to_the_range_of_the_fmu(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    declared = 'relative = true\ndistribution = "normal"\nmean = 0.5\nstd = 1.0'
    text = f'base = "nominal-l1"\n[sweep]\nsamples = 300\n[sweep.vary."plant.inertia"]\n{declared}\n'
    path.write_text(text)
    with pytest.raises(
        OrchestrationError, match=r"plant.inertia: it reaches -inf to inf, permitted is 0.018"
    ):
        plan(scenario.load(path))
    path.write_text(text + "truncate = true\n")
    inertias = drawn(plan(scenario.load(path)), "plant.inertia")
    assert 0.1 <= min(inertias) < 0.5  # kg; without truncation a third would be below 0


def test_a_relative_draw_about_a_negative_value_keeps_to_the_range_of_the_fmu(tmp_path: Path) -> None:
    """Of -2 with the range -3 to 1 the factors are -0.5 to 1.5: the limits change places."""
    plain = described(tmp_path / "plain.fmu", inputs=["u"])
    fmu = redescribed(plain, tmp_path / "r.fmu", lambda xml: xml.replace("<Real ", '<Real min="-3" max="1" '))
    experiment = "[experiment]\nstop_time = 1.0\nstep_size = 0.1\n"
    text = f"[components]\nr = '{fmu}'\n{experiment}" + '[inputs]\n"r.u" = -2.0\n'
    declared = 'relative = true\ndistribution = "normal"\nmean = 1.0\nstd = 2.0\ntruncate = true'
    path = tmp_path / "negative.toml"
    path.write_text(text + of_u(declared, 500))
    values = drawn(plan(scenario.load(path)))
    assert -3.0 <= min(values) < -2.9
    assert 0.9 < max(values) <= 1.0


@pytest.mark.parametrize("name", ["sample", "warned", "error"])
def test_a_metric_with_the_name_of_a_column_of_the_table_is_refused(
    sweep_file: Callable[..., Path], name: str
) -> None:
    metric = f'[metrics.{name}]\nfunction = "mean"\nsignal = "r.y"\n'
    with pytest.raises(OrchestrationError, match=f"metric {name}: expected another name"):
        plan(scenario.load(sweep_file(of_u(UNIFORM) + metric)))


@pytest.mark.parametrize(
    ("more", "arriving"),
    [
        ({"faults": [{"input": "r.u", "kind": "offset", "value": 0.5}]}, 2.0),
        ({"signals": {"r.u": {"kind": "constant", "value": 2.0}}}, 1.5),
    ],
    ids=["a fault on it", "a constant signal"],
)
def test_a_constant_is_varied_also_if_a_signal_carries_it(
    sweep_file: Callable[..., Path], more: dict[str, Any], arriving: float
) -> None:
    file = sweep_file('[sweep.vary."r.u"]\nrelative = true\nvalues = [0.25, 0.75]\n')
    made = plan(scenario.load(file, more))
    assert drawn(made) == [0.5, 1.5]
    sample = made.of_sample(1)
    assert sample.experiment.signals == {"r.u": Constant(1.5)}
    assert sample.resolved["signals"] == {"r.u": {"kind": "constant", "value": 1.5}}
    assert simulate(sample.system, sample.experiment)["r.u"][0] == arriving


def test_settings_of_the_experiment_can_be_varied(planned: Make) -> None:
    grid = '[sweep.vary]\n"experiment.step_size" = { values = [0.01, 0.02] }\n'
    made = planned(grid + '"experiment.algorithm" = { values = ["jacobi"] }\n')
    assert made.of_sample(1).experiment.step_size == 0.02
    assert made.of_sample(1).resolved["experiment"] == {
        "stop_time": 1.0, "step_size": 0.02, "algorithm": "jacobi",
    }  # fmt: skip


def test_a_sample_is_a_scenario_of_its_own(planned: Make) -> None:
    made = planned()
    one, values = made.of_sample(4), made.values(4)
    assert one.experiment.inputs == {"r.u": values["r.u"]}
    assert one.experiment.parameters == {"r.misdeed_time": values["r.misdeed_time"]}
    assert one.resolved["inputs"] == one.experiment.inputs
    assert one.resolved["parameters"] == one.experiment.parameters
    assert "sweep" not in one.resolved
    assert one.name == "mine.sample-4"


def test_an_entry_of_the_base_can_be_replaced_or_dropped(
    planned: Make, sweep_file: Make, tmp_path: Path
) -> None:
    planned()
    path = tmp_path / "above.toml"
    above = 'base = "mine.toml"\n[sweep]\nsamples = 3\n[sweep.vary]\n"r.u" = { values = [5] }\n'
    path.write_text(above + '"r.misdeed_time" = false\n')
    with pytest.raises(OrchestrationError, match=r"above.toml:2: sweep: samples = 3: expected 1 or none"):
        plan(scenario.load(path))
    path.write_text(above.replace("= 3", "= 1") + '"r.misdeed_time" = false\n')
    assert plan(scenario.load(path)).count == 1
    path.write_text(above)
    made = plan(scenario.load(path))
    assert (made.count, set(drawn(made)), made.seed) == (3, {5.0}, 7)


def _drawn(samples: int = 12, seed: int = 7) -> str:
    first = f'[sweep]\nsamples = {samples}\nseed = {seed}\n[sweep.vary."r.u"]\n'
    second = '[sweep.vary."r.misdeed_time"]\ndistribution = "normal"\nmean = 100.0\nstd = 1.0\n'
    return first + 'distribution = "uniform"\nlow = 1.0\nhigh = 3.0\n' + second


UNIFORM = 'distribution = "uniform"\nlow = 1.0\nhigh = 3.0'


@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        ("", r"mine: sweep: expected a table \[sweep.vary"),
        ("[sweep]\nsampels = 3\n", r"unknown key 'sampels'; nearest is 'samples'"),
        ('[sweep.vary."r.u"]\n' + UNIFORM, r"sweep: samples is missing"),
        (of_u(UNIFORM, 0), r"samples = 0: expected 1 or more"),
        (of_u(UNIFORM).replace("seed = 3", "seed = -3"), r"seed = -3: expected 0 or more"),
        (of_u(UNIFORM).replace("seed = 3", "timeout = 0"), r"timeout = 0: expected more than 0"),
        ('[sweep.vary."r.u"]\nvalue = [1]', r"the keys distribution, values, linspace; nearest is 'values'"),
        ('[sweep.vary]\n"r.u" = 3', r'vary."r.u" = 3: expected a table'),
        ('[sweep.vary."r.misded"]\nvalues = [1]', r"no variable 'r.misded'; nearest is 'r.misdeed'"),
        ('[sweep.vary."s.u"]\nvalues = [1]', r"no component 's'"),
        ('[sweep.vary."r.y"]\nvalues = [1]', r"r.y: expected a parameter or an input, got output"),
        ('[sweep.vary."experiment.step"]\nvalues = [1]', r"nearest is 'experiment.step_size'"),
        ('[sweep.vary."experiment.step_size"]\nvalues = [0]', r"step_size = 0: expected more than 0 s"),
        ('[sweep.vary."experiment.algorithm"]\nvalues = ["jakobi"]', r"nearest is 'jacobi'"),
        ('[sweep.vary."r.u"]\nvalues = []', r"values = \[\]: expected 1 or more items"),
        ('[sweep.vary."r.u"]\nvalues = ["a"]', r"r.u = 'a': expected a number"),
        ('[sweep.vary."r.u"]\nvalues = [1]\nlow = 3', r"vary.\"r.u\": unknown key 'low'; known: 'rel"),
        ('[sweep.vary."r.u"]\nlinspace = [0, 1, 1_000_000_000]', r"expected .*, 2 to 10000000 of them"),
        ('[sweep.vary."r.u"]\nlinspace = [0, 1, 1e300]', r"linspace = .*: expected"),
        (of_u(UNIFORM, 10**12), r"1000000000000 samples, .*: expected at most 10000000"),
        (of_u(UNIFORM, 10**7) + '[sweep.vary."r.misdeed"]\nvalues = ["none", "hang"]', r"20000000 samples"),
        ('[sweep.vary."r.u"]\nlinspace = [1, 2]', r"linspace = \[1, 2\]: expected 3 or more items"),
        (
            '[sweep.vary."r.misdeed"]\nvalues = ["non"]',
            r"r.misdeed = 'non': expected one of none \(1\), warning",
        ),
        ('[sweep.vary."r.misdeed"]\nvalues = ["none"]\nrelative = true', r"relative: expected a Real"),
        ('[sweep.vary."r.misdeed_time"]\nvalues = [1]\nrelative = true', r"expected a Real that is not 0"),
        ('[sweep.vary."r.u"]\nvalues = [1]\nrelative = 1', r"relative = 1: expected true or false"),
        (of_u('distribution = "norml"'), r"unknown distribution 'norml'; nearest is 'normal'"),
        (of_u('distribution = "normal"\nmean = 1.0'), r"vary.\"r.u\".std is missing"),
        (of_u('distribution = "normal"\nmean = 1.0\nsigma = 1.0'), r"vary.\"r.u\": unknown key 'sigma'"),
        (of_u('distribution = "normal"\nmean = "a"\nstd = 1'), r"mean = 'a': expected a number"),
        (of_u('distribution = "normal"\nmean = 1.0\nstd = 0'), r"std = 0.0: expected more than 0"),
        (of_u('distribution = "normal"\nmean = 0\nstd = 1\nlow = 99'), r"expected some probability within"),
        (of_u('distribution = "uniform"\nlow = 3\nhigh = 1'), r"high = 1.0: expected low below high"),
        (of_u('distribution = "triangular"\nlow = 1\nmode = 0\nhigh = 2'), r"mode = 0.0: expected 1 to 2"),
        (of_u(UNIFORM + "\ntruncate = true"), r"vary.\"r.u\": unknown key 'truncate'"),
        (of_u('distribution = "seed"'), r"expected an FMU that gives min and max"),
        (of_u('distribution = "integers"\nlow = 0.5\nhigh = 2'), r"low = 0.5: expected a whole number"),
        (of_u('distribution = "choice"\nvalues = [1]\nweights = [0]'), r"1 numbers that are not all 0"),
        (of_u('distribution = "choice"\nvalues = [1, "a"]'), r"r.u = 'a': expected a number"),
        (of_u(UNIFORM).replace("r.u", "r.misdeed"), r"r.misdeed = 2.0: expected a value of type Enumeration"),
        (
            '[sweep.vary."r.u"]\nvalues = [1]\n[metrics.typo]\nfunction = "mean"\nsignal = "r.z"',
            "metric typo: 'r.z' was not recorded; nearest is 'r.y'",
        ),
        (
            '[sweep.vary."r.u"]\nvalues = [1]\n[metrics.over]\nfunction = "overshoot"\nsignal = "r.y"\n'
            "target = 0.0",
            "metric over: overshoot: target = 0: expected another",
        ),
    ],
)
def test_a_mistake_is_told_before_anything_runs(planned: Make, sweep: str, message: str) -> None:
    with pytest.raises(OrchestrationError, match=message) as caught:
        planned(sweep)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("lines", "place"),
    [
        (
            'samples = 3.5\n[sweep.vary."a.u"]\ndistribution = "uniform"\nlow = 0\nhigh = 1',
            "below.toml:8: sweep: sa",
        ),
        ('samples = 3\n[sweep.vary."a.u"]\ndistribution = "uniforn"', "below.toml:9: sweep: vary"),
        ('samples = 3\n[sweep.vary."a.v"]\nvalues = [1.0]', r"\(\S*below.toml:9\)$"),
    ],
)
def test_a_mistake_below_is_told_with_its_file_and_line(tmp_path: Path, lines: str, place: str) -> None:
    described(tmp_path / "a.fmu", ["u"])
    base = '[components]\na = "a.fmu"\n[experiment]\nstop_time = 1\nstep_size = 0.1\nopen_inputs = "start"\n'
    (tmp_path / "below.toml").write_text(f"{base}[sweep]\n{lines}\n")
    (tmp_path / "s.toml").write_text('base = "below.toml"\n[sweep]\nseed = 5\n')
    with pytest.raises(OrchestrationError, match=place):
        plan(scenario.load(tmp_path / "s.toml"))


@pytest.mark.parametrize(
    ("driver", "cause"),
    [("", "nothing drives it"), ('[signals."a.u"]\nkind = "ramps"\npoints = [[0, 1]]', "is driven by a")],
)
def test_an_input_that_is_not_constant_is_refused_with_the_cause(
    tmp_path: Path, driver: str, cause: str
) -> None:
    described(tmp_path / "a.fmu", ["u"])
    times = '[experiment]\nstop_time = 1\nstep_size = 0.1\nopen_inputs = "start"\n'
    swept = '[sweep.vary."a.u"]\nvalues = [1.0]\n'
    (tmp_path / "s.toml").write_text(f'[components]\na = "a.fmu"\n{times}{driver}\n{swept}')
    with pytest.raises(OrchestrationError, match=f"a.u .*{cause}.*: expected a constant input"):
        plan(scenario.load(tmp_path / "s.toml"))


def test_a_sample_beyond_the_last_is_refused(planned: Make) -> None:
    with pytest.raises(OrchestrationError, match=r"sample 12: expected 0..11"):
        planned().values(12)


def test_every_distribution_is_explained_on_the_page() -> None:
    from orchestration.sweep.distributions import FUNCTIONS

    page = (Path(__file__).parents[3] / "docs" / "how-to" / "sweeps.md").read_text(encoding="utf-8")
    for name in (*FUNCTIONS, "seed"):
        assert f'`"{name}"`' in page
