"""Controller and vehicle on a microcontroller give the numbers of their FMUs, bit for bit."""

import os
import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave

from fmus.errors import ExportError
from fmus.firmware.code import firmware_sources
from fmus.firmware.library import write_firmware
from fmus.generate import builder
from fmus.platforms import MICROCONTROLLERS
from orchestration.scenarios import scenario
from orchestration.system.signals import values_at

HOW_TO = Path(__file__).parents[3] / "docs/how-to/microcontroller.md"
H, STEPS = 0.02, 15_500
BLOCKS = {"controller": "L1DepthController", "plant": "RovDepthPlant"}
# outputs of one are inputs of the other
WIRES = [("plant", "measured_depth", "controller", "measured_depth")]
WIRES += [("plant", "depth_rate", "controller", "measured_depth_rate")]
WIRES += [("controller", f"voltage[{i}]", "plant", f"voltage[{i}]") for i in (1, 2)]
# what the predictor computes with a sine, whose last bit differs between C libraries: it is an output alone
OF_SINES = (
    "predicted_depth",
    "predicted_depth_rate",
    "depth_prediction_error",
    "depth_rate_prediction_error",
)
# FNV-1a of 64 bits, a number at a time
OFFSET, PRIME = 14695981039346656037, 1099511628211

# A Cortex-M starts at the address behind that of its stack; coprocessors 10 and 11 are the FPU, which is off.
LOOP = """
#include <math.h>
#include <stdio.h>
#include "L1DepthController.h"
#include "RovDepthPlant.h"
#include "reference.h"
#define PRIME 1099511628211ull
#ifdef __arm__
extern void _start(void);
static void reset(void) {
    *(volatile unsigned *)0xE000ED88 |= 0xFu << 20;
    __asm volatile("dsb\\n isb");
    _start();
}
__attribute__((section(".vectors"), used)) void (*const vectors[])(void) = {(void (*)(void))0x400000, reset};
#endif
static unsigned long long digest = 14695981039346656037ull;
static void add(const void *outputs, unsigned size) {
    for (const unsigned long long *word = outputs; size; size -= 8) digest = (digest ^ *word++) * PRIME;
}
int main(void) {
    static L1DepthController controller = L1DepthController_START;
    static RovDepthPlant plant = RovDepthPlant_START;
    double rate = 0, squares = 0;
    SETTINGS
    for (int i = 0; i < 2; i++) {
        if (RovDepthPlant_initialise(&plant, 0, H)) return 1;
        RovDepthPlant_output(&plant, 0);
        EXCHANGE
        controller.inputs.depth_reference = REFERENCE[0];
        if (L1DepthController_initialise(&controller, 0, H)) return 1;
        L1DepthController_output(&controller, 0);
    }
    for (int i = 0; i < STEPS; i++) {
        EXCHANGE
        controller.inputs.depth_reference = REFERENCE[i];
        squares += pow(plant.outputs.depth - REFERENCE[i], 2);
        L1DepthController_step(&controller, i * H);
        RovDepthPlant_step(&plant, i * H);
        L1DepthController_output(&controller, i * H + H);
        RovDepthPlant_output(&plant, i * H + H);
        rate = controller.outputs.predicted_depth_rate;
        OF_SINES
        add(&controller.outputs, sizeof controller.outputs);
        add(&plant.outputs, sizeof plant.outputs);
    }
    printf("%.17g %.17g %llu %.17g\\n", plant.outputs.depth, rate, digest, sqrt(squares / STEPS));
    return 0;
}
"""


def member(name: str) -> str:
    return name.replace("[", "_").replace("]", "")


class Slave:
    """An FMU for co-simulation whose variables are numbers by name."""

    def __init__(self, fmu: Path) -> None:
        description: Any = fmpy.read_model_description(str(fmu))
        self.variables = {v.name: v for v in description.modelVariables}
        self.fmu = FMU2Slave(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(fmu)),
            modelIdentifier=description.modelName,
            instanceName="it",
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()

    def _called(self, name: str, verb: str, *values: Any) -> Any:
        variable = self.variables[name]
        kind = {"Enumeration": "Integer"}.get(variable.type, variable.type)
        return getattr(self.fmu, f"{verb}{kind}")([variable.valueReference], *([value] for value in values))

    def set(self, name: str, value: Any) -> None:
        self._called(name, "set", value)

    def get(self, name: str) -> float:
        return float(self._called(name, "get")[0])

    def outputs(self) -> list[float]:
        names = [name for name, v in self.variables.items() if v.causality == "output"]
        return [0.0 if name in OF_SINES else self.get(name) for name in names]


def loop_of_fmus(
    built: Mapping[str, Path], settings: Mapping[str, Any], reference: np.ndarray
) -> tuple[float, float, int, float]:
    """Returns last depth [m] and predicted depth rate [m/s], digest of all outputs, RMS error [m]."""
    slaves = {name: Slave(built[block]) for name, block in BLOCKS.items()}
    for name, value in settings.items():
        component, _, variable = name.partition(".")
        slaves[component].set(variable, value)
    digest, squares = OFFSET, 0.0

    def exchange(now: float) -> None:
        values = [slaves[one].get(output) for one, output, *_ in WIRES]
        for (*_, other, name), value in zip(WIRES, values, strict=True):
            slaves[other].set(name, value)
        slaves["controller"].set("depth_reference", now)

    for _ in range(3):
        exchange(reference[0])
    for slave in slaves.values():
        slave.fmu.exitInitializationMode()
    for i in range(STEPS):
        exchange(reference[i])
        squares += (slaves["plant"].get("depth") - reference[i]) ** 2
        for slave in slaves.values():
            slave.fmu.doStep(i * H, H)
        for slave in slaves.values():
            for word in np.array(slave.outputs()).view(np.uint64).tolist():
                digest = (digest ^ word) * PRIME % 2**64
    depth, rate = slaves["plant"].get("depth"), slaves["controller"].get("predicted_depth_rate")
    return depth, rate, digest, float(np.sqrt(squares / STEPS))


def run(command: list[str], folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def nominal() -> tuple[dict[str, Any], np.ndarray]:
    """Settings of the nominal scenario with the extension, and the reference [m] at each step."""
    experiment = scenario.load(scenario.find("nominal-extended")).experiment
    # "pi" is item 2
    settings = {**experiment.parameters, "controller.augmentation": 2}
    return settings, values_at(experiment.signals["controller.depth_reference"], np.arange(STEPS) * H)


@pytest.fixture(scope="module")
def of_fmus(
    built: Mapping[str, Path], scenario_fmus: None, nominal: tuple[dict[str, Any], np.ndarray]
) -> tuple[float, float, int, float]:
    """What the loop of the FMUs gives."""
    return loop_of_fmus(built, *nominal)


def looped(
    nominal: tuple[dict[str, Any], np.ndarray], folder: Path, microcontroller: str, number: str = "double"
) -> tuple[float, float, int, float]:
    """Returns what the loop gives on an emulated processor; number: of the controller."""
    settings, reference = nominal
    lines = [f"{n.replace('.', '.parameters.', 1)} = {v};" for n, v in settings.items()]
    wires = [
        f"{other}.inputs.{member(name)} = {one}.outputs.{member(output)};"
        for one, output, other, name in WIRES
    ]
    numbers = ", ".join(value.hex() for value in reference.tolist())
    text = f"enum {{ STEPS = {STEPS} }};\nstatic const double H = {H}, REFERENCE[] = {{{numbers}}};\n"
    (folder / "reference.h").write_text(text)
    code = LOOP.replace("SETTINGS", "\n".join(lines)).replace("EXCHANGE", "\n".join(wires))
    code = code.replace("OF_SINES", " ".join(f"controller.outputs.{name} = 0;" for name in OF_SINES))
    (folder / "loop.c").write_text(code)
    for block, its in zip(BLOCKS.values(), (number, "double"), strict=True):
        with builder.loaded(block) as (traced,):
            write_firmware(traced, folder, microcontroller, its)
    linked = ["loop.c", "-L.", *(f"-l{block}" for block in BLOCKS.values()), "-lm", "-o", "loop"]
    options = [f"-mcpu={microcontroller}", "-mfpu=auto", "-mfloat-abi=hard", "-ffp-contract=off"]
    options += ["--specs=rdimon.specs", "-Wall", "-Werror"]
    options += ["-Wl,--section-start=.vectors=0,-z,noexecstack,--fatal-warnings"]
    run(["arm-none-eabi-gcc", *options, *linked], folder)
    _, board = MICROCONTROLLERS[microcontroller]
    emulator = ["qemu-system-arm", "-M", board, "-display", "none", "-serial", "null"]
    emulator += ["-monitor", "none", "-semihosting-config", "enable=on,target=native", "-kernel", "loop"]
    depth, rate, digest, error = run(emulator, folder).split()
    return float(depth), float(rate), int(digest), float(error)


@pytest.mark.cross
def test_the_nominal_loop_on_a_microcontroller_has_the_bits_of_the_fmus(
    nominal: Any, of_fmus: tuple[float, float, int, float], tmp_path: Path
) -> None:
    """15,500 steps of the same size with the sensor's noise, without an operating system."""
    depth, rate, digest, error = looped(nominal, tmp_path, "cortex-m7")
    # the error is summed with a function of the C library
    assert (depth, digest, error) == (*of_fmus[::2], pytest.approx(of_fmus[3], rel=1e-12))
    # rounding errors of 1e-16 of some 1 m/s, which the feedback of the predictor keeps small
    assert rate == pytest.approx(of_fmus[1], abs=1e-12)


@pytest.mark.cross
def test_a_controller_in_floats_tracks_as_the_fmu(
    nominal: Any, of_fmus: tuple[float, float, int, float], tmp_path: Path
) -> None:
    """A float differs by 1e-7. It moves some readings by the sensor's resolution, as noise does."""
    depth, _, digest, error = looped(nominal, tmp_path, "cortex-m4", "float")
    assert 100.0 * error == pytest.approx(4.37, abs=0.005)
    assert error == pytest.approx(of_fmus[3], rel=1e-4)
    assert depth == pytest.approx(of_fmus[0], abs=1e-3)
    assert digest != of_fmus[2]


@pytest.mark.parametrize("name", ["ThrustAllocation", "DepthReference", "L1DepthController"])
def test_the_header_has_the_variables_of_the_model_description(name: str) -> None:
    with builder.loaded(name) as (traced,):
        header = firmware_sources(traced)[f"{name}.h"]
    for v in traced.block.variables:
        assert (
            f"    double {member(v.name).replace(',', '_')}; /* {v.description}: {v.expected} */\n" in header
        )


@pytest.mark.cross
def test_the_how_to_leads_to_a_light_that_blinks_and_the_table_has_the_instructions(tmp_path: Path) -> None:
    (shown,) = re.findall(r"^```sh\n(.*?)^```", HOW_TO.read_text(), re.MULTILINE | re.DOTALL)
    *lights, last = run(["bash", "-ec", shown], tmp_path).partition("\non\n")[2].splitlines()
    # the square wave of the reference has four periods, in which the voltage changes its sign
    assert lights == ["off", "on"] * 3 + ["off"]
    counted = re.findall(r"\d+", last)
    table = (tmp_path / "fmus-built/cortex-m7/L1DepthController/README.md").read_text()
    assert re.findall(r"([\d,]+) \|$", table.replace(",", ""), re.MULTILINE)[2:] == counted
    # numbers are computed in hardware: some thousand operations, not ten thousands
    assert 500 < int(counted[1]) < int(counted[0]) < 10_000


@pytest.mark.cross
def test_a_cortex_m4_takes_ten_times_the_instructions_for_doubles_and_a_seventh_of_them_for_floats(
    tmp_path: Path,
) -> None:
    """Each of some 1,000 operations of doubles is a call of 10 to 40 instructions."""
    instructions: list[int] = []
    with builder.loaded("L1DepthController") as (traced,):
        for processor, number in (("cortex-m7", "double"), ("cortex-m4", "double"), ("cortex-m4", "float")):
            folder = tmp_path / number / processor
            write_firmware(traced, folder, processor, number)
            table = (folder / "README.md").read_text().replace(",", "")
            instructions.append(int(re.findall(r"(\d+) \|$", table, re.MULTILINE)[3]))
    assert 10 < instructions[1] / instructions[0] < 40
    assert 6 < instructions[1] / instructions[2] < 8


@pytest.mark.slow
def test_floats_have_their_differences_from_doubles_in_the_table_after_a_day_too(tmp_path: Path) -> None:
    """A float has 24 bits: sums of some ten terms differ by 1e-7 to 1e-5, a missed sample by 0.1."""
    with builder.loaded("PidDepthController") as (traced,):
        write_firmware(traced, tmp_path, "cortex-m4", "float")
        outputs = [f"{v.name} [{v.unit}]" for v in traced.block.of_causality("output")]
    rows = [line.strip("| ").split(" | ") for line in (tmp_path / "README.md").read_text().splitlines()]
    beside = {row[0]: float(row[2]) / float(row[1]) for row in rows if row[0] in outputs}
    assert [*beside] == outputs
    assert all(1e-9 < ratio < 1e-5 for ratio in beside.values())
    assert not [*tmp_path.glob("beside*")]


def test_without_gcc_and_qemu_the_table_has_no_instructions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with builder.loaded("ThrustAllocation") as (traced,):
        write_firmware(traced, tmp_path, "cortex-m7")
    assert "Instructions" not in (tmp_path / "README.md").read_text()


@pytest.mark.cross
def test_an_emulator_that_does_not_end_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for tool, work in (("arm-none-eabi-gcc", "touch loop"), ("qemu-system-arm", "exec sleep 60")):
        (tmp_path / tool).write_text(f"#!/bin/sh\n{work}\n")
        (tmp_path / tool).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr("fmus.firmware.library._PATIENCE_S", 1)
    expected = "ThrustAllocation: qemu-system-arm of example.c: expected an end in 1 s"
    with (
        builder.loaded("ThrustAllocation") as (traced,),
        pytest.raises(ExportError, match=f"^{expected}$"),
    ):
        write_firmware(traced, tmp_path / "firmware", "cortex-m7")
    assert not (tmp_path / "firmware/loop").exists()
