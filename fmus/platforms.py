"""The platforms of FMI 2.0 that native FMUs are built for, and where a library stands inside an FMU.

Also what this machine is: its platform and its instruction sets.
"""

import platform
import sys
from collections.abc import Collection, Sequence
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from fmus.errors import ExportError, nearest

# FMI platform -> (zig targets, suffix); two targets become one universal library
TARGETS = {
    "linux64": (("x86_64-linux-gnu.2.17",), "so"),
    "win64": (("x86_64-windows-gnu",), "dll"),
    "darwin64": (("x86_64-macos.11.0", "aarch64-macos.11.0"), "dylib"),
    "aarch64-linux": (("aarch64-linux-gnu.2.17",), "so"),
    "aarch64-darwin": (("aarch64-macos.11.0",), "dylib"),
}
PLATFORMS = tuple(TARGETS)
# name -> zig's target, its processor with floating-point unit, and QEMU's board if there is one. No C library
# is linked: the target has headers. RISC-V's code may lie anywhere in memory.
MICROCONTROLLERS = {
    "cortex-m4": ("thumb-linux-musleabihf -mcpu=cortex_m4+vfp4d16sp", "mps2-an386"),
    "cortex-m7": ("thumb-linux-musleabihf -mcpu=cortex_m7+fp_armv8d16", "mps2-an500"),
    "riscv64": ("riscv64-linux-musl -mcpu=baseline_rv64 -mcmodel=medany", ""),
}
# FMI 3.0.2, 2.5.1.4: names of the same platforms
_PLATFORM_TUPLES = {"linux64": "x86_64-linux", "win64": "x86_64-windows", "darwin64": "x86_64-darwin"}

_SYSTEM = {"win32": "win", "darwin": "darwin"}.get(sys.platform, "linux")
SYSTEM_PLATFORM = f"{_SYSTEM}{64 if sys.maxsize > 2**32 else 32}"
"""Platform of this machine by FMPy's name; the standard's name has the processor, too."""
SHARED_LIBRARY_SUFFIX = {"win": ".dll", "darwin": ".dylib", "linux": ".so"}[_SYSTEM]
# found without an import: to import FMPy takes long
FMPY = Path(getattr(find_spec("fmpy"), "origin", None) or "").parent
"""Folder of FMPy, which contains FMI's headers and schemas."""

# level of the x86-64 ABI, the best first -> the features that it adds to x86-64-v2, by Linux's names
_V3 = "avx avx2 bmi1 bmi2 f16c fma abm movbe"
INSTRUCTION_SETS = {
    "x86-64-v4": f"{_V3} avx512f avx512bw avx512cd avx512dq avx512vl",
    "x86-64-v3": _V3,
    "portable": "",
}


def host_platform() -> str:
    """Returns the FMI name of the platform of this machine."""
    machine = platform.machine().lower()
    architecture = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    known = {
        ("linux", "x86_64"): "linux64",
        ("linux", "aarch64"): "aarch64-linux",
        ("darwin", "x86_64"): "darwin64",
        ("darwin", "aarch64"): "aarch64-darwin",
        ("win32", "x86_64"): "win64",
    }
    if (sys.platform, architecture) not in known:
        raise ExportError(
            f"no native FMU for {sys.platform} on {machine}: expected one of {', '.join(PLATFORMS)}; "
            "use the python flavour"
        )
    return known[sys.platform, architecture]


@cache
def instruction_sets() -> tuple[str, ...]:
    """Returns the instruction sets of this processor, the best first; outside Linux "portable" alone."""
    features: set[str] = set()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        features = next(({*line.split()} for line in lines if line.startswith("flags")), features)
    return tuple(name for name, needed in INSTRUCTION_SETS.items() if features >= {*needed.split()})


def check_platforms(names: Sequence[str], known: Collection[str] = PLATFORMS) -> tuple[str, ...]:
    """Returns the names, each once; ExportError offers the nearest for an unknown one."""
    for name in names:
        if name not in known:
            raise ExportError(f"no platform {name!r}; {nearest(name, known)}")
    return tuple(dict.fromkeys(names))


def library_name(model: str, fmi_platform: str, fmi: int = 2) -> str:
    """Returns the path of a library inside the FMU; fmi: the version of the standard."""
    return f"binaries/{platform_folder(fmi_platform, fmi)}/{model}.{TARGETS[fmi_platform][1]}"


def platform_folder(fmi_platform: str, fmi: int) -> str:
    """Returns the name of a platform in a version of the standard."""
    return fmi_platform if fmi == 2 else _PLATFORM_TUPLES.get(fmi_platform, fmi_platform)
