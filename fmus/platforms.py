"""The platforms of FMI 2.0 that native FMUs are built for, and where a library stands inside an FMU."""

import platform
import sys
from collections.abc import Sequence

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


def host_platform() -> str:
    """The FMI name of the platform that this runs on."""
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


def check_platforms(names: Sequence[str]) -> tuple[str, ...]:
    """The names, each once; ExportError offers the nearest for an unknown one."""
    for name in names:
        if name not in TARGETS:
            raise ExportError(f"no platform {name!r}; {nearest(name, PLATFORMS)}")
    return tuple(dict.fromkeys(names))


def library_name(model: str, fmi_platform: str) -> str:
    """Path of a library inside the FMU."""
    return f"binaries/{fmi_platform}/{model}.{TARGETS[fmi_platform][1]}"
