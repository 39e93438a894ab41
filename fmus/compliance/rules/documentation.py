"""Rules of documentation, extra, icons and terminals in the archive: FMI 2.0.5, 2.3 FMU Distribution."""

import re
from collections.abc import Iterator

from fmus.compliance.contents import TERMINALS, fmi3_schema_errors, parsed_member, unless_there
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Stage, repeated, rule
from fmus.compliance.rules.archive import CLAUSE, unreadable

_EXTRA = "2.3.1 Extra Directory"
_TERMINALS = "2.3.2 Terminals and Icons"
_LICENSES = "documentation/licenses/"
_RESERVED = ("org.modelica", "org.fmi-standard")
_LAYERED_STANDARD = re.compile(r"org\.(?:modelica|fmi-standard)\.fmi-ls-[a-z0-9-]+")
_REVERSE_DOMAIN = re.compile(r"[A-Za-z][A-Za-z0-9-]*(?:\.[A-Za-z0-9_-]+)+")
_PNG = b"\x89PNG\r\n\x1a\n"


def _files(fmu: FmuFile, folder: str) -> list[str]:
    return [path for path in fmu.names if path.startswith(folder) and not path.endswith("/")]


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def documentation_has_an_entry(fmu: FmuFile) -> Iterator[str]:
    """Documentation is entered by documentation/index.html."""
    files = [
        path
        for path in _files(fmu, "documentation/")
        if not path.startswith((_LICENSES, "documentation/externalDependencies."))
    ]
    if files and "documentation/index.html" not in fmu.paths:
        yield f"{', '.join(files[:3])}: expected documentation/index.html, where a reader begins"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def licenses_have_an_entry(fmu: FmuFile) -> Iterator[str]:
    """Licences are entered by documentation/licenses/license.txt or license.html."""
    entries = {f"{_LICENSES}license.{extension}" for extension in ("txt", "html")}
    if _files(fmu, _LICENSES) and not entries & fmu.paths:
        yield f"{_LICENSES}: expected license.txt or license.html, where a reader begins"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def icon_is_png(fmu: FmuFile) -> Iterator[str]:
    """model.png is a picture in the format PNG."""
    if "model.png" in fmu.paths and not fmu.read("model.png").startswith(_PNG):
        yield "model.png: expected a picture in the format PNG"


def _extra_folders(fmu: FmuFile) -> list[str]:
    """Names directly below extra."""
    return sorted(
        {path.split("/")[1] for path in fmu.names if path.startswith("extra/") and path != "extra/"}
    )


@rule(_EXTRA, Stage.FILE, condition=unreadable)
def extra_names_are_not_reserved(fmu: FmuFile) -> Iterator[str]:
    """Names below extra that begin with org.modelica or org.fmi-standard are of layered standards of FMI."""
    for name in _extra_folders(fmu):
        if name.startswith(_RESERVED) and not _LAYERED_STANDARD.fullmatch(name):
            yield f"extra/{name}: expected a name of the maker's own, as this is for layered standards of FMI"


@rule(_EXTRA, Stage.FILE, condition=unreadable)
def extra_names_are_domains(fmu: FmuFile) -> Iterator[str]:
    """Files below extra are in a directory that is named by a domain, its parts reversed."""
    for name in _extra_folders(fmu):
        if f"extra/{name}" in fmu.paths:
            yield f"extra/{name}: expected it in a directory such as extra/com.example"
        elif not _REVERSE_DOMAIN.fullmatch(name):
            yield f"extra/{name}/: expected a reversed domain such as com.example"


@rule(_TERMINALS, Stage.DESCRIPTION, condition=unless_there(TERMINALS))
def terminals_and_icons(fmu: FmuFile) -> Iterator[str]:
    """terminalsAndIcons.xml is valid by FMI 3.0; terminals have unique names, and variables of the FMU."""
    root, problem = parsed_member(fmu, TERMINALS)
    if problem:
        yield f"{TERMINALS}: {problem}"
        return
    yield from (f"{TERMINALS}, {e}" for e in fmi3_schema_errors(root, "fmi3TerminalsAndIcons.xsd"))
    variables = {v.name for v in fmu.variables}
    for element in root.iter("TerminalMemberVariable", "TerminalStreamMemberVariable"):
        for attribute in ("variableName", "inStreamVariableName", "outStreamVariableName"):
            if element.get(attribute, "") not in variables | {""}:
                yield f"{TERMINALS}: {attribute} {element.get(attribute)!r}: expected the name of a variable"
    for parent in root.iter("Terminals", "Terminal"):
        for name, count in repeated(terminal.get("name") for terminal in parent.iterfind("Terminal")).items():
            yield f"{TERMINALS}: {count} terminals are called {name!r}: expected one"
        for name, count in repeated(
            member.get("memberName") for member in parent.iterfind("TerminalMemberVariable")
        ).items():
            if name is not None and parent.get("matchingRule") in ("plug", "bus"):
                yield f"{TERMINALS}: {parent.get('name')!r} has {count} members {name!r}: expected one"


@rule(_TERMINALS, Stage.DESCRIPTION, condition=unless_there(TERMINALS))
def terminal_icons_exist(fmu: FmuFile) -> Iterator[str]:
    """Pictures of terminals are beside terminalsAndIcons.xml."""
    root, _ = parsed_member(fmu, TERMINALS)
    for element in root.iter("TerminalGraphicalRepresentation") if root is not None else ():
        path = f"terminalsAndIcons/{element.get('iconBaseName')}.png"
        if path not in fmu.paths:
            yield f"{TERMINALS} has iconBaseName {element.get('iconBaseName')!r}: expected {path}"
