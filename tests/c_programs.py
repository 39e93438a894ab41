"""C programs that are compiled for a test or a measurement."""

from pathlib import Path

import fmpy

from fmus.native import toolchain

_ROOT = Path(__file__).parents[1]
_HEADERS = (_ROOT / "tests" / "c", Path(fmpy.__file__).parent / "c-code")
_TARGETS = {
    "linux64": ("x86_64-linux-gnu.2.17", ("-ldl", "-lm", "-lpthread")),
    "aarch64-linux": ("aarch64-linux-gnu.2.17", ("-ldl", "-lm", "-lpthread")),
    "win64": ("x86_64-windows-gnu", ()),
}


def compile_c(source: Path, platform: str, folder: Path) -> Path:
    """Compiles a C program of this repository for a platform, without a warning, with the flags of the FMUs.

    The same flags let zig reuse its cache; on Windows this saves most of a minute.
    """
    target, libraries = _TARGETS[platform]
    includes = [f"-I{folder}" for folder in _HEADERS]
    warnings = ["-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    options = ["-target", target, *toolchain.FLAGS, *warnings, *includes]
    name = source.with_suffix(".exe").name  # a name that Windows runs, and the others do not mind
    toolchain.zig(["cc", *options, "-o", name, str(_ROOT / source), *libraries], folder)
    return folder / name
