"""The Simulink script: run by GNU Octave with functions that record instead of Simulink's."""

import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest

from orchestration.exchange import simulink
from orchestration.scenarios import scenario

# each records its arguments on a line, fields divided by tabs
_RECORD = """\
function {name}(varargin)
fields = cellfun(@(x) disp_text(x), varargin, 'UniformOutput', false);
printf('%s\\n', strjoin([{{'{name}'}}, fields], '\\t'));
end
function text = disp_text(x)
if ischar(x), text = x; else, text = mat2str(x); end
end
"""
_RECORDED = ("new_system", "add_block", "add_line", "set_param", "save_system", "open_system")
_IS_LOADED = "function answer = bdIsLoaded(varargin)\nanswer = {answer};\nend\n"
_PORTS = """\
function ports = get_param(block, what)
assert(strcmp(what, 'PortHandles'));
{cases}
end
"""


@pytest.fixture(scope="module")
def chosen() -> scenario.Scenario:
    return scenario.load(scenario.find("nominal-extended"))


@pytest.fixture
def octave(tool: Callable[[str], str], chosen: scenario.Scenario, tmp_path: Path) -> Callable[..., tuple]:
    """Runs the written script: (status, calls, standard error)."""
    program = tool("octave-cli")

    def run(loaded: bool = False, missing_ports: int = 0) -> tuple[int, list[list[str]], str]:
        stubs = tmp_path / "stubs"
        stubs.mkdir()
        for name in _RECORDED:
            (stubs / f"{name}.m").write_text(_RECORD.format(name=name))
        (stubs / "bdIsLoaded.m").write_text(_IS_LOADED.format(answer=str(loaded).lower()))
        cases = [
            f"if any(strfind(block, '/{name}')), ports = struct('Inport', 1:{len(_names(fmu, 'input'))}, "
            f"'Outport', 1:{len(_names(fmu, 'output')) - missing_ports}); end"
            for name, fmu in chosen.system.components.items()
        ]
        (stubs / "get_param.m").write_text(_PORTS.format(cases="\n".join(cases)))
        simulink.write(chosen, tmp_path)
        done = subprocess.run(
            [program, "--norc", "--no-history", "--quiet", "--path", str(stubs), "--eval", simulink.SCRIPT],
            cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        return done.returncode, [line.split("\t") for line in done.stdout.splitlines()], done.stderr

    return run


def _names(fmu: Path, causality: str) -> list[str]:
    return [v.name for v in fmpy.read_model_description(fmu).modelVariables if v.causality == causality]


def _wires(calls: list[list[str]], chosen: scenario.Scenario) -> dict[str, str]:
    """ "component.input" -> what drives it: "component.output", or the name of a source block."""
    components = chosen.system.components
    sources = {}
    for _, _, source, target, *_ in (call for call in calls if call[0] == "add_line"):
        (a, i), (b, j) = source.split("/"), target.split("/")
        if b in components:
            output = f"{a}.{_names(components[a], 'output')[int(i) - 1]}" if a in components else a
            sources[f"{b}.{_names(components[b], 'input')[int(j) - 1]}"] = output
    return sources


def test_every_input_is_driven_once_and_by_what_the_scenario_says(
    octave: Callable[..., tuple], chosen: scenario.Scenario
) -> None:
    status, calls, errors = octave()
    assert (status, errors) == (0, "")
    wires = _wires(calls, chosen)
    drawn = [call[3] for call in calls if call[0] == "add_line"]
    assert len(drawn) == len(set(drawn))
    inputs = {f"{c}.{n}" for c, fmu in chosen.system.components.items() for n in _names(fmu, "input")}
    assert set(wires) == inputs
    blocks = {call[2].split("/")[1]: call for call in calls if call[0] == "add_block"}
    for source, target, *_ in chosen.system.connections:
        assert wires[target] == source
    for target, value in chosen.experiment.inputs.items():
        assert float(blocks[wires[target]][4]) == value
    signal = blocks[wires["controller.depth_reference"]]
    points = chosen.resolved["signals"]["controller.depth_reference"]["points"]
    rows = [[float(x) for x in row.split()] for row in signal[4].strip("[]").split(";")]
    assert rows == points


def test_the_blocks_are_the_fmus_and_step_as_the_scenario_says(
    octave: Callable[..., tuple], chosen: scenario.Scenario
) -> None:
    _, calls, _ = octave()
    fmus = [call for call in calls if call[:2] == ["add_block", "simulink_extras/FMU Import/FMU"]]
    assert [call[4] for call in fmus] == [path.name for path in chosen.system.components.values()]
    settings = [call[2:] for call in calls if call[0] == "set_param"]
    steps = [
        setting[setting.index("FMUSampleTime") + 1] for setting in settings if "FMUSampleTime" in setting
    ]
    assert [float(step) for step in steps] == [chosen.experiment.step_size] * 2
    (solver,) = [setting for setting in settings if "FixedStep" in setting]
    assert float(solver[solver.index("FixedStep") + 1]) == chosen.experiment.step_size
    assert float(solver[solver.index("StopTime") + 1]) == chosen.experiment.stop_time


def test_every_parameter_of_the_scenario_that_is_no_start_value_is_set(
    octave: Callable[..., tuple], chosen: scenario.Scenario
) -> None:
    _, calls, _ = octave()
    model = next(call[1] for call in calls if call[0] == "new_system")
    given = {
        f"{call[1].removeprefix(model + '/')}.{call[2]}": call[3]
        for call in calls
        if call[0] == "set_param" and "/" in call[1] and not call[2].startswith("FMU")
    }
    for name, value in chosen.experiment.parameters.items():
        component, variable = name.split(".")
        description = fmpy.read_model_description(chosen.system.components[component])
        start = next(v.start for v in description.modelVariables if v.name == variable)
        expected = 2 if value == "pi" else value
        assert float(given.get(name, start)) == expected


def test_an_fmu_with_other_ports_is_refused(octave: Callable[..., tuple]) -> None:
    status, _, errors = octave(missing_ports=1)
    assert status == 1
    assert "expected 12 inputs and 7 outputs, got 12 and 6" in errors


def test_a_model_that_is_open_is_left_alone(octave: Callable[..., tuple]) -> None:
    status, calls, errors = octave(loaded=True)
    assert (status, calls) == (1, [])
    assert "is open: close it first" in errors


def test_block_names_are_identifiers_and_none_is_used_twice(chosen: scenario.Scenario) -> None:
    """MATLAB truncates identifiers after 63 characters."""
    names = re.findall(r"^(?:drive|show)\(model, '(\w+)'", simulink.text(chosen), re.M)
    assert len(names) == len(set(names)) > 15
    assert all(len(name) <= 63 for name in names)
