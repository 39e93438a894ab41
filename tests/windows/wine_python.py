"""A CPython 3.11 for Windows that runs under Debian's Wine, of PyPI's packages alone.

The wheel `panda3d` has python311.dll and its extension modules as python.org released them. The standard
library is the one of the Python that runs this. Zig compiles a starter, the names of the stable ABI, and what
Wine 8 lacks: complex functions of the C library and its random numbers. Zig for Windows does not start there,
so `zig.exe` passes its arguments to the zig of this machine.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pefile
import ziglang

# The default tests run for a quarter of an hour there.
_PATIENCE_S = 1800
# HOME is where Wine looks for fonts, PATH where it finds its server
_KEPT = ("HOME", "PATH", "ZIG_GLOBAL_CACHE_DIR")
HERE = Path(__file__).parent
PANDA = "panda3d==1.10.16"
TARGET = ["--python-version=3.11", "--abi=cp311", "--platform=win_amd64", "--only-binary=:all:"]
PIP = [sys.executable, "-m", "pip", "--quiet"]
# Wine finds a library of the first name in its own; the second, of equal length, is looked for on the path
C_MATH, OUR_MATH = b"api-ms-win-crt-math-l1-1-0.dll", b"our-ms-win-crt-math-l1-1-0.dll"
OF_ONE = "cacos cacosh casin casinh catan catanh ccos ccosh cexp clog conj cproj csin csinh csqrt ctan ctanh"
TO_REAL = "cabs carg creal cimag"


class WinePython:
    """A Python of some requirements in a folder, which is made unless it is there."""

    def __init__(self, folder: Path, requirements: list[str]) -> None:
        sources = [path.read_text() for path in (Path(__file__), *sorted(HERE.glob("*.c")))]
        made_of = repr((sys.version, requirements, sources)).encode()
        self.prefix = folder / hashlib.sha256(made_of).hexdigest()[:16]
        self.drive = self.prefix / "drive_c"
        self.home = self.drive / "python"
        if not (self.home / "made").exists():
            shutil.rmtree(self.prefix, ignore_errors=True)
            self.home.mkdir(parents=True)
            _make(self.home, requirements)
            self.run("python.exe", "-c", "import numpy", cwd=self.drive)  # this makes Wine's own files, too
            (self.home / "made").touch()
        _install_zig(self.home / "Lib" / "site-packages")

    def run(self, program: str, *arguments: str, cwd: Path) -> "subprocess.CompletedProcess[str]":
        """Runs a program beside Python; both outputs are one pipe, as Wine loses those of files."""
        kept = {name: os.environ[name] for name in _KEPT if name in os.environ}
        # names of files are UTF-8 here; the console of Windows stays one of code page 1252
        wine = {"WINEPREFIX": str(self.prefix), "WINEDEBUG": "-all", "LC_ALL": "C.UTF-8"}
        command = ["/usr/lib/wine/wine64", str(self.home / program), *arguments]
        pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        how = {"errors": "replace", "timeout": _PATIENCE_S}
        return subprocess.run(command, cwd=cwd, env={**kept, **wine}, check=False, **pipes, **how)


def _make(home: Path, requirements: list[str]) -> None:
    unwanted = shutil.ignore_patterns("site-packages", "lib-dynload", "test", "config-*", "__pycache__")
    shutil.copytree(sysconfig.get_path("stdlib"), home / "Lib", ignore=unwanted)
    # a method of the class in python311.dll, which is of 3.11.9; of an instance before
    finder = home / "Lib" / "importlib" / "metadata" / "__init__.py"
    unbound = re.compile(r"(?<!@classmethod\n)    def invalidate_caches\(cls")
    finder.write_text(unbound.sub("    @classmethod\n    def invalidate_caches(cls", finder.read_text()))
    packages = home / "Lib" / "site-packages"
    (home / "DLLs").mkdir()
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([*PIP, "download", "--no-deps", f"--dest={folder}", *TARGET, PANDA], check=True)
        with zipfile.ZipFile(next(Path(folder).glob("*.whl"))) as wheel:
            for name in wheel.namelist():
                if name.startswith("deploy_libs/") and not (base := Path(name).name).startswith("api-ms-"):
                    at_start = base.lower().startswith(("python3", "vcruntime"))
                    (home / ("" if at_start else "DLLs") / base).write_bytes(wheel.read(name))
    _compile(home / "python.exe", HERE / "python.c", [], "-municode")
    library: Any = pefile.PE(str(home / "python311.dll"))
    exported = (s.name.decode() for s in library.DIRECTORY_ENTRY_EXPORT.symbols if s.name)
    stable = [f"{name} = python311.{name}" for name in exported]
    empty = home / "empty.c"
    empty.write_text("")
    _compile(home / "python3.dll", empty, stable)
    _compile(home / "bcryptprimitives.dll", HERE / "random.c", [], "-ladvapi32")
    subprocess.run([*PIP, "install", f"--target={packages}", *TARGET, *requirements], check=True)
    _complete_mathematics(home, packages)


def _install_zig(packages: Path) -> None:
    """Installs the distribution `ziglang` of the Python that runs this, with another program."""
    installed, folder = Path(ziglang.__file__).parent, packages / "ziglang"
    for path in packages.glob("ziglang*"):
        shutil.rmtree(path)
    folder.mkdir()
    for path in installed.iterdir():
        if path.name != "zig":
            (folder / path.name).symlink_to(path)
    (metadata,) = installed.parent.glob("ziglang-*.dist-info")
    shutil.copytree(metadata, packages / metadata.name)
    script = shutil.copy(HERE / "zig_of_linux.py", folder)
    places = [f'-D{name}="{path}"' for name, path in (("PYTHON", sys.executable), ("SCRIPT", script))]
    _compile(folder / "zig.exe", HERE / "zig.c", [], "-municode", *places)


def _compile(out: Path, source: Path, exports: list[str], *options: str) -> None:
    names = out.with_suffix(".def")
    names.write_text("\n  ".join([f"LIBRARY {out.name}\nEXPORTS", *exports]) + "\n")
    kind = [] if out.suffix == ".exe" else ["-shared", *([names] if exports else [])]
    zig = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-windows-gnu", "-O1", "-s"]
    subprocess.run([*zig, *kind, *options, "-o", out, source], check=True)


def _complete_mathematics(home: Path, packages: Path) -> None:
    """Lets the wheels find complex functions in a library of ours: Wine 8 has only stubs of them."""
    imported: set[str] = set()
    for path in packages.rglob("*"):
        if path.suffix.lower() in (".pyd", ".dll") and C_MATH in (content := path.read_bytes()):
            binary: Any = pefile.PE(data=content, fast_load=True)
            binary.parse_data_directories([pefile.DIRECTORY_ENTRY["IMAGE_DIRECTORY_ENTRY_IMPORT"]])
            of_math = (x for x in binary.DIRECTORY_ENTRY_IMPORT if x.dll.lower() == C_MATH)
            imported |= {entry.name.decode() for x in of_math for entry in x.imports}
            path.write_bytes(content.replace(C_MATH, OUR_MATH))
    ours = dict(_complex_functions())
    source = home / "complex.c"
    source.write_text("#include <complex.h>\n" + "".join(ours.values()))
    exports = [f"{name} = {'our_' if name in ours else 'ucrtbase.'}{name}" for name in sorted(imported)]
    _compile(home / OUR_MATH.decode(), source, exports)


def _complex_functions() -> Iterator[tuple[str, str]]:
    """Name -> C by Microsoft's conventions of calls, in which long double is double."""
    for suffix, real in (("", "double"), ("f", "float"), ("l", "double")):
        c, z = suffix.replace("l", ""), f"struct z{suffix}"
        a, b = (f"__builtin_complex({x}.r, {x}.i)" for x in "ab")
        yield f"z{suffix}", f"{z} {{ {real} r, i; }};\n"
        for name in TO_REAL.split():
            yield name + suffix, f"{real} our_{name}{suffix}({z} a) {{ return {name}{c}({a}); }}\n"
        for name, more, arguments in [
            *((n, "", a) for n in OF_ONE.split()),
            ("cpow", f", {z} b", f"{a}, {b}"),
        ]:
            body = f"{real} _Complex x = {name}{c}({arguments}); return ({z}){{creal{c}(x), cimag{c}(x)}};"
            yield name + suffix, f"{z} our_{name}{suffix}({z} a{more}) {{ {body} }}\n"
