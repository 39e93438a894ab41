"""setuptools, and in wheels what running FMUs takes of C, compiled for every platform.

An editable install has no compiled library and needs no compiler: the first run compiles them.
"""

import base64
import hashlib
import os
import stat
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403  the hooks that are not replaced
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

_ROOT = Path(__file__).parent.parent
_COMPILED = (Path("orchestration/run/loop.c"), Path("fmus/fmi/fmi3_calls.c"))


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """The compiler and the headers of FMI too, in the versions that the project requires."""
    with (_ROOT / "pyproject.toml").open("rb") as stream:
        project = tomllib.load(stream)["project"]
    required = [*project["dependencies"], *project["optional-dependencies"]["build"]]
    of_compiling = [name for name in required if name.startswith(("ziglang", "fmpy"))]
    return [*build_meta.get_requires_for_build_wheel(config_settings), *of_compiling]


def build_wheel(
    wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None
) -> str:
    """A wheel that follows from the sources alone, byte for byte."""
    os.environ.setdefault("SOURCE_DATE_EPOCH", "315532800")  # 1980, the earliest date that a zip can hold
    with tempfile.TemporaryDirectory() as folder:  # of an earlier build nothing is taken
        build = {"--global-option": ["build", f"--build-base={folder}"]}
        wheel = build_meta.build_wheel(
            wheel_directory, {**(config_settings or {}), **build}, metadata_directory
        )
    _complete(Path(wheel_directory, wheel))
    return wheel


def _complete(wheel: Path) -> None:
    """Adds the bill of materials (PEP 770), and gives every file in a wheel the same permissions.

    setuptools takes those that the user's umask gave.
    """
    with zipfile.ZipFile(wheel) as archive:
        members = [(info, archive.read(info)) for info in archive.infolist()]
    record = next(info for info, _ in members if info.filename.endswith(".dist-info/RECORD"))
    bill = zipfile.ZipInfo(f"{Path(record.filename).parent}/sboms/l1-depth.cdx.json", record.date_time)
    bill.compress_type = record.compress_type
    content = _bill_of_materials({info.filename: content for info, content in members})
    digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode().rstrip("=")
    line = f"{bill.filename},sha256={digest},{len(content)}\n".encode()
    members = [(info, data + line if info is record else data) for info, data in members]
    with zipfile.ZipFile(wheel, "w") as archive:
        for info, data in (*members, (bill, content)):
            info.external_attr = (stat.S_IFREG | 0o644) << 16
            archive.writestr(info, data)


def _bill_of_materials(members: Mapping[str, bytes]) -> bytes:
    """Returns the bill of the compiled libraries in a wheel."""
    sys.path.insert(0, str(_ROOT))
    from fmus.native import sbom
    from fmus.platforms import PLATFORMS

    with (_ROOT / "pyproject.toml").open("rb") as stream:
        project = tomllib.load(stream)["project"]
    subject = sbom.component(project["name"], project["version"], project["license"])
    libraries = {
        path: (platform, content)
        for path, content in members.items()
        for platform in PLATFORMS
        if f"-{platform}-" in path
    }
    return sbom.bill_of_materials(subject, [], [], libraries)


class BuildWithLibraries(build_py):
    """Adds the compiled libraries to what a wheel is made of."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            for source in _COMPILED:
                self._compile(_ROOT / source, Path(self.build_lib) / source.parent)

    def _compile(self, source: Path, folder: Path) -> None:
        sys.path.insert(0, str(_ROOT))
        from fmus.native.compiled_library import compile_source, file_name
        from fmus.platforms import PLATFORMS
        from fmus.store import sealed

        for platform in PLATFORMS:
            content = sealed(compile_source(source, platform))
            (folder / file_name(source, platform)).write_bytes(content)


class SourcesWithBackend(sdist):
    """Adds this file, and leaves out the few tests that setuptools takes."""

    def make_distribution(self) -> None:
        self.filelist.append(".ci/build_backend.py")
        self.filelist.prune("tests")
        super().make_distribution()
