"""Compiling the sources inside an FMU again, and comparing the libraries with those inside byte for byte."""

import zipfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import PurePosixPath
from xml.etree import ElementTree

from fmus.errors import ExportError
from fmus.native.sbom import MEMBER, RECIPE, recipe_of
from fmus.native.toolchain import compile_library
from fmus.platforms import TARGETS, platform_folder

SAME = "same"
DIFFERENT = "different"
_DESCRIPTION = "sources/buildDescription.xml"
_PLATFORMS = {platform_folder(name, fmi): name for name in TARGETS for fmi in (2, 3)}


def verified(archive: zipfile.ZipFile) -> Iterator[tuple[str, str]]:
    """Yields the path of each library in an FMU, and `SAME`, `DIFFERENT` or why it cannot be compiled anew.

    Raises ExportError for a description of the build that is no XML.
    """
    members = {name: archive.read(name) for name in archive.namelist() if name[-1] != "/"}
    texts = ((path, data) for path, data in members.items() if path.startswith("sources/"))
    sources = {PurePosixPath(path).name: data.decode("utf-8", "replace") for path, data in texts}
    try:
        description = ElementTree.fromstring(members.get(_DESCRIPTION, b"<none/>"))
    except ElementTree.ParseError as error:
        raise ExportError(f"{_DESCRIPTION}: {error}: expected XML") from error
    files = [file.get("name", "") for file in description.iter("SourceFile")]
    reason = _reason(members, description) if files else f"no source files in {_DESCRIPTION}"
    for path in (PurePosixPath(name) for name in members if name.startswith("binaries/")):
        platform, verdict = _PLATFORMS.get(path.parent.name), reason
        if not platform:
            verdict = f"no platform {path.parent.name!r}: expected one of {', '.join(_PLATFORMS)}"
        try:
            if platform and not reason:
                again = compile_library(path.stem, sources, files, platform)
                verdict = SAME if again == members[str(path)] else DIFFERENT
        except ExportError as error:
            verdict = str(error)
        yield str(path), verdict


def _reason(members: Mapping[str, bytes], description: ElementTree.Element) -> str:
    """Returns why this compiler cannot compile what the libraries were compiled to; "" if it can."""
    stated = ""
    with suppress(ValueError, LookupError, TypeError, AttributeError):  # a bill of another tool
        stated = recipe_of(members.get(MEMBER, b"{}"))
    for files in description.iter("SourceFileSet"):
        stated = stated or " ".join(files.get(name, "") for name in ("compiler", "compilerOptions")).strip()
    return "" if stated == RECIPE else f"compiler: the FMU states {stated or 'none'}: expected {RECIPE}"
