"""C sources -> shared libraries for every platform, with the `ziglang` wheel: no system compiler, no network.

No fast-math and no contraction of a product and a sum into one rounding: a trajectory is the same on every
platform as far as the elementary functions of its C library are.
"""

import os
import signal
import struct
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

import fmpy

from fmus.errors import ExportError
from fmus.platforms import TARGETS

FLAGS = (
    "-DFMI2_OVERRIDE_FUNCTION_PREFIX",
    "-std=c99",
    "-O2",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fvisibility=hidden",
    "-g0",
    "-s",
)
FMI_HEADERS = Path(fmpy.__file__).parent / "c-code"  # of FMI 2.0, which no FMU carries
_PATIENCE_S = 600  # the first build for Windows takes a minute: its C library is compiled too
COMPILER = ("ziglang", version("ziglang"))


def compile_library(model: str, sources: dict[str, str], compiled: Sequence[str], fmi_platform: str) -> bytes:
    """The shared library MODEL of some sources, of which `compiled` are given to the compiler."""
    targets, suffix = TARGETS[fmi_platform]
    with tempfile.TemporaryDirectory(prefix="l1-depth-build-") as name:
        folder = Path(name)
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8", newline="\n")
        slices = [_compile(folder, compiled, target, f"{model}.{suffix}") for target in targets]
    return slices[0] if len(slices) == 1 else _universal(slices)


def _compile(folder: Path, compiled: Sequence[str], target: str, library: str) -> bytes:
    options = ["-target", target, "-shared", *FLAGS, "-I", str(FMI_HEADERS)]
    if "macos" in target:
        options.append(f"-Wl,-install_name,@rpath/{library}")
    zig(["cc", *options, "-o", library, *compiled], folder)
    return (folder / library).read_bytes()


def zig(arguments: Sequence[str], folder: Path) -> None:
    """Run zig in a folder; ExportError with what it said if it fails."""
    command = [sys.executable, "-m", "ziglang", *arguments]
    hint = "if its cache cannot be written, set ZIG_GLOBAL_CACHE_DIR to a folder that can"
    with subprocess.Popen(
        command, cwd=folder, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    ) as process:
        try:
            output, _ = process.communicate(timeout=_PATIENCE_S)
        except BaseException as error:  # an interrupt too: zig starts processes of its own
            with suppress(ProcessLookupError):  # it has ended meanwhile
                process.kill() if os.name == "nt" else os.killpg(process.pid, signal.SIGKILL)
            if isinstance(error, subprocess.TimeoutExpired):
                message = f"zig {arguments[0]} did not end within {_PATIENCE_S} s; {hint}"
                raise ExportError(message) from None
            raise
    if process.returncode:
        text = output.decode("utf-8", "replace").strip()[-2000:]
        raise ExportError(f"zig {arguments[0]} failed: {text}; {hint}")


def _universal(slices: Sequence[bytes]) -> bytes:
    """A universal Mach-O of thin ones: big-endian header, each slice at a page boundary (mach-o/fat.h)."""
    page = 14  # 2^14 bytes, the page size of Apple silicon
    table, body = b"", b""
    start = 1 << page
    for thin in slices:
        _, cpu, subtype = struct.unpack_from("<III", thin)
        table += struct.pack(">IIIII", cpu, subtype, start + len(body), len(thin), page)
        body += thin + b"\0" * (-len(thin) % (1 << page))
    header = struct.pack(">II", 0xCAFEBABE, len(slices)) + table
    return header.ljust(start, b"\0") + body
