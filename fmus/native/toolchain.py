"""C sources -> shared libraries for every platform, with the `ziglang` wheel: no system compiler, no network.

A trajectory is the same on every platform, except for differences of the C libraries' elementary functions.
"""

import hashlib
import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from subprocess import PIPE, STDOUT
from typing import IO

from fmus.errors import ExportError
from fmus.extras import imports_of
from fmus.operating_system import kill_group
from fmus.platforms import FMPY, TARGETS

with imports_of("build", "compiling"):
    import ziglang

# No fast-math, and no contraction of a product and a sum into one rounding: both differ between platforms.
FLAGS = (
    "-DFMI2_OVERRIDE_FUNCTION_PREFIX",
    "-DFMI3_OVERRIDE_FUNCTION_PREFIX",
    "-std=c99",
    "-O2",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fvisibility=hidden",
    "-g0",
    "-s",
)
# of FMI 2.0 and 3.0, which no FMU carries
FMI_HEADERS = FMPY / "c-code"
# The first build for Windows takes a minute: its C library is compiled, too.
_PATIENCE_S = 600
COMPILER = ("ziglang", version("ziglang"))
# A longer wait for the compiler is announced.
_SILENT_S = 10
# The shell kills the compiler, and all that it started, when the pipe to this process closes: also where this
# process is killed. Where there is no such shell, as on Windows, the compiler then works on to its end.
_SCRIPT = 'exec 3<&0 </dev/null; (read -r x <&3; kill -KILL 0) & "$@" 3<&-; status=$?; kill $!; exit $status'
_SHELL = ["/bin/sh", "-c", _SCRIPT, "zig"] if Path("/bin/sh").exists() else []
# Variables by which the compiler finds its cache, temporary files and the system. It gets no others: CPATH,
# for one, would put another math.h before its own.
_CACHES = {"XDG_CACHE_HOME", "ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR"}
_TEMPORARY = {"TEMP", "TMP", "TMPDIR"}
_KEPT = {*_CACHES, *_TEMPORARY, "HOME", "LOCALAPPDATA", "PATH", "SYSTEMROOT", "USERPROFILE"}
_ZIG = Path(ziglang.__file__).parent / ("zig.exe" if os.name == "nt" else "zig")


def compile_library(
    model: str,
    sources: dict[str, str],
    compiled: Sequence[str],
    fmi_platform: str,
    more_options: Sequence[str] = (),
) -> bytes:
    """Returns the shared library MODEL of some sources, of which `compiled` are given to the compiler."""
    with compiling(model, sources, compiled, fmi_platform, more_options) as library:
        return library()


@contextmanager
def compiling(
    model: str,
    sources: dict[str, str],
    compiled: Sequence[str],
    fmi_platform: str,
    more_options: Sequence[str] = (),
) -> Iterator[Callable[[], bytes]]:
    """Starts `compile_library` beside this process; the returned function waits for it.

    more_options: of the compiler; %TARGET% stands for its name of the platform
    """
    targets, suffix = TARGETS[fmi_platform]
    file = f"{model}.{suffix}"
    # The compiler finds an object in its cache, and locks it, by the options and the names of the sources.
    # The names are the same for every block: without this option builds of different blocks wait for each
    # other, and each may hold what the other waits for. It undefines a macro that there is not.
    key = f"-UL1_DEPTH_{hashlib.sha256(repr(sorted(sources.items())).encode()).hexdigest()}"
    with tempfile.TemporaryDirectory(prefix="l1-depth-build-") as name, ExitStack() as stack:
        folder = Path(name)
        for source, text in sources.items():
            (folder / source).write_text(text, encoding="utf-8", newline="\n")
        ends = []
        for target in targets:
            (folder / target).mkdir()
            more = [option.replace("%TARGET%", target) for option in more_options]
            options = ["-target", target, "-shared", *FLAGS, *more, key, "-I", str(FMI_HEADERS)]
            if "macos" in target:
                options.append(f"-Wl,-install_name,@rpath/{file}")
            arguments = ["cc", *options, "-o", f"{target}/{file}", *compiled]
            ends.append(stack.enter_context(_running(arguments, folder)))

        def library() -> bytes:
            for end in ends:
                end()
            slices = [(folder / target / file).read_bytes() for target in targets]
            return slices[0] if len(slices) == 1 else _universal(slices)

        yield library


def zig(arguments: Sequence[str], folder: Path) -> None:
    """Runs zig in a folder; ExportError with its output if it fails."""
    with _running(arguments, folder) as end:
        end()


@contextmanager
def _running(arguments: Sequence[str], folder: Path, cache: str = "") -> Iterator[Callable[[], None]]:
    """Starts zig; the returned function waits for its end.

    cache: the folder of compiled files; by default one for all builds of the user
    Zig ends with the context, and with this process.
    """
    command = [*_SHELL, _ZIG, *arguments]
    kept = {name: value for name, value in os.environ.items() if name.upper() in _KEPT}
    kept |= dict.fromkeys(("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR"), cache) if cache else {}
    with (
        tempfile.TemporaryFile() as output,
        subprocess.Popen(
            command, cwd=folder, env=kept, start_new_session=True, stdin=PIPE, stdout=output, stderr=STDOUT
        ) as process,
    ):
        try:
            yield partial(_end, arguments, folder, cache, process, output)
        finally:
            # After an interrupt, too: zig starts further processes.
            if process.poll() is None:
                kill_group(process.pid)


def _end(
    arguments: Sequence[str], folder: Path, cache: str, process: subprocess.Popen[bytes], output: IO[bytes]
) -> None:
    """Waits for a process of zig; ExportError with its output if it fails.

    A long wait is announced on standard error: zig prints nothing while another has the lock of its cache.
    A process that does not end in time is started once more, with a new cache.
    """
    # the option -o has TARGET/BLOCK.so
    files = [f" of {file}" for option, file in pairwise(arguments) if option == "-o"]
    name = f"zig {arguments[0]}{''.join(files)}"
    try:
        with suppress(subprocess.TimeoutExpired):
            process.wait(min(_SILENT_S, _PATIENCE_S))
        if process.poll() is None:
            reason = "it compiles a C library, once, or another build has the lock of its cache"
            print(f"l1-depth: {name} is not done after {_SILENT_S} s: {reason}", file=sys.stderr)
        status = process.wait(_PATIENCE_S)
    except subprocess.TimeoutExpired:
        lock = _awaited_lock(process.pid)
        text = f"{name} did not end within {_PATIENCE_S} s" + (f"; it waits for {lock}" if lock else "")
        # this frees its locks
        kill_group(process.pid)
        if cache:
            raise ExportError(f"{text}, with a new cache") from None
        print(f"l1-depth: {text}; it is tried once more, with a new cache", file=sys.stderr)
        with tempfile.TemporaryDirectory() as new, _running(arguments, folder, new) as again:
            again()
        return
    if status:
        output.seek(0)
        text = output.read().decode("utf-8", "replace").strip()[-2000:]
        hint = "if its cache cannot be written, set ZIG_GLOBAL_CACHE_DIR to a folder that can"
        hint = "expected that file among the sources" if "file not found" in text else hint
        raise ExportError(f"{name} failed: {text}; {hint}")


def _awaited_lock(group: int) -> str:
    """Returns the file whose lock a process of a group waits for; "" without one, and outside of Linux."""
    # a sandbox may not have this file
    locks = Path("/proc/locks")
    if sys.platform != "linux" or not locks.exists():
        return ""
    for line in locks.read_text().splitlines():
        pid, place = line.split()[-4:-2]
        # a process may have ended meanwhile
        with suppress(OSError, ValueError, StopIteration):
            if " -> " in line and os.getpgid(int(pid)) == group:
                inode = int(place.rpartition(":")[2])
                files = (file for file in Path(f"/proc/{pid}/fd").iterdir() if file.stat().st_ino == inode)
                return str(next(files).readlink())
    return ""


def _universal(slices: Sequence[bytes]) -> bytes:
    """Returns a universal Mach-O of thin ones: big-endian header, slices at pages (mach-o/fat.h)."""
    # 2^14 bytes, the page size of Apple silicon
    page = 14
    table, body = b"", b""
    start = 1 << page
    for thin in slices:
        _, cpu, subtype = struct.unpack_from("<III", thin)
        table += struct.pack(">IIIII", cpu, subtype, start + len(body), len(thin), page)
        body += thin + b"\0" * (-len(thin) % (1 << page))
    header = struct.pack(">II", 0xCAFEBABE, len(slices)) + table
    return header.ljust(start, b"\0") + body
