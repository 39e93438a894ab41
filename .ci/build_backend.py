"""setuptools, and in wheels what running FMUs takes of C, compiled for every platform.

An editable install has no compiled library and needs no compiler: the first run compiles them.
"""

import os
import stat
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403  the hooks that are not replaced
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

_ROOT = Path(__file__).parent.parent
_COMPILED = (Path("orchestration/run/loop.c"), Path("fmus/fmi/fmi3_calls.c"))


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """The compiler too, in the version that the project requires."""
    with (_ROOT / "pyproject.toml").open("rb") as stream:
        required = tomllib.load(stream)["project"]["dependencies"]
    compiler = [name for name in required if name.startswith("ziglang")]
    return [*build_meta.get_requires_for_build_wheel(config_settings), *compiler]


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
    _set_file_modes(Path(wheel_directory, wheel))
    return wheel


def _set_file_modes(wheel: Path) -> None:
    """Gives every file in a wheel the same permissions: setuptools takes those that the user's umask gave."""
    with zipfile.ZipFile(wheel) as archive:
        members = [(info, archive.read(info)) for info in archive.infolist()]
    with zipfile.ZipFile(wheel, "w") as archive:
        for info, content in members:
            info.external_attr = (stat.S_IFREG | 0o644) << 16
            archive.writestr(info, content)


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
