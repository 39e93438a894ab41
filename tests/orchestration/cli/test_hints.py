"""The hints of messages work when they are followed to the letter."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from orchestration.studies.score.protocol import read_protocol
from orchestration.studies.vehicle import Vehicle
from tests.described_fmus import described

Command = Callable[..., Any]

BLOCK = """
from dataclasses import dataclass
from fmus import numerics
from fmus.block import Block, variable

@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(0.1, "Longest internal step", unit="s", min=1e-3, max=1.0)

@dataclass(frozen=True)
class Inputs:
    x: float = variable(0.5, "A number", min=-10.0, max=10.0)

@dataclass(frozen=True)
class State:
    x: float = 0.0

@dataclass(frozen=True)
class Outputs:
    y: float = variable(0.0, "Output")

def step(t, h, s, u, p, c):
    return State({expression})

def output(t, state, p, c):
    return Outputs(state.x)

BLOCK = Block.of_module(__name__, "Counts", "Counts")
"""


@pytest.fixture
def error(command: Command) -> Callable[..., str]:
    """The last line on standard error of a command that must fail with status 1."""
    return lambda *arguments: command(*arguments, expect=1).stderr.splitlines()[-1]


@pytest.mark.parametrize(
    "own",
    [
        {"measured_depth": "gauge", "voltage[1]": "left", "voltage[2]": "right"},
        {"depth": "gauge", "control_force": "thrust"},
    ],
)
def test_the_mappings_that_messages_ask_for_let_another_plant_run(
    error: Callable[..., str], short_scenario: Callable[..., Path], tmp_path: Path, own: dict[str, str]
) -> None:
    """One name after the other, until nothing is refused but an FMU without a library."""
    short_scenario()
    described(tmp_path / "boat.fmu", [name for name in own.values() if name != "gauge"], ("gauge",))
    hints = []
    for _ in own:
        message = error("run", "short.toml", "--plant", "boat.fmu", *hints)
        shown = re.findall(r"--map plant\.(\S+)=NAME", message)
        (name,) = (name for name in shown if name in own)
        hints += ["--map", f"plant.{name}={own[name]}"]
    assert "boat.fmu has no binary" in error("run", "short.toml", "--plant", "boat.fmu", *hints)


def test_open_inputs_at_their_start_values_are_the_rest_of_what_a_message_asks_for(
    error: Callable[..., str], short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    short_scenario()
    described(tmp_path / "boat.fmu", ("left", "right"), ("measured_depth", "depth_rate"))
    message = error("run", "short.toml", "--plant", "boat.fmu")
    (hint,) = re.findall(r"; (--open-inputs start) leaves its inputs at their start values", message)
    followed = error("run", "short.toml", "--plant", "boat.fmu", *hint.split())
    assert "boat.fmu has no binary" in followed


def test_the_nearest_name_for_a_mapping_can_be_given_as_it_is_shown(
    error: Callable[..., str], short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    short_scenario()
    described(tmp_path / "boat.fmu", ("left", "right"), ("gauge", "speed"))
    options = ("run", "short.toml", "--plant", "boat.fmu")
    message = error(*options, "--map", "plant.measured_dept=gauge")
    (nearest,) = re.findall(r"nearest is '(\S+)'$", message)
    still_lacking = "plant is boat.fmu, which lacks voltage[1], voltage[2];"
    assert still_lacking in error(*options, "--map", f"{nearest}=gauge")


@pytest.mark.parametrize("name", ["score", "tune"])
def test_the_options_that_the_help_shows_are_taken_and_others_are_not(
    command: Command, error: Callable[..., str], name: str
) -> None:
    """Without --plant both commands know one component, the controller: others are refused, not ignored."""
    described_in_help = " ".join(command(name, "--help").stdout.replace("│", " ").split())
    assert "component" not in described_in_help
    assert "Set controller.variable=value; with --plant plant.variable=value." in described_in_help
    for option in ("--set plant.mass=3.0", "--map plant.voltage[1]=left"):
        message = error(name, "PidDepthController", *option.split())
        assert message.startswith(f"l1-depth: {option.partition('=')[0]}: expected controller.")
    assert "--set controller: expected" in error(name, "PidDepthController", "--set", "controller=x.fmu")


@pytest.mark.slow
def test_the_mappings_that_messages_ask_for_give_a_vehicle_to_tune(
    error: Callable[..., str], tmp_path: Path
) -> None:
    """One after the other, until nothing is refused but an FMU without a library."""
    described(tmp_path / "boat.fmu", ("thrust",), ("z",))
    options = ("tune", "PidDepthController", "--free", "kp=1:2", "--plant", "boat.fmu")
    own, hints = {"depth": "z", "control_force": "thrust"}, list[str]()
    for _ in own:
        (hint,) = re.findall(r"(--map \S+)=NAME", error(*options, *hints))
        hints += f"{hint}={own[hint.partition('plant.')[2]]}".split()
    least = ("--evaluations", "1", "--seeds", "1", "--workers", "1", "--cases", "nominal")
    assert "boat.fmu has no binary" in error(*options, *hints, *least)


@pytest.mark.slow
@pytest.mark.parametrize(
    "expression",
    [
        "sum(s.x for _ in range(int(u.x)))",
        "(1.0, 2.0)[int(u.x)]",
        *(
            pytest.param(f"sum(s.x for _ in range({turns}))", marks=pytest.mark.slow)
            for turns in ("1, int(u.x)", "round(u.x)")
        ),
    ],
)
def test_what_is_advised_in_place_of_an_expression_is_not_refused(
    command: Command, error: Callable[..., str], tmp_path: Path, expression: str
) -> None:
    """A constant number of turns, or a choice: `trunc` would be refused in the same place."""
    followed = {
        "use a constant number of turns": "sum(s.x for _ in range(3))",
        "use fmus.numerics.choose": "numerics.choose(u.x, (1.0, 2.0))",
    }
    block = tmp_path / "counts.py"
    block.write_text(BLOCK.replace("{expression}", expression))
    advice = error("build", "counts.py").rpartition("; ")[2]
    block.write_text(BLOCK.replace("{expression}", followed[advice]))
    command("build", "counts.py")


POLICY = """
class Helper:
    def reset(self): ...


class Pd:
    period = 0.02
    kp = 4.0

    def reset(self): ...

    def step(self, time, inputs):
        return {"control_force": self.kp * (inputs["depth_reference"] - inputs["measured_depth"])}
"""


@pytest.mark.slow
def test_a_file_of_a_class_without_a_block_offers_the_class(
    command: Command, error: Callable[..., str], short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    short_scenario()
    (tmp_path / "laws").mkdir()
    (tmp_path / "laws/mine.py").write_text(POLICY)
    message = error("run", "short.toml", "--controller", "laws/mine.py")
    assert "no block at the top level of the file; expected BLOCK = Block(...), or " in message
    (offered,) = re.findall(r"or (\S+:\w+) for its class Pd$", message)
    assert offered == str(Path("laws/mine.py:Pd"))
    command("run", "short.toml", "--controller", offered, "--formats", "none")


def test_a_variable_without_its_component_is_offered_with_it(
    command: Command, error: Callable[..., str], short_scenario: Callable[..., Path]
) -> None:
    short_scenario()
    options = ("run", "short.toml", "--controller", "PidDepthController", "--formats", "none")
    message = error(*options, "--set", "kp=10")
    assert message == ("l1-depth: kp = '10': no component 'kp' to replace; expected controller.kp=10")
    command(*options, "--set", message.rpartition(" ")[2])
    message = error("run", "short.toml", "--set", "kp=10")  # L1 has none
    assert message.endswith("known: 'controller', 'plant'; of a variable, component.variable=value")
    assert "--set kp: expected controller.kp=value" in error("score", "PidDepthController", "--set", "kp=1")
    assert "mass: expected plant.mass" in error("design", "--plant", "RovDepthPlant", "--set", "mass=3")


def test_an_fmu_whose_outputs_alone_are_not_joined_is_not_said_to_have_open_inputs(
    error: Callable[..., str], short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    short_scenario()
    described(tmp_path / "law.fmu", ("depth_reference", "measured_depth"), ("left", "right"))
    message = error("run", "short.toml", "--controller", "law.fmu")
    undriven, outputs = "plant.voltage[1], plant.voltage[2]", "left, right: name those"
    assert f"which lacks voltage[1]; nothing drives {undriven}; its outputs are {outputs}" in message
    assert "--open-inputs" not in message
    described(tmp_path / "deaf.fmu", ("depth_reference", "measured_depth"), ())
    assert "; its outputs are (none): name" in error("run", "short.toml", "--controller", "deaf.fmu")


@pytest.mark.slow
def test_parameters_of_another_vehicle_ask_for_it(
    command: Command, error: Callable[..., str], short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    """As `fit` writes them."""
    short_scenario()
    command("new", "rover", "--vehicle")
    (tmp_path / "rover-fit.toml").write_text('[parameters."plant.mass"]\nvalue = 6.0\nsource = "a fit"\n')
    options = ("run", "short.toml", "--parameters", "rover-fit.toml", "--formats", "none")
    message = error(*options)
    assert message == (
        "l1-depth: rover-fit.toml: plant.mass: plant is RovDepthPlant, which has no such parameter: "
        "expected the plant that the file is for, --plant FMU"
    )
    hint = message.rpartition(", ")[2].replace("FMU", "rover.py").split()
    command(*options, *hint)
    (tmp_path / "fitted.toml").write_text('base = "nominal-extended"\nparameter_files = ["rover-fit.toml"]\n')
    same = error("run", "fitted.toml").replace("rover-fit.toml:1:", "rover-fit.toml:")
    assert same == message
    command("run", "fitted.toml", *hint, "--formats", "none")
    assert "expected a parameter or an input; nearest is" in error(*options, "--plant", "BlueRov2Plant")


@pytest.mark.parametrize(
    ("options", "is_told"), [((), False), (("--controller", "PidDepthController"), True)]
)
def test_actuators_are_told_only_of_what_the_user_puts_together(
    command: Command, options: tuple[str, ...], is_told: bool
) -> None:
    """The shipped scenario names a vehicle of its own, with the controller for it."""
    run = ("run", "heave-pitch", "--formats", "none")
    assert ("of the actuators of plant" in command(*run, *options).stderr) is is_told


def test_actuators_are_told_of_a_vehicle_that_a_file_of_the_user_names(
    command: Command, short_scenario: Callable[..., Path]
) -> None:
    short_scenario(more='[components]\nplant = "RovHeavePitchPlant"\n')
    told = command("run", "short.toml", "--formats", "none").stderr
    assert "of the actuators of plant: controller.voltage_limit = 12" in told


@pytest.mark.slow
def test_inspect_takes_what_other_commands_take(command: Command, error: Callable[..., str]) -> None:
    command("new", "rover", "--vehicle")
    for given, name in (("BlueRov2Plant", "BlueRov2Plant"), ("rover.py", "Rover")):
        assert command("inspect", given).stdout.startswith(f"{name}: ")
    assert "nearest is 'BlueRov2Plant'" in error("inspect", "BlueRov2Plan")
    assert error("inspect", "rover.fmu").endswith("no FMU at rover.fmu; in that folder, known: none")


@pytest.mark.parametrize("given", ["ExamplePlant", "fmus-built/ExamplePlant.fmu"])
def test_a_block_that_is_not_built_is_told_with_the_command_that_builds_it(
    command: Command, tmp_path: Path, given: str
) -> None:
    message = command("check", given, expect=2).stderr.strip()
    ((built, written),) = re.findall(r"; l1-depth (build \S+) writes (\S+)$", message)
    command(*built.split())
    assert (tmp_path / written).is_file()


@pytest.mark.parametrize("name", ["design", "fit"])
def test_what_is_no_vehicle_is_told_which_variables_one_has(
    error: Callable[..., str], tmp_path: Path, name: str
) -> None:
    """Its outputs are listed, not its hundred parameters."""
    (tmp_path / "dive.csv").touch()
    options = ("--data", "dive.csv", "--free", "kp") if name == "fit" else ("--plant",)
    message = error(name, *options, "L1DepthController")
    assert message.startswith(
        "l1-depth: plant is L1DepthController, which lacks plant.depth, so it is no vehicle: expected an "
        "output depth, and an input control_force or inputs voltage[1] and voltage[2]; name the output that "
        "stands for it by --map plant.depth=NAME; its outputs are voltage[1], voltage[2], demanded_force,"
    )
    assert re.search(r" and \d+ more$", message)
    assert len(message) < 500


@pytest.mark.slow
def test_a_score_names_the_file_in_which_a_disturbance_is_missing(command: Command, tmp_path: Path) -> None:
    """A case is played as soon as it stands there."""
    command("new", "rover", "--vehicle")
    protocol = read_protocol(vehicle=Vehicle.of("rover.py"))
    reason = protocol.left_out["inertia-low"]
    (file,) = re.findall(
        r"rover has no disturbance inertia-low, .*: expected each in (\S+) beside it", reason
    )
    (tmp_path / file).write_text('[disturbances.inertia-low]\nparameters = { "plant.mass" = 5.0 }\n')
    assert "inertia-low" in read_protocol(vehicle=Vehicle.of("rover.py")).cases


@pytest.mark.slow
def test_a_design_does_not_name_parameters_that_it_designs(command: Command, tmp_path: Path) -> None:
    command("new", "rover", "--vehicle")
    (tmp_path / "rover.vehicle.toml").write_text(
        '[variables]\ninertia = "mass"\nnet_weight = "net_weight"\nsensor_period = "sensor_period"\n'
    )
    stderr = command("design", "--plant", "rover.py", "--bandwidth", "99", expect=1).stderr
    assert "no L1 for rover" in stderr
    assert "of the actuators" not in stderr
