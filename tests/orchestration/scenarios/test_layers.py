"""A scenario over its base: what `false` removes, and which driver of an input counts."""

from pathlib import Path

import pytest

from orchestration.errors import ScenarioError
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.system.prepared_run import prepare
from orchestration.system.system import LinearTransformation
from tests.described_fmus import described

BASE = """
connections = [["a.y", "b.u"], ["a.y", "b.v"]]
record = ["a.y", "b.u"]
[components]
a = "a.fmu"
b = "a.fmu"
[experiment]
stop_time = 1.0
step_size = 0.1
[parameters]
"a.p" = 1.0
"a.on" = true
[inputs]
"a.u" = 1.0
[signals]
"a.v" = { kind = "constant", value = 2.0 }
"""


def load(folder: Path, text: str, base: str = BASE, inputs: tuple[str, ...] = ("u", "v")) -> Scenario:
    described(folder / "a.fmu", inputs, ("y", "z"), ("p", "on:Boolean"))
    (folder / "base.toml").write_text(base)
    (folder / "child.toml").write_text('base = "base.toml"\n' + text)
    return scenario.load(folder / "child.toml")


def test_false_removes_parameters_inputs_and_signals(tmp_path: Path) -> None:
    text = '[parameters]\n"a.p" = false\n[inputs]\n"a.u" = false\n[signals]\n"a.v" = false\n'
    experiment = load(tmp_path, text).experiment
    assert (experiment.parameters, experiment.inputs, experiment.signals) == ({"a.on": True}, {}, {})


def test_false_is_the_value_of_a_boolean_parameter_and_of_a_boolean_input_that_a_signal_drives(
    tmp_path: Path,
) -> None:
    loaded = load(tmp_path, '[parameters]\n"a.on" = false\n')
    assert loaded.experiment.parameters == {"a.p": 1.0, "a.on": False}
    base = BASE + '"a.open" = { kind = "constant", value = 1.0 }\n'
    experiment = load(tmp_path, '[inputs]\n"a.open" = false\n', base, ("u", "v", "open:Boolean")).experiment
    assert experiment.inputs == {"a.u": 1.0, "a.open": False}
    assert list(experiment.signals) == ["a.v"]


def test_tables_change_the_lists_of_connections_and_records(tmp_path: Path) -> None:
    text = (
        '[connections]\n"b.u" = "a.z"\n"b.v" = false\n[record]\n"b.u" = false\n"a.z" = true\n"a.y" = true\n'
    )
    loaded = load(tmp_path, text)
    assert loaded.system.connections == (("a.z", "b.u"),)
    assert loaded.experiment.record == ("a.y", "a.z")
    assert loaded.resolved["connections"] == [["a.z", "b.u"]]


def test_a_list_replaces_that_of_the_base(tmp_path: Path) -> None:
    loaded = load(tmp_path, 'connections = [["a.z", "b.v"]]\nrecord = ["a.z"]\n')
    assert loaded.system.connections == (("a.z", "b.v"),)
    assert loaded.experiment.record == ("a.z",)


def test_a_component_can_be_removed_with_all_that_names_it(tmp_path: Path) -> None:
    base = BASE + "[step_sizes]\na = 0.2\nb = 0.2\n"
    loaded = load(tmp_path, "[components]\nb = false\n", base)
    assert loaded.experiment.step_sizes == {"a": 0.2}
    assert list(loaded.system.components) == ["a"]
    assert (loaded.system.connections, loaded.experiment.record) == ((), ("a.y",))


@pytest.mark.parametrize(
    ("text", "connections", "inputs", "signals"),
    [
        ('[inputs]\n"b.u" = 3.0\n', ["b.v"], ["a.u", "b.u"], ["a.v"]),
        ('[inputs]\n"a.v" = 3.0\n', ["b.u", "b.v"], ["a.u", "a.v"], []),
        ('[signals]\n"a.u" = { kind = "constant", value = 1 }\n', ["b.u", "b.v"], [], ["a.v", "a.u"]),
        ('[signals]\n"b.u" = { kind = "constant", value = 1 }\n', ["b.v"], ["a.u"], ["a.v", "b.u"]),
        ('[connections]\n"a.u" = "b.y"\n"a.v" = "b.y"\n', ["b.u", "b.v", "a.u", "a.v"], [], []),
        ('connections = [["b.y", "a.u"]]\n', ["a.u"], [], ["a.v"]),
    ],
)
def test_an_input_is_driven_as_the_uppermost_layer_says(
    tmp_path: Path, text: str, connections: list[str], inputs: list[str], signals: list[str]
) -> None:
    loaded = load(tmp_path, text)
    assert [target for _, target, *_ in loaded.system.connections] == connections
    assert list(loaded.experiment.inputs) == inputs
    assert list(loaded.experiment.signals) == signals


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[signals]\n"a.w" = false\n', r'child.toml:3: signals."a.w" = false: nothing to remove; nearest'),
        ('[connections]\n"b.w" = false\n', r'connections."b.w" = false: nothing to remove; nearest is'),
        ('[record]\n"a.w" = false\n', r'record."a.w" = false: nothing to remove; nearest is'),
        ("[components]\nc = false\n", r'components."c" = false: nothing to remove'),
        ('[connections]\n"b.u" = 3\n', r'connections."b.u" = 3: expected a text'),
        ('[record]\n"b.u" = 3\n', r'record."b.u" = 3: expected true or false'),
        ('connections = [["a.z", "b.u", { factr = 0.5 }]]', r"connections\[0\]\[2\]: unknown key 'factr'; n"),
        ('[connections]\n"b.u" = { factor = 0.5 }\n', r'connections."b.u".source is missing'),
        ('connections = [["a.z", "b.u", 3]]', r"connections\[0\]\[2\] = 3: expected a table"),
    ],
)
def test_a_change_that_changes_nothing_or_is_wrong_is_refused(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        load(tmp_path, text)


def test_a_table_of_records_needs_a_list_to_change(tmp_path: Path) -> None:
    base = BASE.replace('record = ["a.y", "b.u"]\n', "")
    with pytest.raises(ScenarioError, match=r"record: expected a list; a table changes the list of a base"):
        load(tmp_path, '[record]\n"a.y" = true\n', base)


@pytest.mark.parametrize(
    "text",
    [
        '[connections]\n"b.u" = { source = "a.z", factor = 0.5 }\n"b.v" = false\n',
        'connections = [["a.z", "b.u", { factor = 0.5 }]]\n',
    ],
)
def test_a_connection_can_have_a_factor(tmp_path: Path, text: str) -> None:
    loaded = load(tmp_path, text)
    assert loaded.system.connections == (("a.z", "b.u", LinearTransformation(0.5)),)
    assert loaded.resolved["connections"] == [["a.z", "b.u", {"factor": 0.5}]]


def test_a_fault_on_a_constant_input_makes_it_a_signal(tmp_path: Path) -> None:
    loaded = load(tmp_path, '[[faults]]\ninput = "a.u"\nkind = "drift"\nrate = 0.1\n')
    assert not loaded.experiment.inputs
    assert loaded.experiment.signals["a.u"](0.5) == 1.0
    prepare(loaded.system, loaded.experiment)


def test_a_constant_in_place_of_a_signal_is_without_the_faults_on_it(tmp_path: Path) -> None:
    fault = '[[faults]]\ninput = "a.v"\nkind = "freeze"\n'
    event = '[[events]]\ntime = 0.5\nset = { "a.u" = 2.0 }\n'
    text = '[inputs]\n"a.v" = 1.0\n[signals]\n"a.u" = { kind = "constant", value = 1.0 }\n'
    experiment = load(tmp_path, text, BASE + fault + event).experiment
    assert (list(experiment.inputs), experiment.faults, experiment.events) == (["a.v"], (), ())
