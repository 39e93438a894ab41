"""An FMU unpacked, with its library loaded, for as long as an instance needs it."""

import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from fmus.errors import FmuLoadError
from fmus.files import extract_archive
from fmus.fmi.binding import Library, library_member, platform_name
from fmus.fmi.description import FileVersion, is_independent
from fmus.fmi.model_description import ModelDescription


class UnpackedFmu:
    """The folder of an FMU and its library; users: how many instances share them."""

    def __init__(self, path: Path, description: ModelDescription) -> None:
        self._temporary = TemporaryDirectory(prefix="l1-depth-", ignore_cleanup_errors=True)
        self.folder, self.users = Path(self._temporary.name), 0
        try:
            self.library = _library(path, description, self.folder)
        except BaseException:
            self._temporary.cleanup()
            raise

    def close(self) -> None:
        self.library.unload()
        self._temporary.cleanup()


_shared: dict[FileVersion, UnpackedFmu] = {}
_lock = threading.Lock()


@contextmanager
def unpacked(path: Path, description: ModelDescription) -> Iterator[UnpackedFmu]:
    """An FMU for one instance: that of the others of its file if it is independent, else one of its own."""
    fmu, version = _entered(path, description)
    try:
        yield fmu
    finally:
        with _lock:
            fmu.users -= 1
            is_last = not fmu.users
            if is_last and version:
                del _shared[version]
        if is_last:
            fmu.close()


def _entered(path: Path, description: ModelDescription) -> tuple[UnpackedFmu, FileVersion | None]:
    """The FMU with one more user, and what it is shared by, if it is."""
    if not is_independent(description):
        fmu, version = UnpackedFmu(path, description), None
        fmu.users = 1
        return fmu, version
    with _lock:
        version = FileVersion.of(path)
        if version not in _shared:
            _shared[version] = UnpackedFmu(path, description)
        _shared[version].users += 1
        return _shared[version], version


def _library(path: Path, description: ModelDescription, folder: Path) -> Library:
    """Unpack an FMU, of an independent one its library and resources, and load it for this platform."""
    interface = description.coSimulation
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    identifier = interface.modelIdentifier if interface else ""
    member = library_member(names, identifier)
    if member is None:
        prefix = f"binaries/{platform_name()}/"
        here = [name for name in names if name.startswith(prefix) and name != prefix]
        others = {name.split("/")[1] for name in names if name.startswith("binaries/") and name[-1] != "/"}
        sources = ["C sources"] if any(name.startswith("sources/") for name in names) else []
        available = ", ".join(here or [*sources, *sorted(others)]) or "none"
        named = f" called {identifier}, its modelIdentifier" if here else ""
        raise FmuLoadError(f"{path} has no binary for {platform_name()}{named}: it has {available}")
    needed = [name for name in names if name == member or name.startswith("resources/")]
    extract_archive(path, folder, needed if is_independent(description) else None)
    return Library(folder / member)
