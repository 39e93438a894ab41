"""Scenario files: what they may say, and what they are told when they say something else."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from orchestration.cli.chosen_scenario import load
from orchestration.errors import OrchestrationError, ScenarioError, ScenarioWarning, SystemDefinitionError
from orchestration.scenarios import scenario
from orchestration.scenarios.layers import stated_values
from orchestration.scenarios.toml_file import read_toml
from orchestration.system import prepared_run
from orchestration.system.experiment import Algorithm, Initialisation
from orchestration.system.faults import Delay, Fault
from tests.described_fmus import described

MINIMAL = """
[components]
p = "ExamplePlant"
[experiment]
stop_time = 1
step_size = 0.1
[inputs]
"p.control" = 0.0
"p.disturbance" = 0.0
"""


def write(folder: Path, text: str, name: str = "mine.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_minimal_scenario(tmp_path: Path) -> None:
    loaded = scenario.load(write(tmp_path, MINIMAL))
    assert (loaded.name, loaded.title) == ("mine", "mine")
    assert loaded.experiment.algorithm is Algorithm.JACOBI
    assert loaded.experiment.stop_time == 1.0
    assert loaded.system.components["p"].name == "ExamplePlant.fmu"


def test_faults_the_initialisation_and_the_tolerance_of_fmus_are_taken_over(tmp_path: Path) -> None:
    text = MINIMAL.replace(
        "step_size = 0.1", 'step_size = 0.1\ninitialisation = "newton"\nfmu_tolerance = 1e-6'
    )
    fault = '[[faults]]\ninput = "p.control"\nkind = "delay"\ndelay = 0.2\nend = 0.5\n'
    loaded = scenario.load(write(tmp_path, text + fault))
    assert loaded.experiment.initialisation is Initialisation.NEWTON
    assert loaded.experiment.fmu_tolerance == 1e-6
    assert loaded.experiment.faults == (Fault("p.control", Delay(0.2), end=0.5),)


def test_a_scenario_is_laid_over_its_base_and_overrides_over_both(tmp_path: Path) -> None:
    write(tmp_path, MINIMAL, "base.toml")
    path = write(tmp_path, 'base = "base.toml"\n[experiment]\nstop_time = 2\n[inputs]\n"p.control" = 3.0')
    loaded = scenario.load(path, {"inputs": {"p.disturbance": 4.0}})
    assert loaded.experiment.stop_time == 2.0
    assert loaded.experiment.step_size == 0.1
    assert loaded.experiment.inputs == {"p.control": 3.0, "p.disturbance": 4.0}


def test_parameter_files_lie_under_the_scenario_that_names_them(tmp_path: Path) -> None:
    write(tmp_path, '[parameters."p.omega"]\nvalue = 2.0\nsource = "measured"', "values.toml")
    text = 'parameter_files = ["values.toml"]\n' + MINIMAL
    assert scenario.load(write(tmp_path, text)).experiment.parameters == {"p.omega": 2.0}
    over = text + '[parameters]\n"p.omega" = 3.0\n'
    assert scenario.load(write(tmp_path, over)).experiment.parameters == {"p.omega": 3.0}


def test_parameter_files_of_overrides_lie_over_the_scenario(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Relative to the present folder, the later over the earlier, and below the values beside them."""
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path, MINIMAL + '[parameters]\n"p.omega" = 1.0\n')
    write(
        tmp_path,
        '[parameters]\n"p.omega" = { value = 2.0 }\n"p.internal_step" = { value = 0.1 }',
        "first.toml",
    )
    write(tmp_path, '[parameters]\n"p.omega" = { value = 3.0 }', "second.toml")
    given = {"parameter_files": ["first.toml", tmp_path / "second.toml"]}
    loaded = scenario.load(path, given)
    assert loaded.experiment.parameters == {"p.omega": 3.0, "p.internal_step": 0.1}
    assert [file.path.name for file in loaded.files] == ["second.toml", "first.toml", "mine.toml"]
    assert "parameter_files" not in loaded.resolved
    over = scenario.load(path, {**given, "parameters": {"p.omega": 4.0}})
    assert over.experiment.parameters["p.omega"] == 4.0


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"parameter_files": ["none.toml"]}, r"no file none\.toml"),
        ({"parameter_files": "none.toml"}, r"parameter_files = 'none\.toml': expected a list"),
        ({"base": "nominal-l1"}, r"base = 'nominal-l1': expected it in the scenario file"),
    ],
)
def test_overrides_without_effect_are_refused(tmp_path: Path, overrides: dict, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        scenario.load(write(tmp_path, MINIMAL), overrides)


def test_a_shipped_scenario_can_be_the_base_by_its_name(tmp_path: Path) -> None:
    mine = scenario.load(write(tmp_path, 'base = "nominal-extended"'))
    assert mine.resolved["components"] == {"plant": "RovDepthPlant", "controller": "L1DepthController"}
    with pytest.raises(ScenarioError, match=r"no scenario 'nominal'; nearest is 'nominal-"):
        scenario.load(write(tmp_path, 'base = "nominal"'))


def test_a_window_beyond_the_run_is_refused_before_it(tmp_path: Path) -> None:
    text = 'base = "nominal-extended"\n[experiment]\nstop_time = 60.0\nstep_size = 0.02\n'
    with pytest.raises(ScenarioError, match=r"metric holding_thrust: window \[290.0, 310.0\]: .*0..60 s"):
        scenario.load(write(tmp_path, text))
    with pytest.warns(
        ScenarioWarning, match=r"beyond the run, 0..60 s, .*: settling_time \[0.0, 140.0\], ov"
    ):
        assert scenario.load(write(tmp_path, text + "[metrics]\nholding_thrust = false\n"))


def test_a_metric_of_the_base_can_be_dropped(tmp_path: Path) -> None:
    base = MINIMAL + '[metrics.a]\nfunction = "mean"\nsignal = "p.output"\n'
    write(tmp_path, base, "base.toml")
    assert set(scenario.load(tmp_path / "base.toml").metrics) == {"a"}
    assert not scenario.load(write(tmp_path, 'base = "base.toml"\n[metrics]\na = false\n')).metrics


def test_an_fmu_path_is_relative_to_the_file_that_gives_it(tmp_path: Path) -> None:
    (tmp_path / "lib").mkdir()
    text = MINIMAL.replace('"ExamplePlant"', '"models/mine.fmu"')
    for folder in (tmp_path, tmp_path / "lib"):
        write(folder, text, "base.toml")
        base = (folder / "base.toml").relative_to(tmp_path)
        for path in (folder / "base.toml", write(tmp_path, f"base = '{base}'")):
            assert scenario.load(path).system.components["p"] == folder / "models/mine.fmu"


@pytest.mark.parametrize("name", list(scenario.shipped()))
def test_every_shipped_scenario_loads_and_says_what_it_is(name: str) -> None:
    loaded = scenario.load(scenario.find(name))
    assert loaded.title != name
    assert loaded.metrics


def test_a_metric_of_a_variable_that_is_not_recorded_is_refused_before_the_run(tmp_path: Path) -> None:
    """The parameter exists; named by record, beside what the metrics need, it is recorded."""
    metric = '[metrics.a]\nfunction = "rmse"\nsignal = "p.output"\nreference = "p.omega"\n'
    with pytest.raises(
        ScenarioError, match=r"metric a: 'p.omega' is not recorded; .*; record = \[...\] names all"
    ):
        _ = scenario.load(write(tmp_path, MINIMAL + metric)).prepared
    recorded = scenario.load(write(tmp_path, 'record = ["p.output", "p.omega"]\n' + MINIMAL + metric))
    assert recorded.prepared.recorded == ("p.output", "p.omega")


def test_scenarios_are_found_by_name_or_path_and_misspelt_ones_offer_the_nearest(tmp_path: Path) -> None:
    assert scenario.find("nominal-l1").name == "nominal-l1.toml"
    path = write(tmp_path, MINIMAL)
    assert scenario.find(str(path)) == path
    with pytest.raises(ScenarioError, match=r"no scenario 'nominal-l2'; nearest is 'nominal-l1'"):
        scenario.find("nominal-l2")
    with pytest.raises(ScenarioError, match=r"nearest is 'mine.toml'"):
        scenario.load(scenario.find(str(tmp_path / "mine2.toml")))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("not toml at all [", r"expected TOML: .*\)$"),
        (r'components.p = "C:\users\mine.fmu"', r"expected TOML: .*; a path with \\ needs single quotes"),
        (r'components.p = "C:\mine.fmu"', r"expected TOML: .*; a path with \\ needs single quotes"),
        (MINIMAL.replace("[inputs]", "[input]"), r"unknown key 'input'; nearest is 'inputs'"),
        (MINIMAL.replace("step_size", "stepsize"), r"unknown key 'stepsize'; nearest is 'step_size'"),
        (MINIMAL.replace("stop_time = 1", 'stop_time = "1"'), r"stop_time = '1': expected a number"),
        (MINIMAL.replace("stop_time = 1\n", ""), r"stop_time is missing"),
        (MINIMAL.replace("step_size = 0.1", "step_size = -0.1"), r"communication step size -0.1 s: expected"),
        (MINIMAL.replace("step_size = 0.1\n", ""), r"step_size is missing"),
        ("[experiment]\nstop_time = 1\nstep_size = 0.1", r"components is missing"),
        (MINIMAL.replace("ExamplePlant", "BenchmarkPlan"), r"no block 'BenchmarkPlan'.*'ExamplePlant'"),
        (MINIMAL.replace("[inputs]", 'algorithm = "jakobi"\n[inputs]'), r"'jakobi'; nearest is 'jacobi'"),
        ('connections = [["a.b"]]\n' + MINIMAL, r"connections\[0\] = \['a.b'\]: expected 2 or more items"),
        ('connections = "a"\n' + MINIMAL, r"connections = 'a': expected a list"),
        ('record = "p.output"\n' + MINIMAL, r"record = 'p.output': expected a list"),
        ("events = [{ time = 1.0 }]\n" + MINIMAL, r"events\[0\].set is missing"),
        ("faults = [3]\n" + MINIMAL, r"faults\[0\] = 3: expected a table"),
        (MINIMAL + '[faults]\nkind = "freeze"\n', r"faults = .*: expected a list"),
        (MINIMAL + '[[faults]]\ninput = "p.control"\n', r"faults\[0\]: kind is missing; expected one"),
        (MINIMAL.replace("[inputs]", 'initialisation = "newtn"\n[inputs]'), r"'newtn'; nearest is 'newton'"),
        ('components = "p"\n', r"components = 'p': expected a table"),
        (MINIMAL + '[signals]\n"p.control" = 3\n', r'signals."p.control" = 3: expected a table'),
        (MINIMAL + "[metrics]\na = 3\n", r"metrics.a = 3: expected a table"),
        ("record = [5]\n" + MINIMAL, r"record\[0\] = 5: expected a text"),
        ("title = 2020-01-01\n" + MINIMAL, r"title = .*: expected a text"),
        (MINIMAL.replace('"ExamplePlant"', "5"), r"components.p = 5: expected a text"),
        (MINIMAL.replace("step_size = 0.1", "step_size = 1e-14"), r"1e\+14 .*steps: expected at most 1e\+09"),
        (MINIMAL.replace("[inputs]", "start_time = -inf\n[inputs]"), r"start_time = -inf: expected a fin"),
        (MINIMAL.replace("stop_time = 1", "stop_time = 1" + 400 * "0"), r"stop_time = 10.*: expected a num"),
        ("events = [{ time = 5, set = {} }]\n" + MINIMAL, r"event at 5.0 s: expected a time within the run"),
        ("events = [{ time = nan, set = {} }]\n" + MINIMAL, r"events\[0\].time = nan: expected a finite"),
        ("events = [{ time = 1, set = 5 }]\n" + MINIMAL, r"events\[0\].set = 5: expected a table"),
        (MINIMAL + '[metrics.a]\nfunction = "rms"\n', r"metrics.a: unknown function 'rms'; .*'rmse'"),
        (
            'record = ["p.output"]\n' + MINIMAL + '[metrics.a]\nfunction = "mean"\nsignal = "p.outpt"\n',
            r"metric a: 'p.outpt' is not recorded; nearest is 'p.output'; record = \[...\] names all",
        ),
        (MINIMAL + '[metrics.a]\nfunction = "mean"\n', r"metrics.a.signal is missing"),
        (
            MINIMAL + '[metrics.a]\nfunction = "mean"\nsignal = "x"\nwind = 3\n',
            r"metrics.a: unknown key 'wind'; nearest is 'window'",
        ),
        (
            MINIMAL.replace("[experiment]", 'connections = [["p.output", "p.control"]]\n[experiment]'),
            r"components.connections = .*: expected a text; connections of the file stands above",
        ),
        (
            MINIMAL + 'record = ["p.output"]\n',
            r"inputs.record = .*; record of the file stands above the first \[table\]",
        ),
        (
            MINIMAL + '[metrics.a]\nfunction = "mean"\nsignal = "p.output"\nevents = []\n',
            r"metrics.a: unknown key 'events'; .*; events of the file stands above the first \[table\]",
        ),
        ('base = "none.toml"\n' + MINIMAL, r"no file .*none.toml"),
        ('base = "mine.toml"\n' + MINIMAL, r"is its own base"),
        ("base = 3\n" + MINIMAL, r"base = 3: expected a text"),
        ('parameter_files = ["none.toml"]\n' + MINIMAL, r"no file .*none.toml"),
        ('parameter_files = "none.toml"\n' + MINIMAL, r"parameter_files = 'none.toml': expected a list"),
    ],
)
def test_a_mistake_is_told_with_what_was_expected(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(Exception, match=message) as caught:
        scenario.load(write(tmp_path, text))
    assert isinstance(caught.value, OrchestrationError)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("entry", "message"), [("3", r" = 3: expected a table"), ("{ limit = 3 }", r".value is missing")]
)
def test_a_parameter_file_entry_needs_a_value(tmp_path: Path, entry: str, message: str) -> None:
    path = write(tmp_path, f'[parameters]\n"p.omega" = {entry}')
    with pytest.raises(ScenarioError, match=f'parameters."p.omega"{message}'):
        stated_values(read_toml(path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("title = " + 5000 * "[" + 5000 * "]", "brackets nested too deeply: expected a few levels"),
        ("\ufefftitle = 'a'", "a byte order mark at its start: expected UTF-8 without one"),
        ("title = 'a'\nstop = 1" + 5000 * "0", "an integer of 5001 digits: expected at most 19"),
    ],
)
def test_a_file_that_no_reader_of_toml_takes_is_one_short_line(
    tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=rf"mine\.toml(:2)?: {message}") as caught:
        scenario.load(tmp_path / "mine.toml")
    assert len(str(caught.value)) < 100 + len(str(tmp_path))


def test_a_mistake_in_a_base_names_the_base(tmp_path: Path) -> None:
    write(tmp_path, MINIMAL.replace("step_size", "stepsize"), "base.toml")
    with pytest.raises(ScenarioError, match=r"base.toml:6: experiment: unknown key 'stepsize'"):
        scenario.load(write(tmp_path, 'base = "base.toml"'))


CHILD = 'base = "nominal-l1"\n'


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('[parameters]\n# of "p.omega"\n"p.omega" = []\n', 12),
        ('[[events]]\ntime = 0.5\nset = {}\n[[events]]\ntime = "x"\nset = {}\n', 14),
        ("[[events]]\ntime = 0.5\nset = {}\n[[events]]\nset = {}\n", 13),
        ('[metrics.a]\nfunction = "mean"\nsignal = "p.output"\nwindow = [\n  5.0,\n  6.0,\n]\n', 10),
        ('[signals]\n"p.control" = { kind = "ramps", points = [[1.0, 0.0], [1.0, 2.0]] }\n', 11),
        ('[[faults]]\ninput = "p.control"\nkind = "freeze"\nstart = 2\nend = 1\n', 10),
        ("[step_sizes]\np = 0.15\n", 11),
    ],
)
def test_a_mistake_is_told_with_its_line(tmp_path: Path, text: str, line: int) -> None:
    with pytest.raises(ScenarioError, match=rf"mine\.toml:{line}: "):
        scenario.load(write(tmp_path, MINIMAL + text))


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ('[parameters]\n"plant.inertia" = -1.0', r"mine.toml:3: plant.inertia = -1.0: expected 0.1"),
        (
            '[sweep.vary."plant.inertia"]\nvalues = [5.0]\n[parameters]\n"plant.inertia" = -1.0',
            r"mine.toml:5: plant.inertia = -1.0: expected 0.1",
        ),
        (
            '[[events]]\ntime = 1e6\nset = { "plant.buoyancy_change" = 1.0 }',
            r"mine.toml:2: event at 1000000.0 s: expected",
        ),
        ('[connections]\n"plant.roll" = "plant.dept"', r"mine.toml:3: connection plant.dept -> "),
        ("[step_sizes]\nplent = 0.04", r"mine.toml:3: step size of 'plent': no such component"),
        ("[experiment]\ntolerance = 2.0", r"mine.toml:3: tolerance = 2.0: expected more than 0"),
        ('[[events]]\ntime = 1\nset = { "plant.initial_depth" = 1.0 }', r"mine.toml:4: event at 1.0 s: "),
        ('[metrics.m]\nfunction = "mean"\nsignal = "plant.roll"', r"mine.toml:2: metric m: 'plant.roll' is"),
        ('[inputs]\n"plant.roll" = false', r"mine.toml:3: plant.roll: driven by nothing"),
        ("[experiment]\nstep_size = 500.0", r"mine.toml:3: communication step size 500.0 s: expected"),
    ],
)
def test_a_mistake_that_the_fmus_show_is_told_with_the_line_of_its_name(
    scenario_fmus: None, tmp_path: Path, text: str, place: str
) -> None:
    path = write(tmp_path, CHILD + text)
    with pytest.raises(ScenarioError, match=place):
        load(str(path))


def test_a_mistake_in_a_parameter_file_is_told_after_the_scenario(
    scenario_fmus: None, tmp_path: Path
) -> None:
    (tmp_path / "gains.toml").write_text('[parameters]\n"controller.proportional_gain".value = -9.0\n')
    path = write(tmp_path, 'parameter_files = ["gains.toml"]\n' + CHILD)
    with pytest.raises(ScenarioError, match=r"mine.toml: .*proportional_gain = -9.0: .* \(.*gains.toml:2\)"):
        load(str(path))


@pytest.mark.parametrize("unit", ["N/m", "kg"])
def test_a_value_with_a_unit_of_a_parameter_file_names_its_place_once(
    scenario_fmus: None, tmp_path: Path, unit: str
) -> None:
    entry = f'[parameters]\n"controller.proportional_gain" = {{ value = -9.0, unit = "{unit}" }}\n'
    (tmp_path / "gains.toml").write_text(entry)
    path = write(tmp_path, 'parameter_files = ["gains.toml"]\n' + CHILD)
    with pytest.raises(ScenarioError) as caught:
        load(str(path))
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'gains.toml'}:2: controller.proportional_gain = ")
    assert message.count(".toml") == 1


def test_a_component_of_a_file_has_no_dot_in_its_name(tmp_path: Path) -> None:
    """Those of packages have: "system.component"."""
    described(tmp_path / "f.fmu", ["u"], ["y"])
    text = 'components = {"x.y" = "f.fmu"}\nexperiment = {stop_time = 1, step_size = 0.1}\n'
    with pytest.raises(SystemDefinitionError, match=r"component 'x\.y': expected a name without a dot"):
        scenario.load(write(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "[parameters]\nplant.inertia = 3.0\n",
            'mine.toml:2: parameters: plant.inertia has a dot: quote it, "plant',
        ),
        ('[signals]\nplant.roll = { kind = "constant", value = 0.1 }\n', "signals: plant.roll has a dot"),
        ("[[events]]\ntime = 1.0\n[events.set]\nplant.roll = 0.1\n", r"\[0\].set: plant.roll has a dot"),
    ],
)
def test_a_name_with_a_dot_that_is_not_quoted_is_told_so(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(ScenarioError, match=expected):
        scenario.load(write(tmp_path, CHILD + text))


def test_a_scenario_does_not_take_the_title_of_its_base(tmp_path: Path) -> None:
    child = scenario.load(write(tmp_path, CHILD))
    assert (child.title, child.resolved["title"]) == ("mine", "mine")
    assert scenario.load(write(tmp_path, CHILD + 'title = "Mine"\n')).title == "Mine"


@pytest.mark.parametrize("options", [[], ["--timeout", "60"]])
def test_a_run_at_the_command_line_is_prepared_once(
    command: Callable[..., object],
    scenario_fmus: None,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    options: list[str],
) -> None:
    """In its process and in that of its FMUs: a file of the library counts the calls in both."""
    counted = tmp_path / "prepared"
    prepare_checked = prepared_run.prepare_checked

    def count(*arguments: Any) -> Any:
        with counted.open("a", encoding="utf-8") as lines:
            lines.write("prepared\n")
        return prepare_checked(*arguments)

    monkeypatch.setattr(prepared_run, "prepare_checked", count)
    (tmp_path / "sitecustomize.py").write_text(_COUNTING.format(file=str(counted)), encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    command("run", "nominal-l1", "--formats", "none", *options)
    assert counted.read_text(encoding="utf-8").splitlines() == ["prepared"]


_COUNTING = """
from orchestration.system import prepared_run
prepare_checked = prepared_run.prepare_checked

def count(*arguments):
    with open({file!r}, "a") as lines:
        lines.write("prepared\\n")
    return prepare_checked(*arguments)

prepared_run.prepare_checked = count
"""
