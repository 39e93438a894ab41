"""Rules of files in the archive: binaries, sources, documentation, terminals. FMI 2.0.5, 2.1.1 and 2.3."""

import posixpath
import re
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from fmus.compliance.fmu_file import C_IDENTIFIER, FmuFile, schema_errors
from fmus.compliance.rows import add_rows, elements, repeats, row
from fmus.compliance.rule import Condition, Stage, repeated, rule
from fmus.compliance.rules.archive import CLAUSE, PLATFORM, unreadable
from fmus.compliance.variable import is_true

BUILD_DESCRIPTION = "sources/buildDescription.xml"
TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"

_EXTENSIONS = {"darwin": ".dylib", "win": ".dll", "linux": ".so"}
_OF_FMI_2 = re.compile(r"(?:win|linux|darwin)(?:32|64)")  # which FMI 3.0 names as x86_64-linux and the like
_OF_FMI_3 = re.compile(r"x86(?:_64)?-(?:windows|linux|darwin)")  # which FMI 2.0 names as win64 and the like
_SOURCES = "sources/"
_HEADERS = (
    "fmi2TypesPlatform.h", "fmi2FunctionTypes.h", "fmi2Functions.h",
    "fmi3PlatformTypes.h", "fmi3FunctionTypes.h", "fmi3Functions.h",
)  # fmt: skip
_HEADERS_OF_OTHERS = re.compile(  # of the standard library of C, and of other versions of FMI
    r"(?:assert|complex|ctype|errno|fenv|float|inttypes|iso646|limits|locale|math|setjmp|signal|stdalign"
    r"|stdarg|stdatomic|stdbool|stddef|stdint|stdio|stdlib|stdnoreturn|string|tgmath|threads|time|uchar"
    r"|wchar|wctype|fmi\d?(?:TypesPlatform|PlatformTypes|FunctionTypes|Functions))\.h"
)
_TO_COMPILE = (".c", ".cc", ".cpp", ".cxx")
_DEPENDENCIES, _LICENSES = "documentation/externalDependencies.", "documentation/licenses/"
_TEXTS = {2: ("txt", "html"), 3: ("txt", "html", "spdx")}  # of licences
_NO_PAGES = (_DEPENDENCIES, _LICENSES)  # they need no index.html
_RESERVED = ("extra/org.modelica", "extra/org.fmi-standard")
_LAYERED_STANDARD = re.compile(r"extra/org\.(?:modelica|fmi-standard)\.fmi-ls-[a-z0-9-]+/?")
_VARIABLES_OF_TERMINALS = """
    //TerminalMemberVariable/@variableName
    | //TerminalStreamMemberVariable/@*[name() = 'inStreamVariableName' or name() = 'outStreamVariableName']
"""
# by other rules than plug and bus members do not match by their names
_MEMBER = "//Terminal[@matchingRule='plug' or @matchingRule='bus']/TerminalMemberVariable"
_NAMES_OF_TERMINALS = f"{repeats('//Terminal')}/@name | {repeats(_MEMBER, 'memberName')}/@memberName"

_COMMENT = re.compile(rb"/\*.*?\*/|//[^\n]*", re.DOTALL)
_INCLUDE = re.compile(rb'^[ \t]*#[ \t]*include[ \t]*([<"])([^">\n]+)[">]', re.MULTILINE)
_PREFIX = re.compile(rb"^[ \t]*#[ \t]*define[ \t]+FMI2_FUNCTION_PREFIX[ \t]+(\w+)[ \t\r]*$", re.MULTILINE)
_FUNCTIONS = re.compile(rb'^[ \t]*#[ \t]*include[ \t]*["<]fmi2Functions\.h[">]', re.MULTILINE)
_NAMES_FUNCTIONS = (b"FMI2_FUNCTION_PREFIX", b"FMI2_OVERRIDE_FUNCTION_PREFIX")
_DEFINED = re.compile(rb"^(static\s)?[A-Za-z_][\w \t*]*[\s*](\w+)[ \t]*\([^;{}]*\)\s*\{", re.MULTILINE)
_DECLARED = re.compile(rb"^[A-Za-z_][\w \t*]*[\s*]\w+[ \t]*\([^;{}]*\)\s*;", re.MULTILINE)
_MACRO, _CALLED = re.compile(rb"#[ \t]*define[ \t]+(\w+)"), re.compile(rb"\b(\w+)[ \t]*\(")
_GUARD = re.compile(
    rb"^[ \t]*#[ \t]*if(?:ndef|[ \t]+!defined)\W+(\w+)\W*\n\s*#[ \t]*define[ \t]+\1\b", re.MULTILINE
)
_DIRECTIVE = re.compile(rb"[ \t]*#[ \t]*(if|endif)")


def _files(fmu: FmuFile, folder: str) -> list[str]:
    return [path for path in fmu.names if path.startswith(folder) and not path.endswith("/")]


def _extra(fmu: FmuFile) -> list[str]:
    """Returns the files and folders directly below extra; these end with a slash."""
    return sorted({match.group() for path in fmu.names if (match := re.match("extra/[^/]+/?", path))})


def _extension(folder: str) -> str:
    """Returns the extension of shared libraries of a platform; "" for one that FMI does not name."""
    is_known = PLATFORM.fullmatch(folder)
    return next((_EXTENSIONS[name] for name in _EXTENSIONS if is_known and name in folder), "")


def _has_sources(fmu: FmuFile) -> bool:
    return any(path.endswith(_TO_COMPILE) for path in _files(fmu, _SOURCES))


_interfaces = elements("CoSimulation | ModelExchange")


def _identifiers(fmu: FmuFile) -> list[str]:
    """Returns the modelIdentifiers that are names of C."""
    stated = {interface.get("modelIdentifier", "") for interface in _interfaces(fmu)}
    return sorted(filter(C_IDENTIFIER.fullmatch, stated))


def _missing_binary(interface: Any, fmu: FmuFile) -> str:
    """Returns the library that is there in no format, shared or static, for no platform."""
    identifier = interface.get("modelIdentifier", "")
    path = re.compile(rf"binaries/.+/(?:lib)?{re.escape(identifier)}\.\w+")
    return "" if any(map(path.fullmatch, fmu.names)) else f"library {identifier}".strip()


def _tools(fmu: FmuFile) -> list[Any]:
    """Returns the interfaces that need a tool."""
    return [i for i in _interfaces(fmu) if is_true(i.get("needsExecutionTool"))]


def _source_path(name: str) -> str:
    """Returns the path in the archive of a file that is listed relative to the directory sources."""
    return posixpath.normpath(f"{_SOURCES}{name}")


def _listed(interface: Any) -> list[str]:
    """Returns the names that SourceFiles of an interface lists."""
    return [file.get("name", "") for file in interface.iterfind("SourceFiles/File")]


def _is_missing(file: Any, fmu: FmuFile) -> bool:
    is_there = _source_path(file.get("name", "")) in fmu.paths
    return not is_there and (_has_sources(fmu) or not fmu.libraries())


def _unlisted(fmu: FmuFile, extensions: str | tuple[str, ...]) -> list[list[str]]:
    """Returns the sources with these extensions, as one subject, if nothing is listed."""
    is_listed = BUILD_DESCRIPTION in fmu.paths or any(map(_listed, _interfaces(fmu)))
    files = [path for path in _files(fmu, _SOURCES) if path.endswith(extensions)]
    return [files] if files and fmu.interfaces and not is_listed else []


_UNLISTED = (
    (lambda files, fmu: fmu.is_fmi3 and files[0], f"{{value}}: expected {BUILD_DESCRIPTION} that lists it"),
    (
        lambda files, _: ", ".join(files[:3]),
        "{value}: expected SourceFiles that lists what is to be compiled",
    ),
)


@lru_cache(maxsize=1)
def _sources(fmu: FmuFile) -> dict[str, bytes]:
    """Returns the path of each C file and header below sources -> its text without comments."""
    paths = [path for path in _files(fmu, _SOURCES) if path.endswith((*_TO_COMPILE, ".h"))]
    return {path: _COMMENT.sub(b"", fmu.read(path)) for path in paths}


def _included(text: bytes, marks: bytes = b'"<') -> list[str]:
    """Returns the files that C code includes, by quotes or by the angle bracket `<`."""
    names = [name for begin, name in _INCLUDE.findall(text) if begin in marks]
    return list(dict.fromkeys(name.decode("utf-8", "replace").strip() for name in names))


def _compiled(fmu: FmuFile, listed: list[str]) -> dict[str, bytes]:
    """Returns path -> text of the sources that are listed, and of those that any source includes."""
    names = {*listed, *(name for text in _sources(fmu).values() for name in _included(text))}
    stems = {posixpath.basename(name) for name in names}
    return {path: text for path, text in _sources(fmu).items() if posixpath.basename(path) in stems}


add_rows(__name__, Stage.FILE, condition=unreadable, rows=(
    row("platform-names", lambda fmu: fmu.platforms(),
        (lambda folder, fmu: fmu.is_fmi3 and _OF_FMI_2.fullmatch(folder),
         "binaries/{subject}: expected a name such as x86_64-linux or aarch64-darwin"),
        (lambda folder, fmu: (not fmu.is_fmi3 and not PLATFORM.fullmatch(folder))
         or (fmu.version == "2.0" and _OF_FMI_3.fullmatch(folder)),
         "binaries/{subject}: expected win64, linux64, darwin64, aarch64-linux or the like")),
    row("documentation-has-an-entry",
        lambda fmu: [[path for path in _files(fmu, "documentation/") if not path.startswith(_NO_PAGES)]],
        (lambda files, _: "documentation/index.html" not in files and ", ".join(files[:3]),
         "{value}: expected documentation/index.html, where a reader begins")),
    row("licenses-have-an-entry", lambda fmu: [_files(fmu, _LICENSES)],
        (lambda files, fmu: files and not {f"{_LICENSES}license.{end}" for end in _TEXTS[fmu.fmi]} & {*files},
         "documentation/licenses/: expected license.txt or license.html, where a reader begins")),
    row("icon-is-png", lambda fmu: [fmu.read(path) for path in fmu.paths if path == "model.png"],
        (lambda content, _: not content.startswith(b"\x89PNG\r\n\x1a\n"),
         "model.png: expected a picture in the format PNG")),
    row("extra-names-are-not-reserved", _extra,
        (lambda path, _: path.startswith(_RESERVED) and not _LAYERED_STANDARD.fullmatch(path),
         "{subject}: expected a name of the maker's own, as this is for layered standards of FMI")),
))  # fmt: skip
add_rows(__name__, Stage.DESCRIPTION, rows=(
    row("has-an-implementation", _interfaces,
        (lambda interface, fmu: not _has_sources(fmu) and _missing_binary(interface, fmu),
         "{subject.tag}: no {value} below binaries, no C file in sources: expected one")),
    row("tool-wrapper-is-a-binary", _tools,
        (_missing_binary, "{subject.tag} has needsExecutionTool: expected a {value} that talks to it")),
    row("tool-is-documented", _tools,
        (lambda _, fmu: not {f"{_DEPENDENCIES}txt", f"{_DEPENDENCIES}html"} & fmu.paths,
         "{subject.tag} has needsExecutionTool: expected documentation/externalDependencies.txt or .html")),
    row("source-files-are-distributed",
        lambda fmu: _interfaces(fmu) if fmu.libraries() and not _has_sources(fmu) else (),
        (lambda interface, _: ", ".join(_listed(interface)[:3]),
         "{subject.tag}: SourceFiles lists {value}: expected none, as there are no sources")),
    row("source-files-exist", elements("*/SourceFiles/File"),
        (lambda file, _: "\\" in file.get("name", ""),
         "line {subject.sourceline}, SourceFiles lists {name}: expected forward slashes"),
        (lambda file, _: file.get("name", "").startswith("/"),
         "line {subject.sourceline}, SourceFiles lists {name}: expected a path below sources"),
        (_is_missing,
         "line {subject.sourceline}, SourceFiles lists {name}: expected sources/{name} in the archive")),
    row("sources-are-listed", lambda fmu: [] if fmu.libraries() else _unlisted(fmu, _TO_COMPILE),
        *_UNLISTED),
    row("sources-beside-a-library-are-listed", lambda fmu: _unlisted(fmu, ".c") if fmu.libraries() else [],
        *_UNLISTED),
))  # fmt: skip


@rule(CLAUSE, Stage.DESCRIPTION)
def library_names(fmu: FmuFile) -> Iterator[str]:
    """A platform's folder holds a library that is called as a modelIdentifier, with its extension."""
    identifiers = _identifiers(fmu)
    identifier = f"(?:{'|'.join(map(re.escape, identifiers))})"
    for folder in fmu.platforms() if identifiers else ():
        extension, top = _extension(folder), f"binaries/{folder}/"
        # static libraries lie in a folder of the compiler
        static = rf"{top}.+/(?:{identifier}\.(?:lib|a)|lib{identifier}\.a)"
        # Windows ignores case
        case = "(?i)" if extension == ".dll" else ""
        library = re.compile(rf"{case}{top}{identifier}{re.escape(extension)}|{static}")
        if extension and not any(map(library.fullmatch, fmu.names)):
            expected = " or ".join(f"{name}{extension}" for name in identifiers)
            yield f"{top}: expected {expected}, as the folder exists"


@rule(CLAUSE, Stage.DESCRIPTION)
def source_files_are_complete(fmu: FmuFile) -> Iterator[str]:
    """The files in SourceFiles define every function that they call and other C files define, and FMI's."""
    for interface in filter(_listed, _interfaces(fmu)):
        compiled = _compiled(fmu, _listed(interface))
        text = b"\n".join(compiled.values())
        calls = _DECLARED.sub(b"", b"\n".join(map(_unconditional, compiled.values())))
        missing = {b"fmi2Instantiate", *_CALLED.findall(calls)} - {*_MACRO.findall(text)}
        missing -= {name for _, name in _DEFINED.findall(text)}
        for path in sorted(path for path in _sources(fmu).keys() - compiled if path.endswith(_TO_COMPILE)):
            names = {name for is_static, name in _DEFINED.findall(_sources(fmu)[path]) if not is_static}
            if names & missing:
                what = f"{interface.tag}: SourceFiles leaves out {path.removeprefix(_SOURCES)}, which alone"
                yield f"{what} defines {min(names & missing).decode()}: expected all files to compile"


@rule(CLAUSE, Stage.DESCRIPTION)
def source_files_are_compiled(fmu: FmuFile) -> Iterator[str]:
    """SourceFiles lists no header, and no file that another one of them includes."""
    for interface in _interfaces(fmu):
        listed = {posixpath.normpath(name): name for name in _listed(interface)}
        paths = [path for path in listed if f"{_SOURCES}{path}" in fmu.paths]
        included = {
            posixpath.normpath(posixpath.join(posixpath.dirname(path), name))
            for path in paths
            for name in _included(fmu.read(f"{_SOURCES}{path}"))
        }
        for path in paths:
            if path.endswith((".h", ".hpp")) or path in included:
                what = f"{interface.tag}: SourceFiles lists {listed[path]}"
                yield f"{what}, which others include: expected files to compile"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def included_files_exist(fmu: FmuFile) -> Iterator[str]:
    """Files that C files include by quotes, outside of #if, are among the sources, except headers of FMI and
    C. Where SourceFiles lists files, only these and the files that they include are judged.
    """
    known = {posixpath.basename(path) for path in _files(fmu, _SOURCES)}
    listed = [name for interface in _interfaces(fmu) for name in _listed(interface)]
    for path, text in sorted((_compiled(fmu, listed) if listed else _sources(fmu)).items()):
        if path.endswith(_TO_COMPILE):
            for included in _included(_unconditional(text), b'"'):
                name = posixpath.basename(included)
                if name not in known and not _HEADERS_OF_OTHERS.fullmatch(name):
                    yield f'{path}: #include "{included}": expected that file below sources'


@rule("2.1.1", Stage.DESCRIPTION)
def source_prefix(fmu: FmuFile) -> Iterator[str]:
    """Sources that define FMI2_FUNCTION_PREFIX as a word define it as modelIdentifier with an underscore, and
    before they include fmi2Functions.h.
    """
    identifiers = _identifiers(fmu)
    expected = [f"{identifier}_" for identifier in identifiers]
    for path, text in _sources(fmu).items() if expected else ():
        prefixes = {name.decode("ascii", "replace") for name in _PREFIX.findall(text)}
        # one file may serve several FMUs by #if
        for prefix in sorted(prefixes) if prefixes.isdisjoint(expected) else ():
            if prefix.endswith("_") or prefix in identifiers:
                yield f"{path} defines the prefix {prefix}: expected {' or '.join(expected)}"
        if _between(text) is None:
            yield f"{path} defines FMI2_FUNCTION_PREFIX: expected that before it includes fmi2Functions.h"


@rule("2.1.1", Stage.DESCRIPTION)
def source_prefix_is_defined(fmu: FmuFile) -> Iterator[str]:
    """Sources that include fmi2Functions.h define FMI2_FUNCTION_PREFIX directly before that, or say how their
    build does.
    """
    own = {path: text for path, text in _sources(fmu).items() if posixpath.basename(path) not in _HEADERS}
    including = sorted(path for path, text in own.items() if _FUNCTIONS.search(text))
    built = (fmu.read(path) for path in _files(fmu, _SOURCES) if posixpath.basename(path) not in _HEADERS)
    if including and not any(name in text for text in built for name in _NAMES_FUNCTIONS):
        yield f"{including[0]} includes fmi2Functions.h: expected #define FMI2_FUNCTION_PREFIX before that"
    for path in including:
        if between := (_between(own[path]) or b"").split():
            word = b" ".join(between)[:40].decode("utf-8", "replace")
            yield f"{path}: {word} follows FMI2_FUNCTION_PREFIX: expected fmi2Functions.h directly after it"


def _between(text: bytes) -> bytes | None:
    """Returns the text between FMI2_FUNCTION_PREFIX and fmi2Functions.h; None in the other order."""
    lines = _unconditional(text)
    define, include = _PREFIX.search(lines), _FUNCTIONS.search(lines)
    if not define or not include:
        return b""
    return lines[define.end() : include.start()] if define.start() < include.start() else None


def _unconditional(text: bytes) -> bytes:
    """Returns the lines that every compiler reads: outside of #if, except the guard of a header."""
    lines, depth = [], 0
    for line in _GUARD.sub(b"", text).splitlines():
        directive = _DIRECTIVE.match(line)
        if directive is None and depth == 0:
            lines.append(line)
        elif directive:
            depth = max(0, depth + (-1 if directive.group(1) == b"endif" else 1))
    return b"\n".join(lines)


def _unless_there(path: str) -> Condition:
    """Returns the reason why rules of an optional file do not apply to an FMU."""
    return lambda fmu: "" if path in fmu.paths else f"there is no {path}"


def _fmi3_errors(fmu: FmuFile, root: Any, path: str, schema: str) -> Iterator[str]:
    """Yields errors by a schema of FMI 3.0; any version may be stated, as FMI 2.0 does not say which."""
    stated = root.attrib.pop("fmiVersion", None)
    root.set("fmiVersion", "3.0")
    for error in schema_errors(root, f"fmi3/{schema}"):
        yield f"{path}, line {error.line}: {error.message}"
    if stated is None:
        yield f"{path}, fmiVersion is missing: expected one"
    elif fmu.is_fmi3 and stated != fmu.version:
        yield f"{path}, fmiVersion {stated}: expected {fmu.version}, as in the model description"


@rule(CLAUSE, Stage.DESCRIPTION, condition=_unless_there(BUILD_DESCRIPTION))
def build_description(fmu: FmuFile) -> Iterator[str]:
    """buildDescription.xml is valid by FMI 3.0, of this model, and names files below sources."""
    root, path = fmu.parsed(BUILD_DESCRIPTION), BUILD_DESCRIPTION
    yield from _fmi3_errors(fmu, root, path, "fmi3BuildDescription.xsd")
    fallbacks = root.xpath("BuildConfiguration[not(@platform)]/@modelIdentifier") if fmu.is_fmi3 else ()
    for identifier, count in repeated(fallbacks).items():
        yield f"{path}: {count} configurations of {identifier} are without platform: expected one at most"
    identifiers = _identifiers(fmu)
    for configuration in root.iterfind("BuildConfiguration"):
        identifier = configuration.get("modelIdentifier")
        if identifier not in identifiers:
            yield f"{path}: modelIdentifier {identifier!r}: expected {' or '.join(identifiers)}"
        for file in configuration.iterfind("SourceFileSet/SourceFile"):
            if _source_path(file.get("name", "")) not in fmu.paths:
                yield f"{path} lists {file.get('name')}: expected it below sources"


@rule("2.3.2", Stage.DESCRIPTION, condition=_unless_there(TERMINALS))
def terminals_and_icons(fmu: FmuFile) -> Iterator[str]:
    """terminalsAndIcons.xml is valid by FMI 3.0; terminals have unique names, and variables of the FMU."""
    root = fmu.parsed(TERMINALS)
    yield from _fmi3_errors(fmu, root, TERMINALS, "fmi3TerminalsAndIcons.xsd")
    variables = {*(v.name for v in fmu.variables), *fmu.root.xpath("ModelVariables/*/Alias/@name")}
    for name in root.xpath(_VARIABLES_OF_TERMINALS):
        if name and name not in variables:
            yield f"{TERMINALS}: {name.attrname} {name!r}: expected the name of a variable"
    for name in root.xpath(_NAMES_OF_TERMINALS):
        where = f"{TERMINALS}, line {name.getparent().sourceline}"
        yield f"{where}: {name.attrname} {name!r} is another one's, too: expected a unique one"
