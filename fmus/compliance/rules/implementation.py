"""Rules of binaries and sources in the archive: FMI 2.0.5, 2.3 FMU Distribution."""

import posixpath
import re
from collections.abc import Iterator

from fmus.compliance.contents import BUILD_DESCRIPTION, fmi3_schema_errors, parsed_member, unless_there
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Stage, rule
from fmus.compliance.rules.archive import CLAUSE, unreadable
from fmus.compliance.variable import is_true

_EXTENSIONS = {"win": ".dll", "windows": ".dll", "linux": ".so", "darwin": ".dylib"}
_PLATFORM = re.compile(
    r"(?:(?P<old>win|linux|darwin)(?:32|64)"
    r"|(?:aarch|riscv|ppc|x86_)(?:32|64)-(?P<new>windows|linux|darwin)(?:-\w+)?"
    r"|x86-(?P<x86>windows|linux|darwin)(?:-\w+)?)"
)
HEADERS = ("fmi2TypesPlatform.h", "fmi2FunctionTypes.h", "fmi2Functions.h")
TO_COMPILE = (".c", ".cc", ".cpp", ".cxx")
_INCLUDE = re.compile(rb"^[ \t]*#[ \t]*include[ \t]*<([^>\n]+)>", re.MULTILINE)
QUOTED_INCLUDE = re.compile(rb'^[ \t]*#[ \t]*include[ \t]*"([^"\n]+)"', re.MULTILINE)
SOURCES = "sources/"


def _extension(folder: str) -> str:
    """Returns the extension of shared libraries of a platform; "" for one that FMI does not name."""
    match = _PLATFORM.fullmatch(folder)
    system = next((name for name in match.groups() if name), "") if match else ""
    return _EXTENSIONS.get(system, "")


def _identifiers(fmu: FmuFile) -> list[str]:
    return sorted({kind.get("modelIdentifier", "") for kind in fmu.interfaces.values()})


def _is_shared(path: str, identifier: str) -> bool:
    """Whether it is a shared library of this name in a platform's folder."""
    extensions = set(_EXTENSIONS.values())
    return (
        path.count("/") == 2
        and path.startswith("binaries/")
        and any(path.endswith(f"/{identifier}{extension}") for extension in extensions)
    )


def _is_static(path: str, identifier: str) -> bool:
    """Whether it is a static library of this name in a compiler's folder below a platform's."""
    folders, _, name = path.rpartition("/")
    names = (f"{identifier}.lib", f"{identifier}.a", f"lib{identifier}.a")
    return folders.startswith("binaries/") and folders.count("/") > 1 and name in names


def _is_binary(path: str, identifier: str) -> bool:
    """Whether it is a library of this name, of any format for a platform that FMI does not name."""
    folders, _, name = path.rpartition("/")
    is_of_vendor = path.startswith("binaries/") and not _extension(folders.removeprefix("binaries/"))
    return (
        _is_shared(path, identifier)
        or _is_static(path, identifier)
        or (is_of_vendor and folders.count("/") == 1 and name.partition(".")[0] == identifier)
    )


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def platform_names(fmu: FmuFile) -> Iterator[str]:
    """Folders below binaries are named as FMI 2.0 (linux64) or FMI 3.0 (aarch64-linux) does."""
    for folder in fmu.platforms():
        if not _PLATFORM.fullmatch(folder):
            yield f"binaries/{folder}: expected win64, linux64, darwin64, aarch64-linux or the like"


@rule(CLAUSE, Stage.DESCRIPTION)
def library_names(fmu: FmuFile) -> Iterator[str]:
    """A platform's folder holds a library that is called as a modelIdentifier, with its extension."""
    for folder in fmu.platforms():
        extension, top = _extension(folder), f"binaries/{folder}/"
        identifiers = _identifiers(fmu)
        shared = any(f"{top}{identifier}{extension}" in fmu.paths for identifier in identifiers)
        static = any(
            path.startswith(top) and _is_static(path, identifier)
            for path in fmu.names
            for identifier in identifiers
        )
        if extension and not shared and not static:
            expected = " or ".join(f"{identifier}{extension}" for identifier in identifiers)
            yield f"{top}: expected {expected}, as the folder exists"


@rule(CLAUSE, Stage.DESCRIPTION)
def has_an_implementation(fmu: FmuFile) -> Iterator[str]:
    """There is a binary for some platform, or sources, of each interface."""
    for kind, attributes in fmu.interfaces.items():
        identifier = attributes.get("modelIdentifier", "")
        if not _has_sources(fmu) and not any(_is_binary(path, identifier) for path in fmu.names):
            yield f"{kind}: no library {identifier} below binaries and no C file below sources: expected one"


@rule(CLAUSE, Stage.DESCRIPTION)
def tool_wrapper_is_a_binary(fmu: FmuFile) -> Iterator[str]:
    """With needsExecutionTool there is a binary, which talks to the tool."""
    for kind, attributes in fmu.interfaces.items():
        identifier = attributes.get("modelIdentifier", "")
        needs = is_true(attributes.get("needsExecutionTool"))
        if needs and not any(_is_shared(path, identifier) for path in fmu.names):
            yield f"{kind} has needsExecutionTool: expected a library {identifier} that talks to the tool"


@rule(CLAUSE, Stage.DESCRIPTION)
def tool_is_documented(fmu: FmuFile) -> Iterator[str]:
    """With needsExecutionTool, documentation/externalDependencies.txt or .html exists."""
    files = {f"documentation/externalDependencies.{extension}" for extension in ("txt", "html")}
    for kind, attributes in fmu.interfaces.items():
        if is_true(attributes.get("needsExecutionTool")) and not files & fmu.paths:
            yield f"{kind} has needsExecutionTool: expected documentation/externalDependencies.txt or .html"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def headers_of_fmi_are_left_out(fmu: FmuFile) -> Iterator[str]:
    """Below sources and binaries there are no header files of FMI: they are the importer's."""
    for path in fmu.names:
        if path.startswith((SOURCES, "binaries/")) and path.rpartition("/")[2] in HEADERS:
            yield f"{path}: expected it to be left out, the importer has it"


def _has_sources(fmu: FmuFile) -> bool:
    return any(path.startswith(SOURCES) and path.endswith(TO_COMPILE) for path in fmu.names)


def _source_path(name: str) -> str:
    """Returns the path in the archive of a file that is listed relative to the directory sources."""
    return posixpath.normpath(f"{SOURCES}{name}")


def _listed_sources(fmu: FmuFile) -> dict[str, list[str]]:
    """Returns interface -> names of SourceFiles."""
    return {
        kind: [file.get("name", "") for file in fmu.root.iterfind(f"{kind}/SourceFiles/File")]
        for kind in fmu.interfaces
    }


@rule(CLAUSE, Stage.DESCRIPTION)
def sources_are_listed(fmu: FmuFile) -> Iterator[str]:
    """SourceFiles, or buildDescription.xml, lists the C files below sources that are to be compiled; beside
    a library, files of other languages may be there to be read.
    """
    extensions = (".c",) if fmu.libraries() else TO_COMPILE
    files = [path for path in fmu.names if path.startswith(SOURCES) and path.endswith(extensions)]
    if (
        files
        and fmu.interfaces
        and not any(_listed_sources(fmu).values())
        and BUILD_DESCRIPTION not in fmu.paths
    ):
        yield f"{', '.join(files[:3])}: expected SourceFiles that lists what is to be compiled"


@rule("2.3 FMU Distribution, 3.3.1 and 4.3.1 (SourceFiles)", Stage.DESCRIPTION)
def source_files_exist(fmu: FmuFile) -> Iterator[str]:
    """Every file that SourceFiles lists is below sources, its path relative and with forward slashes."""
    for kind, names in _listed_sources(fmu).items():
        for name in names:
            if "\\" in name:
                yield f"{kind}: SourceFiles lists {name}: expected forward slashes"
            elif name.startswith("/"):
                yield f"{kind}: SourceFiles lists {name}: expected a path below sources"
            elif _source_path(name) not in fmu.paths and (_has_sources(fmu) or not fmu.libraries()):
                yield f"{kind}: SourceFiles lists {name}: expected sources/{name} in the archive"


@rule(CLAUSE, Stage.DESCRIPTION)
def source_files_are_distributed(fmu: FmuFile) -> Iterator[str]:
    """SourceFiles, which is meaningful for sources alone, is left out where the FMU holds no sources."""
    for kind, names in _listed_sources(fmu).items():
        if names and not _has_sources(fmu) and fmu.libraries():
            yield f"{kind}: SourceFiles lists {', '.join(names[:3])}: expected none, as there are no sources"


@rule(CLAUSE, Stage.DESCRIPTION)
def source_files_are_compiled(fmu: FmuFile) -> Iterator[str]:
    """SourceFiles lists no header, and no file that another one of them includes."""
    for kind, names in _listed_sources(fmu).items():
        paths = {path: name for name in names if (path := _source_path(name)) in fmu.paths}
        included = {
            posixpath.normpath(posixpath.join(posixpath.dirname(path), other.decode("utf-8", "replace")))
            for path in paths
            for other in QUOTED_INCLUDE.findall(fmu.read(path))
        }
        for path, name in paths.items():
            if path.endswith((".h", ".hpp")) or path in included:
                yield f"{kind}: SourceFiles lists {name}, which others include: expected files to compile"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def includes_have_quotes(fmu: FmuFile) -> Iterator[str]:
    """Sources include the header files that the FMU holds by quotes, not by angle brackets."""
    sources = [path for path in fmu.names if path.startswith(SOURCES) and path.endswith((*TO_COMPILE, ".h"))]
    headers = {path.removeprefix(SOURCES) for path in sources}
    for path in sources:
        included = {name.decode("utf-8", "replace").strip() for name in _INCLUDE.findall(fmu.read(path))}
        for name in sorted(included & headers):
            yield f'{path}: #include <{name}>: expected "{name}", as it is in the FMU'


@rule(CLAUSE, Stage.DESCRIPTION, condition=unless_there(BUILD_DESCRIPTION))
def build_description(fmu: FmuFile) -> Iterator[str]:
    """buildDescription.xml is valid by FMI 3.0, of this model, and names files below sources."""
    root, problem = parsed_member(fmu, BUILD_DESCRIPTION)
    if problem:
        yield f"{BUILD_DESCRIPTION}: {problem}"
        return
    yield from (f"{BUILD_DESCRIPTION}, {e}" for e in fmi3_schema_errors(root, "fmi3BuildDescription.xsd"))
    for configuration in root.iterfind("BuildConfiguration"):
        identifier, expected = configuration.get("modelIdentifier"), _identifiers(fmu)
        if identifier not in expected:
            yield f"{BUILD_DESCRIPTION}: modelIdentifier {identifier!r}: expected {' or '.join(expected)}"
        for file in configuration.iterfind("SourceFileSet/SourceFile"):
            if _source_path(file.get("name", "")) not in fmu.paths:
                yield f"{BUILD_DESCRIPTION} lists {file.get('name')}: expected it below sources"
