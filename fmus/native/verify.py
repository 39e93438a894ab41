"""Checking that the libraries of an FMU are compiled from its sources, and that its GUID fits its members."""

import hashlib
import json
import os
import re
import stat
import tempfile
import zipfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

from fmus.errors import ExportError
from fmus.extras import imports_of
from fmus.guid import GUID, with_guid
from fmus.native.sbom import MEMBER, RECIPE, recipe_of, with_files
from fmus.native.toolchain import FMI_HEADERS, compile_library
from fmus.platforms import TARGETS, platform_folder

with imports_of("build", "compiling"):
    import ziglang

SAME = "same"
DIFFERENT = "different"
_DESCRIPTION = "sources/buildDescription.xml"
# only ensembles include it, no library of an FMU
_OF_ENSEMBLES = "model_lanes.h"
_PLATFORMS = {platform_folder(name, fmi): name for name in TARGETS for fmi in (2, 3)}
# members that the builder adds: the bill lists them, the GUID leaves them out; a bill may list others
_OUTSIDE_GUID = "model.png", "terminalsAndIcons/", "extra/org.fmi-standard.fmi-ls-ref/"
# the errors of reading a bill of another tool
_NO_BILL = ValueError, LookupError, TypeError, AttributeError


def verified(archive: zipfile.ZipFile) -> Iterator[tuple[str, str]]:
    """Yields the path of each library in an FMU, and `SAME`, `DIFFERENT` or why it cannot be compiled again.

    Then yields verdicts on other members that the bill of materials lists, on the bill, and on the GUID.
    Raises ExportError for members of one name, for links, and for a description of the build that is no XML.
    """
    infos = [info for info in archive.infolist() if info.file_size or not info.is_dir()]
    counts = Counter(info.filename for info in infos)
    if odd := [i for i in infos if counts[i.filename] > 1 or stat.S_ISLNK(i.external_attr >> 16)]:
        raise ExportError(f"{odd[0].filename}: expected one member of this name, and no symbolic link")
    members = {name: archive.read(name) for name in counts}
    try:
        description = ElementTree.fromstring(members.get(_DESCRIPTION, b"<none/>"))
    except ElementTree.ParseError as error:
        raise ExportError(f"{_DESCRIPTION}: {error}: expected XML") from error
    files = [file.get("name", "") for file in description.iter("SourceFile")]
    reason = _reason(members, description) if files else f"no source files in {_DESCRIPTION}"
    for path in (name for name in members if name.startswith("binaries/")):
        folder, model, verdict = PurePosixPath(path).parent.name, PurePosixPath(path).stem, reason
        if not _platform(path):
            verdict = f"no platform {folder!r}: expected one of {', '.join(_PLATFORMS)}"
        try:
            if not verdict:
                again = _compiled(model, members, files, _platform(path))
                verdict = SAME if again == members[path] else DIFFERENT
        except (ExportError, UnicodeDecodeError) as error:
            verdict = str(error)
        yield path, verdict
    yield from _of_others(members)


def _compiled(model: str, members: Mapping[str, bytes], files: Sequence[str], platform: str) -> bytes:
    """Returns the library of files in `sources`; ExportError if others are included, or lie there."""
    paths = [path for path in members if path.startswith("sources/") and path != _DESCRIPTION]
    sources = {path.removeprefix("sources/"): members[path].decode() for path in paths}
    # a name must not lead to another folder, nor be an option of the compiler
    plain = {name for name in sources if re.fullmatch(r"\w[\w.]*", name)}
    if odd := {*sources, *files} - plain:
        raise ExportError(f"sources/{min(odd)}: expected a file there, named by letters, digits and points")
    with tempfile.TemporaryDirectory() as folder:
        # the compiler lists what it reads, however the directive is written
        listing = "-MD", "-MF", str(Path(folder, "%TARGET%"))
        library = compile_library(model, sources, files, platform, listing)
        texts = (path.read_text("utf-8").partition(": ")[2] for path in Path(folder).iterdir())
        names = re.split(r"(?<!\\)\s+", " ".join(texts).replace("\\\n", " "))
    read = {Path(os.path.normpath(re.sub(r"\\([ #])", r"\1", name))) for name in names if name}
    # the compiler names its own files with or without symbolic links
    zig = Path(ziglang.__file__).parent
    known = FMI_HEADERS, zig, zig.resolve(), *map(Path, sources)
    if outside := [file for file in read if not any(map(file.is_relative_to, known))]:
        raise ExportError(f"sources include {outside[0]}: expected files of sources, of FMI and of C alone")
    if unused := sources.keys() - {_OF_ENSEMBLES, *map(str, read)}:
        raise ExportError(f"sources/{min(unused)}: neither listed in {_DESCRIPTION} nor included by what is")
    return library


def _of_others(members: Mapping[str, bytes]) -> Iterator[tuple[str, str]]:
    """Yields verdicts on members that differ from their digests, on the bill of materials and the GUID."""
    bill, listed, again, first = members.get(MEMBER, b""), dict[str, str](), b"", b""
    with suppress(*_NO_BILL):
        files = [part for part in json.loads(bill)["components"] if part["type"] == "file"]
        listed = {str(part["name"]): part["hashes"][0]["content"] for part in files}
        first = with_files(bill, {})
        again = with_files(bill, {name: (_platform(name), members[name]) for name in listed})
    for name in sorted(name for name in listed if not _platform(name)):
        is_same = hashlib.sha256(members.get(name, b"")).hexdigest() == listed[name]
        if not (is_same and name.startswith(_OUTSIDE_GUID)):
            yield name, DIFFERENT
    yield MEMBER, SAME if bill and again == bill else DIFFERENT
    root = ElementTree.fromstring(members["modelDescription.xml"])
    guid = root.get("guid") or root.get("instantiationToken") or "none"
    covered = {name: content for name, content in members.items() if name not in listed} | {MEMBER: first}
    before = {name: content.replace(guid.encode(), GUID.encode()) for name, content in covered.items()}
    yield f"GUID {guid}", SAME if with_guid(before, RECIPE) == (guid, covered) else DIFFERENT


def _platform(path: str) -> str:
    """Returns the platform of a library; "" for another member."""
    return _PLATFORMS.get(PurePosixPath(path).parent.name, "") if path.startswith("binaries/") else ""


def _reason(members: Mapping[str, bytes], description: ElementTree.Element) -> str:
    """Returns why this compiler cannot give the same libraries; "" if it can."""
    stated = ""
    with suppress(*_NO_BILL):
        stated = recipe_of(members.get(MEMBER, b"{}"))
    for files in description.iter("SourceFileSet"):
        stated = stated or " ".join(files.get(name, "") for name in ("compiler", "compilerOptions")).strip()
    return "" if stated == RECIPE else f"compiler: the FMU states {stated or 'none'}: expected {RECIPE}"
