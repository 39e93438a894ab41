"""Traced block -> C for a microcontroller, a header, a file and a static library, with the FMU's numbers.

The C file is a third dialect of `c_code.py`: columns are structs with the names of the model description. It
has no heap, no global state, no header of FMI, and one loop, over the internal steps of a step.
"""

import re
import shutil
import struct
import subprocess
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from string import Template

from fmus.block.scalars import flatten
from fmus.block.variables import BlockVariable
from fmus.errors import ExportError
from fmus.generate.c_code import CFunction, ScalarC, c_function, c_functions
from fmus.generate.operations import Operation
from fmus.generate.trace import Traced
from fmus.generate.verify import check_sampling, check_trace
from fmus.native import toolchain
from fmus.platforms import MICROCONTROLLERS

# column of the traced functions -> its struct; a step writes the next state
_STRUCTS = {
    "p": "parameters",
    "c": "calculated",
    "u": "inputs",
    "x": "state",
    "next": "state",
    "y": "outputs",
}
_CAUSALITIES = {"p": "parameter", "c": "calculatedParameter", "u": "input", "y": "output"}
# words of C and C++, which Python takes as names
_RESERVED = (
    "auto bool case catch char const default delete do double enum explicit extern float friend goto inline "
    "int long mutable namespace new operator private protected public register restrict short signed sizeof "
    "static struct switch template this throw typedef typename union unsigned using virtual void volatile"
)
# of the program for QEMU, and of QEMU: the board has a timer
_GCC = "-mfpu=auto --specs=rdimon.specs -Wl,--section-start=.vectors=0,-z,noexecstack"
_QEMU = (
    "-icount shift=10 -display none -monitor none -serial none -semihosting-config enable=on,target=native"
)
# both end in seconds; QEMU does not if the program waits
_PATIENCE_S = 60
_SIZE = "-Os", "-fshort-enums", "-fno-pic", "-fstack-size-section"


class FirmwareC(ScalarC):
    """C99 whose columns are structs; their members have the names of the model description.

    members: column of the traced functions -> name in C of each element -> its comment
    """

    def __init__(self, traced: Traced) -> None:
        block = traced.block
        self.name = block.name
        variables = {column: block.of_causality(causality) for column, causality in _CAUSALITIES.items()}
        variables["x"] = block.state_variables
        self.members = {column: dict(_members(those)) for column, those in variables.items()}
        self.members["next"] = self.members["x"]
        self._names = {column: [*members] for column, members in self.members.items()}

    def _column(self, name: str) -> str:
        kind = _STRUCTS.get(name)
        return f"{self.name}_{kind} *{name}" if kind else super()._column(name)

    def _text(self, operation: Operation) -> str:
        column, _, index = operation.text.partition("[")
        return f"{column}->{self._names[column][int(index[:-1])]}" if column in _STRUCTS else operation.text


def _members(variables: Sequence[BlockVariable]) -> Iterator[tuple[str, str]]:
    """Yields the name in C and the comment of each variable: `theta[1,2]` is theta_1_2."""
    taken: set[str] = {*_RESERVED.split()}
    for v in variables:
        member = re.sub(r"\W+", "_", v.name).strip("_")
        while member in taken:
            member += "_"
        taken.add(member)
        yield member, f"{v.description or v.name}: {v.expected}".replace("*/", "* /")


def write_firmware(traced: Traced, folder: Path, microcontroller: str) -> list[Path]:
    """Writes the files of a block for a microcontroller into a folder, and returns their paths.

    Raises ExportError for a block whose traced functions differ from its functions in Python.
    """
    check_trace(traced)
    check_sampling(traced.block)
    name, texts = traced.block.name, firmware_sources(traced)
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="utf-8", newline="\n")
    target, processor, board = MICROCONTROLLERS[microcontroller]
    options = ["-target", target, f"-mcpu={processor}", *toolchain.FLAGS, *_SIZE]
    library = folder / f"lib{name}.a"
    toolchain.zig(["cc", *options, "-c", f"{name}.c", "-o", f"{name}.o"], folder)
    library.unlink(missing_ok=True)
    toolchain.zig(["ar", "rcs", library.name, f"{name}.o"], folder)
    compiled = folder / f"{name}.o"
    code, stack = _sizes(compiled.read_bytes())
    compiled.unlink()
    table = folder / "README.md"
    rows = [
        ("Bytes of code and constants, without math.h's", code),
        ("Bytes of stack, without math.h's", stack),
    ]
    titles = "Instructions of the first step and its outputs", "Instructions of a later one, at most"
    # no rows without GCC and QEMU
    rows += zip(titles, _instructions(folder, name, microcontroller, board), strict=False)
    lines = [f"# {name} on a {microcontroller}", "", "| | |", "|---|---:|"]
    lines += [f"| {text} | {number:,} |" for text, number in rows]
    table.write_text("\n".join([*lines, ""]), encoding="utf-8", newline="\n")
    return [*(folder / file for file in texts), library, table]


def _instructions(folder: Path, name: str, microcontroller: str, board: str) -> list[int]:
    """Returns the instructions of the first step of example.c and of later ones; [] without GCC and QEMU.

    Raises ExportError if one of them does not end.
    """
    if not all(map(shutil.which, ("arm-none-eabi-gcc", "qemu-system-arm"))):
        return []
    linked = f"-mcpu={microcontroller} -mfloat-abi=hard {_GCC} -L. -l{name} -lm -o loop"
    emulated = f"qemu-system-arm -M {board} {_QEMU} -kernel loop"
    shown = ""
    # where the first one fails, as without newlib, the second one shows nothing
    try:
        for command in (f"arm-none-eabi-gcc emulator.c example.c {linked}", emulated):
            shown = subprocess.run(
                command.split(), cwd=folder, capture_output=True, text=True, check=False, timeout=_PATIENCE_S
            ).stdout
    except subprocess.TimeoutExpired as expired:
        tool = expired.cmd[0]
        raise ExportError(f"{name}: {tool} of example.c: expected an end in {_PATIENCE_S} s") from None
    finally:
        (folder / "loop").unlink(missing_ok=True)
    return [int(number) for number in re.findall(r"(\d+) in", shown)]


def firmware_sources(traced: Traced) -> dict[str, str]:
    """Returns file name -> text: the header, the C file and an example."""
    block, dialect = traced.block, FirmwareC(traced)
    native = resources.files("fmus") / "native"
    step, constants = c_functions(traced.step, "block_step", held=("h", "p", "c"), inputs="u")
    others = ("calculate", "requirements", "initial_state", "output")
    functions: list[CFunction] = [*step, *(c_function(getattr(traced, f), f"block_{f}") for f in others)]
    values = {
        "name": block.name,
        "description": " ".join(block.description.split()).replace("*/", "* /"),
        "structs": "\n".join(_struct(dialect, column) for column in ("p", "c", "u", "y", "x")),
        "parameters": _starts(block.parameters()),
        "inputs": _starts(block.inputs()),
        "constants": constants + 1,
        "requirements": len(traced.required),
        "required": "".join(f" *   {i}: expected {text}\n" for i, text in enumerate(traced.required, 1)),
        "elementary": (native / "elementary.h").read_text("utf-8"),
        "equations": "\n".join(map(dialect.function, functions)),
        "step_size": repr(float(block.step_size)),
    }
    template = (native / "firmware.c.in").read_text("utf-8")
    parts = re.split(r"^//// (.+)\n", Template(template).substitute(values), flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def _struct(dialect: FirmwareC, column: str) -> str:
    members = dialect.members[column] or {"none": "C99 has no empty struct"}
    lines = "".join(f"    double {name}; /* {text} */\n" for name, text in members.items())
    return f"typedef struct {{\n{lines}}} {dialect.name}_{_STRUCTS[column]};\n"


def _starts(values: object) -> str:
    return ", ".join(repr(float(value)) for value in flatten(values)) or "0"


def _sizes(compiled: bytes) -> tuple[int, int]:
    """Returns the bytes of code and constants in a 32-bit ELF object, and of its two largest stack frames."""
    table, size, count, names = struct.unpack_from("<I10x3H", compiled, 32)
    sections = [struct.unpack_from("<6I", compiled, table + i * size) for i in range(count)]
    code, frames = 0, [0, 0]
    for name, kind, flags, _, offset, length in sections:
        # SHT_PROGBITS; SHF_ALLOC without SHF_WRITE
        code += length if kind == 1 and flags & 3 == 2 else 0
        if compiled[sections[names][4] + name :].startswith(b".stack_sizes\0"):
            frames += _frames(compiled[offset : offset + length])
    return code, sum(sorted(frames)[-2:])


def _frames(entries: bytes) -> Iterator[int]:
    """Yields the size of each frame: after the address of its function, 7 bits a byte, the low ones first."""
    while entries:
        last = next(i for i in range(4, len(entries)) if entries[i] < 128)
        yield sum((byte & 127) << 7 * i for i, byte in enumerate(entries[4 : last + 1]))
        entries = entries[last + 1 :]
