"""Rules of files in the archive: binaries, sources, documentation, terminals. FMI 2.0.5, 2.1.1 and 2.3."""

import posixpath
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import lru_cache
from itertools import filterfalse
from typing import Any

from fmus.compliance.fmu_file import BrokenMemberError, FmuFile, schema_errors
from fmus.compliance.rows import add_rows, anything, elements, repeated_children, row, told
from fmus.compliance.rule import Condition, Stage, rule
from fmus.compliance.rules.archive import CLAUSE, unreadable
from fmus.compliance.variable import is_true

BUILD_DESCRIPTION = "sources/buildDescription.xml"
TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
_NAMING = "2.1.1 Header Files and Naming of Functions"
_EXTRA, _TERMINALS = "2.3.1 Extra Directory", "2.3.2 Terminals and Icons"

_PLATFORM = re.compile(
    r"(?:win|linux|darwin)(?:32|64)|(?:(?:aarch|riscv|ppc|x86_)(?:32|64)|x86)-(?:windows|linux|darwin)(?:-\w+)?"
)
_EXTENSIONS = {"darwin": ".dylib", "win": ".dll", "linux": ".so"}
_SOURCES, _DOCUMENTATION = "sources/", "documentation/"
_HEADERS = ("fmi2TypesPlatform.h", "fmi2FunctionTypes.h", "fmi2Functions.h")
_HEADERS_OF_OTHERS = re.compile(  # of the standard library of C, and of other versions of FMI
    r"(?:assert|complex|ctype|errno|fenv|float|inttypes|iso646|limits|locale|math|setjmp|signal|stdalign"
    r"|stdarg|stdatomic|stdbool|stddef|stdint|stdio|stdlib|stdnoreturn|string|tgmath|threads|time|uchar"
    r"|wchar|wctype|fmi\d?(?:TypesPlatform|PlatformTypes|FunctionTypes|Functions))\.h"
)
_TO_COMPILE = (".c", ".cc", ".cpp", ".cxx")
_INDEX, _DEPENDENCIES = f"{_DOCUMENTATION}index.html", f"{_DOCUMENTATION}externalDependencies."
_LICENSES = f"{_DOCUMENTATION}licenses/"
_PNG = b"\x89PNG\r\n\x1a\n"
_RESERVED = ("extra/org.modelica", "extra/org.fmi-standard")
_LAYERED_STANDARD = re.compile(r"extra/org\.(?:modelica|fmi-standard)\.fmi-ls-[a-z0-9-]+/?")
_REVERSE_DOMAIN = re.compile(r"extra/[A-Za-z][A-Za-z0-9-]*(?:\.[A-Za-z0-9_-]+)+/")

_COMMENT = re.compile(rb"/\*.*?\*/|//[^\n]*", re.DOTALL)
_INCLUDE = re.compile(rb"^[ \t]*#[ \t]*include[ \t]*<([^>\n]+)>", re.MULTILINE)
_QUOTED_INCLUDE = re.compile(rb'^[ \t]*#[ \t]*include[ \t]*"([^"\n]+)"', re.MULTILINE)
_PREFIX = re.compile(rb"^[ \t]*#[ \t]*define[ \t]+FMI2_FUNCTION_PREFIX[ \t]+(\w+)[ \t\r]*$", re.MULTILINE)
_FUNCTIONS = re.compile(rb'^[ \t]*#[ \t]*include[ \t]*["<]fmi2Functions\.h[">]', re.MULTILINE)
_NAMES_FUNCTIONS = (b"FMI2_FUNCTION_PREFIX", b"FMI2_OVERRIDE_FUNCTION_PREFIX")
_GUARD = re.compile(
    rb"^[ \t]*#[ \t]*if(?:ndef|[ \t]+!defined)\W+(\w+)\W*\n\s*#[ \t]*define[ \t]+\1\b", re.MULTILINE
)
_DIRECTIVE = re.compile(rb"[ \t]*#[ \t]*(if|endif)")
_DEFINED = re.compile(rb"^(static\s)?[A-Za-z_][\w \t*]*[\s*](\w+)[ \t]*\([^;{}]*\)\s*\{", re.MULTILINE)
_MACRO, _CALLED = re.compile(rb"#[ \t]*define[ \t]+(\w+)"), re.compile(rb"\b(\w+)[ \t]*\(")


def _files(fmu: FmuFile, folder: str) -> list[str]:
    return [path for path in fmu.names if path.startswith(folder) and not path.endswith("/")]


def _is_no_page(path: str) -> bool:
    """Whether a file below documentation is entered otherwise than by index.html."""
    return path.startswith((_LICENSES, _DEPENDENCIES))


def _extra(fmu: FmuFile) -> list[str]:
    """Returns the files and folders directly below extra; these end with a slash."""
    return sorted({match.group() for path in fmu.names if (match := re.match("extra/[^/]+/?", path))})


def _extension(folder: str) -> str:
    """Returns the extension of shared libraries of a platform; "" for one that FMI does not name."""
    is_known = _PLATFORM.fullmatch(folder)
    return next((_EXTENSIONS[name] for name in _EXTENSIONS if is_known and name in folder), "")


def _has_sources(fmu: FmuFile) -> bool:
    return any(path.endswith(_TO_COMPILE) for path in _files(fmu, _SOURCES))


def _interfaces(fmu: FmuFile) -> Iterator[Any]:
    """Yields the elements CoSimulation and ModelExchange."""
    return fmu.root.iterchildren("CoSimulation", "ModelExchange")


def _identifiers(fmu: FmuFile) -> list[str]:
    return sorted({interface.get("modelIdentifier", "") for interface in _interfaces(fmu)})


def _has_library(interface: Any, fmu: FmuFile) -> bool:
    """Whether there is a shared library for a platform that FMI names."""
    stems = {posixpath.basename(path).rpartition(".")[0] for path in fmu.libraries()}
    return interface.get("modelIdentifier", "") in stems


def _has_binary(interface: Any, fmu: FmuFile) -> bool:
    """Whether there is a library of any format, shared or static, for any platform."""
    name = re.compile(rf"binaries/.+/(?:lib)?{re.escape(interface.get('modelIdentifier', ''))}\.\w+")
    return any(name.fullmatch(path) for path in fmu.names)


def _is_without_tool(interface: Any, fmu: FmuFile) -> bool:
    return is_true(interface.get("needsExecutionTool")) and not _has_library(interface, fmu)


def _is_without_documents(interface: Any, fmu: FmuFile) -> bool:
    documents = {f"{_DEPENDENCIES}txt", f"{_DEPENDENCIES}html"}
    return is_true(interface.get("needsExecutionTool")) and not documents & fmu.paths


def _source_path(name: str) -> str:
    """Returns the path in the archive of a file that is listed relative to the directory sources."""
    return posixpath.normpath(f"{_SOURCES}{name}")


def _listed(interface: Any) -> list[str]:
    """Returns the names that SourceFiles of an interface lists."""
    return [file.get("name", "") for file in interface.iterfind("SourceFiles/File")]


def _listed_without_sources(interface: Any, fmu: FmuFile) -> str:
    return "" if _has_sources(fmu) or not fmu.libraries() else ", ".join(_listed(interface)[:3])


def _is_missing(file: Any, fmu: FmuFile) -> bool:
    is_there = _source_path(file.get("name", "")) in fmu.paths
    return not is_there and (_has_sources(fmu) or not fmu.libraries())


def _unlisted(fmu: FmuFile, extensions: str | tuple[str, ...]) -> list[list[str]]:
    """Returns the sources with these extensions, as one subject, if nothing is listed."""
    is_listed = BUILD_DESCRIPTION in fmu.paths or any(map(_listed, _interfaces(fmu)))
    files = [path for path in _files(fmu, _SOURCES) if path.endswith(extensions)]
    return [files] if files and fmu.interfaces and not is_listed else []


@lru_cache(maxsize=1)
def _sources(fmu: FmuFile) -> dict[str, bytes]:
    """Returns the path of each C file and header below sources -> its text without comments."""
    paths = [path for path in _files(fmu, _SOURCES) if path.endswith((*_TO_COMPILE, ".h"))]
    return {path: _COMMENT.sub(b"", fmu.read(path)) for path in paths}


def _included(directive: re.Pattern[bytes], text: bytes) -> list[str]:
    return list(dict.fromkeys(name.decode("utf-8", "replace").strip() for name in directive.findall(text)))


def _reached(fmu: FmuFile, listed: Iterable[str]) -> dict[str, bytes]:
    """Returns path -> text of the sources that are listed, and of those that they include."""
    sources, reached = _sources(fmu), {}
    paths = {posixpath.basename(path): path for path in sources}
    waiting = [_source_path(name) for name in listed]
    while waiting:
        path = waiting.pop()
        if path in sources and path not in reached:
            reached[path] = sources[path]
            names = _included(_INCLUDE, sources[path]) + _included(_QUOTED_INCLUDE, sources[path])
            waiting += [paths[name] for name in map(posixpath.basename, names) if name in paths]
    return reached


add_rows(__name__, CLAUSE, Stage.FILE, condition=unreadable, rows=(
    row("platform-names",
        "Folders below binaries are named as FMI 2.0 (linux64) or FMI 3.0 (aarch64-linux) does.",
        lambda fmu: fmu.platforms(),
        (lambda folder, _: not _PLATFORM.fullmatch(folder),
         "binaries/{subject}: expected win64, linux64, darwin64, aarch64-linux or the like")),
    row("headers-of-fmi-are-left-out",
        "Below sources and binaries there are no header files of FMI: they are the importer's.",
        lambda fmu: [*_files(fmu, _SOURCES), *_files(fmu, "binaries/")],
        (lambda path, _: posixpath.basename(path) in _HEADERS,
         "{subject}: expected it to be left out, the importer has it")),
    row("documentation-has-an-entry", "Documentation is entered by documentation/index.html.",
        lambda fmu: [_files(fmu, _DOCUMENTATION)],
        (lambda files, _: _INDEX not in files and ", ".join(list(filterfalse(_is_no_page, files))[:3]),
         "{value}: expected documentation/index.html, where a reader begins")),
    row("licenses-have-an-entry",
        "Licences are entered by documentation/licenses/license.txt or license.html.",
        lambda fmu: [_files(fmu, _LICENSES)],
        (lambda files, _: files and not {f"{_LICENSES}license.txt", f"{_LICENSES}license.html"} & {*files},
         "documentation/licenses/: expected license.txt or license.html, where a reader begins")),
    row("icon-is-png", "model.png is a picture in the format PNG.",
        lambda fmu: [fmu.read(path) for path in fmu.paths if path == "model.png"],
        (lambda content, _: not content.startswith(_PNG), "model.png: expected a picture in the format PNG")),
    row("extra-names-are-not-reserved",
        "Names below extra that begin with org.modelica or org.fmi-standard are of layered standards of FMI.",
        _extra,
        (lambda path, _: path.startswith(_RESERVED) and not _LAYERED_STANDARD.fullmatch(path),
         "{subject}: expected a name of the maker's own, as this is for layered standards of FMI"),
        clause=_EXTRA),
    row("extra-names-are-domains",
        "Files below extra are in a directory that is named by a domain, its parts reversed.", _extra,
        (lambda path, _: not path.endswith("/"),
         "{subject}: expected it in a directory such as extra/com.example"),
        (lambda path, _: not _REVERSE_DOMAIN.fullmatch(path),
         "{subject}: expected a reversed domain such as com.example"),
        clause=_EXTRA),
))  # fmt: skip
add_rows(__name__, CLAUSE, Stage.DESCRIPTION, rows=(
    row("has-an-implementation", "There is a binary for some platform, or sources, of each interface.",
        _interfaces,
        (lambda interface, fmu: not _has_sources(fmu) and not interface.get("modelIdentifier"),
         "{subject.tag} has no modelIdentifier, which names its library, and there is no C file in sources: "
         "expected one"),
        (lambda interface, fmu: not _has_sources(fmu) and not _has_binary(interface, fmu),
         "{subject.tag}: no library {modelIdentifier} below binaries, no C file in sources: expected one")),
    row("tool-wrapper-is-a-binary", "With needsExecutionTool there is a binary, which talks to the tool.",
        _interfaces,
        (_is_without_tool,
         "{subject.tag} has needsExecutionTool: expected a library {modelIdentifier} that talks to it")),
    row("tool-is-documented",
        "With needsExecutionTool, documentation/externalDependencies.txt or .html exists.", _interfaces,
        (_is_without_documents,
         "{subject.tag} has needsExecutionTool: expected documentation/externalDependencies.txt or .html")),
    row("source-files-are-distributed",
        "SourceFiles, which is meaningful for sources alone, is left out where the FMU holds no sources.",
        _interfaces,
        (_listed_without_sources,
         "{subject.tag}: SourceFiles lists {value}: expected none, as there are no sources")),
    row("source-files-exist",
        "Every file that SourceFiles lists is below sources, its path relative and with forward slashes.",
        elements("*/SourceFiles/File"),
        (lambda file, _: "\\" in file.get("name", ""),
         "line {subject.sourceline}, SourceFiles lists {name}: expected forward slashes"),
        (lambda file, _: file.get("name", "").startswith("/"),
         "line {subject.sourceline}, SourceFiles lists {name}: expected a path below sources"),
        (_is_missing,
         "line {subject.sourceline}, SourceFiles lists {name}: expected sources/{name} in the archive"),
        clause="2.3 FMU Distribution, 3.3.1 and 4.3.1 (SourceFiles)"),
    row("sources-are-listed",
        "SourceFiles, or buildDescription.xml, lists the C files below sources that are to be compiled.",
        lambda fmu: [] if fmu.libraries() else _unlisted(fmu, _TO_COMPILE),
        (lambda files, _: ", ".join(files[:3]),
         "{value}: expected SourceFiles that lists what is to be compiled")),
    row("sources-beside-a-library-are-listed",
        "Beside a library, SourceFiles or buildDescription.xml lists the files in C below sources too; files "
        "of other languages may be there to be read.",
        lambda fmu: _unlisted(fmu, ".c") if fmu.libraries() else [],
        (lambda files, _: ", ".join(files[:3]),
         "{value}: expected SourceFiles that lists what is to be compiled")),
))  # fmt: skip


@rule(CLAUSE, Stage.DESCRIPTION)
def library_names(fmu: FmuFile) -> Iterator[str]:
    """A platform's folder holds a library that is called as a modelIdentifier, with its extension."""
    identifier = f"(?:{'|'.join(map(re.escape, _identifiers(fmu)))})"
    for folder in fmu.platforms():
        extension, top = _extension(folder), f"binaries/{folder}/"
        static = rf"{top}.+/(?:{identifier}\.(?:lib|a)|lib{identifier}\.a)"  # in a compiler's folder
        case = "(?i)" if extension == ".dll" else ""  # Windows does not tell upper from lower case
        library = re.compile(rf"{case}{top}{identifier}{re.escape(extension)}|{static}")
        if extension and not any(map(library.fullmatch, fmu.names)):
            expected = " or ".join(f"{name}{extension}" for name in _identifiers(fmu))
            yield f"{top}: expected {expected}, as the folder exists"


@rule(CLAUSE, Stage.DESCRIPTION)
def source_files_are_complete(fmu: FmuFile) -> Iterator[str]:
    """The files in SourceFiles call no function that other C files alone define, and define those of FMI."""
    for interface in _interfaces(fmu):
        compiled = _reached(fmu, _listed(interface))
        text = b"\n".join(compiled.values())
        known = {name for _, name in _DEFINED.findall(text)} | {*_MACRO.findall(text)}
        calls = b"\n".join(map(_unconditional, compiled.values()))
        missing = {b"fmi2Instantiate", *_CALLED.findall(calls)} - known
        others = {path: _sources(fmu)[path] for path in _sources(fmu).keys() - compiled} if compiled else {}
        for path in sorted(path for path in others if path.endswith(_TO_COMPILE)):
            if names := missing & {name for static, name in _DEFINED.findall(others[path]) if not static}:
                what = f"{interface.tag}: SourceFiles leaves out {path.removeprefix(_SOURCES)}"
                yield f"{what}, which alone defines {min(names).decode()}: expected all files to compile"


@rule(CLAUSE, Stage.DESCRIPTION)
def source_files_are_compiled(fmu: FmuFile) -> Iterator[str]:
    """SourceFiles lists no header, and no file that another one of them includes."""
    for interface in _interfaces(fmu):
        paths = {path: name for name in _listed(interface) if (path := _source_path(name)) in fmu.paths}
        included = {
            posixpath.normpath(posixpath.join(posixpath.dirname(path), name))
            for path in paths
            for name in _included(_QUOTED_INCLUDE, fmu.read(path))
        }
        for path, name in paths.items():
            if path.endswith((".h", ".hpp")) or path in included:
                what = f"{interface.tag}: SourceFiles lists {name}"
                yield f"{what}, which others include: expected files to compile"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def includes_have_quotes(fmu: FmuFile) -> Iterator[str]:
    """Sources include the header files that the FMU holds by quotes, not by angle brackets."""
    headers = {path.removeprefix(_SOURCES) for path in _sources(fmu)}
    for path, text in _sources(fmu).items():
        for name in _included(_INCLUDE, text):
            if name in headers:
                yield f'{path}: #include <{name}>: expected "{name}", as it is in the FMU'


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def included_files_exist(fmu: FmuFile) -> Iterator[str]:
    """Files that C files include by quotes, in no #if, are among the sources, but for those of FMI and C.
    Where SourceFiles lists files, those are judged that are compiled.
    """
    known = {posixpath.basename(path) for path in _files(fmu, _SOURCES)}
    listed = [name for interface in _interfaces(fmu) for name in _listed(interface)]
    sources = _reached(fmu, listed) if listed else _sources(fmu)
    for path in sorted(path for path in sources if path.endswith(_TO_COMPILE)):
        for included in _included(_QUOTED_INCLUDE, _unconditional(sources[path])):
            name = posixpath.basename(included)
            if name not in known and not _HEADERS_OF_OTHERS.fullmatch(name):
                yield f'{path}: #include "{included}": expected that file below sources'


@rule(_NAMING, Stage.DESCRIPTION, condition=unreadable)
def source_prefix(fmu: FmuFile) -> Iterator[str]:
    """Sources that define FMI2_FUNCTION_PREFIX as a word define it as modelIdentifier with an underscore, and
    before they include fmi2Functions.h.
    """
    identifiers = _identifiers(fmu)
    expected = {f"{identifier}_" for identifier in identifiers}
    for path, text in _sources(fmu).items() if expected else ():
        prefixes = {name.decode("ascii", "replace") for name in _PREFIX.findall(text)} - expected
        for prefix in sorted(name for name in prefixes if name.endswith("_") or name in identifiers):
            yield f"{path} defines the prefix {prefix}: expected {' or '.join(sorted(expected))}"
        lines = _unconditional(text)
        define, include = _PREFIX.search(lines), _FUNCTIONS.search(lines)
        if define and include and define.start() > include.start():
            yield f"{path} defines FMI2_FUNCTION_PREFIX: expected that before it includes fmi2Functions.h"


@rule(_NAMING, Stage.DESCRIPTION, condition=unreadable)
def source_prefix_is_defined(fmu: FmuFile) -> Iterator[str]:
    """Sources that include fmi2Functions.h define FMI2_FUNCTION_PREFIX directly before that, or say how their
    build does.
    """
    sources = _sources(fmu)
    own = {path: text for path, text in sources.items() if posixpath.basename(path) not in _HEADERS}
    including = sorted(path for path, text in own.items() if _FUNCTIONS.search(text))
    built = [fmu.read(path) for path in fmu.names if path.startswith(_SOURCES) and path not in sources]
    if including and not any(name in text for name in _NAMES_FUNCTIONS for text in [*own.values(), *built]):
        expected = "expected #define FMI2_FUNCTION_PREFIX before that"
        yield f"{including[0]} includes fmi2Functions.h: {expected}"
    for path in including:
        lines = _unconditional(own[path])
        define, include = _PREFIX.search(lines), _FUNCTIONS.search(lines)
        between = lines[define.end() : include.start()].split() if define and include else []
        if between:
            word = b" ".join(between)[:40].decode("utf-8", "replace")
            yield f"{path}: {word} follows FMI2_FUNCTION_PREFIX: expected fmi2Functions.h directly after it"


def _unconditional(text: bytes) -> bytes:
    """Returns the lines that every compiler reads: those in no #if but the guard of a header."""
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


def _fmi3_errors(root: Any, path: str, schema: str) -> Iterator[str]:
    """Yields errors by a schema of FMI 3.0; any version may be stated, as FMI 2.0 does not say which."""
    stated = root.attrib.pop("fmiVersion", None)
    root.set("fmiVersion", "3.0")
    for error in schema_errors(root, f"fmi3/{schema}"):
        yield f"{path}, line {error.line}: {error.message}"
    if stated is None:
        yield f"{path}, fmiVersion is missing: expected one"


@rule(CLAUSE, Stage.DESCRIPTION, condition=_unless_there(BUILD_DESCRIPTION))
def build_description(fmu: FmuFile) -> Iterator[str]:
    """buildDescription.xml is valid by FMI 3.0, of this model, and names files below sources."""
    root, path = fmu.parsed(BUILD_DESCRIPTION), BUILD_DESCRIPTION
    yield from _fmi3_errors(root, path, "fmi3BuildDescription.xsd")
    identifiers = _identifiers(fmu)
    for configuration in root.iterfind("BuildConfiguration"):
        identifier = configuration.get("modelIdentifier")
        if identifier not in identifiers:
            yield f"{path}: modelIdentifier {identifier!r}: expected {' or '.join(identifiers)}"
        for file in configuration.iterfind("SourceFileSet/SourceFile"):
            if _source_path(file.get("name", "")) not in fmu.paths:
                yield f"{path} lists {file.get('name')}: expected it below sources"


@rule(_TERMINALS, Stage.DESCRIPTION, condition=_unless_there(TERMINALS))
def terminals_and_icons(fmu: FmuFile) -> Iterator[str]:
    """terminalsAndIcons.xml is valid by FMI 3.0; terminals have unique names, and variables of the FMU."""
    root = fmu.parsed(TERMINALS)
    yield from _fmi3_errors(root, TERMINALS, "fmi3TerminalsAndIcons.xsd")
    variables = {v.name for v in fmu.variables} | {""}
    for element in root.iter("TerminalMemberVariable", "TerminalStreamMemberVariable"):
        for attribute in ("variableName", "inStreamVariableName", "outStreamVariableName"):
            if element.get(attribute, "") not in variables:
                yield f"{TERMINALS}: {attribute} {element.get(attribute)!r}: expected the name of a variable"
    repeats = [*repeated_children(root, ".//*", "Terminal")]
    for rule_of_names in ("plug", "bus"):  # by the other rules members do not match by their names
        parents = f".//Terminal[@matchingRule='{rule_of_names}']"
        repeats += repeated_children(root, parents, "TerminalMemberVariable", "memberName")
    message = f"{TERMINALS}: {{place}} has {{count}} elements with {{attribute}} {{name!r}}: expected one"
    yield from told(fmu, repeats, (anything, message))


@rule(_TERMINALS, Stage.DESCRIPTION, condition=_unless_there(TERMINALS))
def terminal_icons_exist(fmu: FmuFile) -> Iterator[str]:
    """Pictures of terminals are beside terminalsAndIcons.xml."""
    with suppress(BrokenMemberError):  # which another rule tells
        for element in fmu.parsed(TERMINALS).iter("TerminalGraphicalRepresentation"):
            path = f"terminalsAndIcons/{element.get('iconBaseName')}.png"
            if path not in fmu.paths:
                yield f"{TERMINALS} has iconBaseName {element.get('iconBaseName')!r}: expected {path}"
