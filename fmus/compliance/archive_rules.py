"""Rules of the file itself: FMI 2.0.5, 2.3 FMU Distribution."""

import re
import stat
import zipfile
from collections.abc import Iterable, Iterator

from fmus.compliance.fmu_file import DESCRIPTION, FmuFile
from fmus.compliance.rule import Level, Stage, repeated, rule

_CLAUSE = "2.3 FMU Distribution"
_FOLDERS = ("binaries", "documentation", "resources", "sources", "extra", "terminalsAndIcons")
_FILES = (DESCRIPTION, "model.png")
_EXTENSIONS = {"win": ".dll", "windows": ".dll", "linux": ".so", "darwin": ".dylib"}
_PLATFORM = re.compile(r"(?:(win|linux|darwin)(?:32|64)|[a-z0-9_]+-(windows|linux|darwin))")
_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}


def unreadable(fmu: FmuFile) -> str:
    """Why rules of the archive's members do not apply."""
    return "the archive cannot be read" if fmu.archive_problem else ""


@rule(_CLAUSE, Stage.FILE)
def archive_is_zip(fmu: FmuFile) -> Iterator[str]:
    """The file is a zip archive, and every member unpacks to what its checksum says."""
    if fmu.archive_problem:
        yield fmu.archive_problem
    elif fmu.too_large:
        yield fmu.too_large
    else:
        yield from _damaged(fmu)


def _damaged(fmu: FmuFile) -> Iterator[str]:
    with zipfile.ZipFile(fmu.path) as archive:
        for member in fmu.members:
            try:
                with archive.open(member) as stream:
                    while stream.read(1 << 20):
                        pass
            except Exception as error:  # each way of compression has its own errors
                yield f"{member.filename} is damaged: {error}"


@rule(_CLAUSE, Stage.FILE, condition=unreadable)
def archive_has_description(fmu: FmuFile) -> Iterator[str]:
    """modelDescription.xml stands at the top of the archive."""
    if DESCRIPTION not in fmu.names:
        elsewhere = [name for name in fmu.names if name.endswith(DESCRIPTION)]
        yield f"no {DESCRIPTION} at the top; it is at {', '.join(elsewhere) or 'no other place either'}"


@rule(_CLAUSE, Stage.FILE, condition=unreadable)
def archive_paths_are_portable(fmu: FmuFile) -> Iterator[str]:
    """Paths in the archive are relative, with forward slashes, and lead nowhere else."""
    for member in fmu.members:
        name = member.orig_filename
        if "\\" in name or name.startswith("/") or re.match(r"[A-Za-z]:", name) or ".." in name.split("/"):
            yield f"path {name!r}: expected a relative one with forward slashes, inside the archive"


@rule(_CLAUSE, Stage.FILE, condition=unreadable)
def archive_paths_are_unique(fmu: FmuFile) -> Iterator[str]:
    """No two members have the same path, also where upper and lower case are the same (Windows, macOS)."""
    for name, count in repeated(name.lower() for name in fmu.names).items():
        yield f"{count} members are called {name!r}, but for their case: expected one"


@rule(_CLAUSE, Stage.FILE, condition=unreadable)
def archive_members_are_plain(fmu: FmuFile) -> Iterator[str]:
    """Members are stored or deflated files, neither encrypted nor links."""
    for member in fmu.members:
        if member.compress_type not in _METHODS:
            yield f"{member.filename}: compression method {member.compress_type}: expected deflate"
        if member.flag_bits & 1:
            yield f"{member.filename} is encrypted: expected a plain file"
        if stat.S_ISLNK(member.external_attr >> 16):
            yield f"{member.filename} is a symbolic link: expected a plain file"


@rule(_CLAUSE, Stage.FILE, Level.WARNING, condition=unreadable)
def archive_layout(fmu: FmuFile) -> Iterator[str]:
    """At the top of the archive there is nothing but what FMI puts there."""
    for name in sorted({path.split("/")[0] + "/" * ("/" in path) for path in fmu.names}):
        known = name.rstrip("/") in _FOLDERS if name.endswith("/") else name in _FILES
        if not known:
            yield f"{name}: expected one of {', '.join(_FILES)}, {'/, '.join(_FOLDERS)}/"


@rule(_CLAUSE, Stage.FILE, Level.WARNING, condition=unreadable)
def platform_names(fmu: FmuFile) -> Iterator[str]:
    """Folders below binaries are named as FMI 2.0 (linux64) or FMI 3.0 (aarch64-linux) does."""
    for folder in fmu.platforms():
        if not _PLATFORM.fullmatch(folder):
            yield f"binaries/{folder}: expected win64, linux64, darwin64 or the like"


@rule(_CLAUSE, Stage.DESCRIPTION)
def library_names(fmu: FmuFile) -> Iterator[str]:
    """Every platform's folder holds the library modelIdentifier with the platform's extension."""
    for folder in fmu.platforms():
        known = _PLATFORM.fullmatch(folder)
        if known is None:
            continue
        extension = _EXTENSIONS[known.group(1) or known.group(2)]
        for identifier in sorted({kind.get("modelIdentifier", "") for kind in fmu.interfaces.values()}):
            library = f"binaries/{folder}/{identifier}{extension}"
            if library not in fmu.paths:
                yield f"no {library}: expected one, as the folder exists"


@rule(_CLAUSE, Stage.DESCRIPTION)
def has_an_implementation(fmu: FmuFile) -> Iterable[str]:
    """There is a library for some platform, or sources that are listed in SourceFiles."""
    if not fmu.libraries() and fmu.root.find("*/SourceFiles/File") is None:
        yield "neither a library below binaries nor SourceFiles: expected one of them"


@rule("4.3.1 Co-Simulation FMU (SourceFiles)", Stage.DESCRIPTION)
def source_files_exist(fmu: FmuFile) -> Iterator[str]:
    """Every file that SourceFiles lists is below sources."""
    for file in fmu.root.iterfind("*/SourceFiles/File"):
        if f"sources/{file.get('name')}" not in fmu.paths:
            yield f"SourceFiles lists {file.get('name')}: expected sources/{file.get('name')} in the archive"
