"""A block for a microcontroller: its C, a static library, and a table of what it takes."""

import re
import shutil
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fmus.errors import ExportError
from fmus.firmware.code import firmware_sources
from fmus.generate.trace import Traced
from fmus.generate.verify import check_sampling, check_trace
from fmus.native import toolchain
from fmus.platforms import MICROCONTROLLERS

# of the program for QEMU, and of QEMU: the board has a timer
_GCC = "-mfpu=auto --specs=rdimon.specs -Wl,--section-start=.vectors=0,-z,noexecstack"
_QEMU = (
    "-icount shift=10 -display none -monitor none -serial none -semihosting-config enable=on,target=native"
)
# both end in seconds; QEMU does not if the program waits
_PATIENCE_S = 60
_SIZE = "-Os", "-fshort-enums", "-fno-pic", "-fstack-size-section"


def write_firmware(traced: Traced, folder: Path, microcontroller: str, number: str = "double") -> list[Path]:
    """Writes the files of a block for a microcontroller into a folder, and returns their paths.

    number: `double` or `float`; of `float` the README has the difference from doubles of each output

    Raises ExportError for a block whose traced functions differ from its functions in Python.
    """
    check_trace(traced)
    check_sampling(traced.block)
    target, board = MICROCONTROLLERS[microcontroller]
    name, texts = traced.block.name, firmware_sources(traced, number)
    # what compares, and the program for a board, stay where they are of use
    texts = {f: text for f, text in texts.items() if f != "beside.c" and (board or f != "emulator.c")}
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="utf-8", newline="\n")
    options = ["-target", *target.split(), *toolchain.FLAGS, *_SIZE]
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
    lines += [f"| {text} | {count:,} |" for text, count in rows]
    if number != "double":
        lines += _beside_doubles(traced, number)
    table.write_text("\n".join([*lines, ""]), encoding="utf-8", newline="\n")
    return [*(folder / file for file in texts), library, table]


def _instructions(folder: Path, name: str, microcontroller: str, board: str) -> list[int]:
    """Returns the instructions of the first step of example.c and of later ones; [] without GCC and QEMU.

    Raises ExportError if one of them does not end.
    """
    if not board or not all(map(shutil.which, ("arm-none-eabi-gcc", "qemu-system-arm"))):
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


def _beside_doubles(traced: Traced, number: str) -> list[str]:
    """Returns the lines of a table: how far each output is from a run in doubles, both on this machine."""
    name, outputs = traced.block.name, traced.block.of_causality("output")
    runs = list[np.ndarray]()
    for kind in ("double", number):
        with TemporaryDirectory(prefix="l1-depth-beside-") as place:
            for file, text in firmware_sources(traced, kind).items():
                (Path(place) / file).write_text(text, encoding="utf-8", newline="\n")
            program = ["beside.c", f"{name}.c", "-lm", "-o", "beside.exe"]
            toolchain.zig(["cc", *toolchain.FLAGS, *program], Path(place))
            command = [Path(place) / "beside.exe"]
            done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_PATIENCE_S)
        runs.append(np.array([line.split() for line in done.stdout.splitlines()], float))
        if done.returncode or not np.all(np.isfinite(runs[-1])):
            raise ExportError(f"{name} in {kind}s: expected finite numbers from its start values")
    largest, differences = np.max(np.abs(runs[0]), axis=0), np.max(np.abs(runs[1] - runs[0]), axis=0)
    about = f"Beside doubles, in {len(runs[0])} steps from 0 and from 86,400 s with moving inputs"
    return [
        *("", f"| {about} | Largest value | Largest difference |", "|---|---:|---:|"),
        *(
            f"| {v.name} [{v.unit or 1}] | {value:.4g} | {difference:.2g} |"
            for v, value, difference in zip(outputs, largest, differences, strict=True)
        ),
    ]


def _sizes(compiled: bytes) -> tuple[int, int]:
    """Returns the bytes of code and constants in an ELF object, and of its two largest stack frames."""
    # EI_CLASS is ELFCLASS64
    is_64 = compiled[4] == 2
    table, size, count, names = struct.unpack_from(
        f"<{'Q' if is_64 else 'I'}10x3H", compiled, 40 if is_64 else 32
    )
    sections = [
        struct.unpack_from("<2I4Q" if is_64 else "<6I", compiled, table + i * size) for i in range(count)
    ]
    code, frames = 0, [0, 0]
    for name, kind, flags, _, offset, length in sections:
        # SHT_PROGBITS; SHF_ALLOC without SHF_WRITE
        code += length if kind == 1 and flags & 3 == 2 else 0
        if compiled[sections[names][4] + name :].startswith(b".stack_sizes\0"):
            frames += _frames(compiled[offset : offset + length], 8 if is_64 else 4)
    return code, sum(sorted(frames)[-2:])


def _frames(entries: bytes, address: int) -> Iterator[int]:
    """Yields the size of each frame: after the address of its function, 7 bits a byte, the low ones first."""
    while entries:
        last = next(i for i in range(address, len(entries)) if entries[i] < 128)
        yield sum((byte & 127) << 7 * i for i, byte in enumerate(entries[address : last + 1]))
        entries = entries[last + 1 :]
