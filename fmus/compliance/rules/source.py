"""Rules of what C sources in the archive hold: FMI 2.0.5, 2.1.1 and 2.3."""

import posixpath
import re
from collections.abc import Iterator
from functools import lru_cache
from itertools import zip_longest

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Stage, rule
from fmus.compliance.rules.archive import CLAUSE, unreadable
from fmus.compliance.rules.implementation import HEADERS, QUOTED_INCLUDE, SOURCES, TO_COMPILE

_NAMING = "2.1.1 Header Files and Naming of Functions"
_COMMENT = re.compile(rb"/\*.*?\*/|//[^\n]*", re.DOTALL)
_PREFIX = re.compile(rb"^[ \t]*#[ \t]*define[ \t]+FMI2_FUNCTION_PREFIX[ \t]+(\w+)[ \t\r]*$", re.MULTILINE)
_FUNCTIONS = re.compile(rb'^[ \t]*#[ \t]*include[ \t]*["<]fmi2Functions\.h[">]', re.MULTILINE)
_NAMES_FUNCTIONS = (b"FMI2_FUNCTION_PREFIX", b"FMI2_OVERRIDE_FUNCTION_PREFIX")
_OF_THE_LANGUAGE = re.compile(
    r"(?:assert|complex|ctype|errno|fenv|float|inttypes|iso646|limits|locale|math|setjmp|signal|stdalign"
    r"|stdarg|stdatomic|stdbool|stddef|stdint|stdio|stdlib|stdnoreturn|string|tgmath|threads|time|uchar"
    r"|wchar|wctype)\.h"
)


@lru_cache(maxsize=1)
def _sources(fmu: FmuFile) -> dict[str, bytes]:
    """Returns the path of each C file and header below sources -> its text without comments."""
    paths = [path for path in fmu.names if path.startswith(SOURCES) and path.endswith((*TO_COMPILE, ".h"))]
    return {path: _COMMENT.sub(b"", fmu.read(path)) for path in paths}


@rule(_NAMING, Stage.DESCRIPTION, condition=unreadable)
def source_prefix(fmu: FmuFile) -> Iterator[str]:
    """Sources that define FMI2_FUNCTION_PREFIX as a word define it as modelIdentifier with an underscore, and
    before they include fmi2Functions.h.
    """
    identifiers = {attributes.get("modelIdentifier", "") for attributes in fmu.interfaces.values()}
    expected = {f"{identifier}_" for identifier in identifiers}
    for path, text in _sources(fmu).items() if expected else ():
        prefixes = {name.decode("ascii", "replace") for name in _PREFIX.findall(text)}
        for prefix in sorted(
            name for name in prefixes - expected if name.endswith("_") or name in identifiers
        ):
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
    own = {path: text for path, text in sources.items() if posixpath.basename(path) not in HEADERS}
    including = [path for path, text in own.items() if _FUNCTIONS.search(text)]
    built = [fmu.read(path) for path in fmu.names if path.startswith(SOURCES) and path not in sources]
    if including and not any(name in text for name in _NAMES_FUNCTIONS for text in [*own.values(), *built]):
        expected = "expected #define FMI2_FUNCTION_PREFIX before that"
        yield f"{min(including)} includes fmi2Functions.h: {expected}"
    for path in sorted(including):
        lines = _unconditional(own[path])
        define, include = _PREFIX.search(lines), _FUNCTIONS.search(lines)
        between = lines[define.end() : include.start()].split() if define and include else []
        if between:
            word = b" ".join(between)[:40].decode("utf-8", "replace")
            yield f"{path}: {word} follows FMI2_FUNCTION_PREFIX: expected fmi2Functions.h directly after it"


def _unconditional(text: bytes) -> bytes:
    """Returns the lines that every compiler reads: those in no #if but the guard of a header."""
    lines, conditions = [], []
    written = [line for line in text.splitlines() if line.strip()]
    for line, after in zip_longest(written, written[1:], fillvalue=b""):
        words = line.replace(b"#", b"# ", 1).split()
        directive = words[1] if len(words) > 1 and words[0] == b"#" else b""
        if directive.startswith(b"if"):
            following = after.split()
            conditions.append(following[:1] != [b"#define"] or following[1:2] != words[2:3])
        elif directive.startswith(b"el") and conditions:
            conditions[-1] = True
        elif directive == b"endif" and conditions:
            conditions.pop()
        elif not any(conditions):
            lines.append(line)
    return b"\n".join(lines)


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def included_files_exist(fmu: FmuFile) -> Iterator[str]:
    """Files that C files include by quotes, in no #if, are among the sources, but for those of FMI and C."""
    sources = {path: text for path, text in _sources(fmu).items() if path.endswith(TO_COMPILE)}
    names = {posixpath.basename(path) for path in fmu.names if path.startswith(SOURCES)}
    for path, text in sources.items():
        names_included = QUOTED_INCLUDE.findall(_unconditional(text))
        for included in dict.fromkeys(name.decode("utf-8", "replace") for name in names_included):
            name = posixpath.basename(included)
            if name not in {*names, *HEADERS} and not _OF_THE_LANGUAGE.fullmatch(name):
                yield f'{path}: #include "{included}": expected that file below sources'
