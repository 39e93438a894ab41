"""Which blocks there are, and where their FMUs stand.

Blocks are entry points of the group `l1_depth.blocks`, so another package's blocks build the same
way: `MyBlock = "my_package.my_module:BLOCK"`.
"""

import zipfile
import zlib
from importlib.metadata import entry_points
from pathlib import Path
from xml.etree import ElementTree

from fmus import python_flavour
from fmus.archive import write_archive
from fmus.block import Block
from fmus.errors import ExportError, nearest
from fmus.instance import Instance

GROUP = "l1_depth.blocks"
DIST = Path(__file__).parent / "dist"


def block_names() -> list[str]:
    """Names of all blocks, sorted."""
    return sorted(point.name for point in entry_points(group=GROUP))


def load_block(name: str) -> Block:
    """The block of that name; ExportError offers the nearest one."""
    for point in entry_points(group=GROUP):
        if point.name == name:
            return _verified(name, point.load())
    raise ExportError(f"no block named {name!r}; {nearest(name, block_names())}")


def _verified(name: str, block: Block) -> Block:
    """The block, if it bears the name it goes by and takes a step at its start values."""
    if block.name != name:
        raise ExportError(f"entry point {name!r} loads a block named {block.name!r}: expected one name")
    if "internal_step" not in {v.name for v in block.of_causality("parameter")}:
        raise ExportError(f"block {name!r}: expected a parameter internal_step, its longest step in s")
    trial = Instance(block)
    try:
        trial.begin_stepping()
        trial.do_step(0.0, block.step_size)
        trial.get(len(block.variables) - 1)
    except Exception as error:
        raise ExportError(f"block {name!r} cannot take a step at its start values: {error!r}") from error
    return block


def build(name: str, folder: Path = DIST) -> Path:
    """Write `folder/NAME.fmu`, whatever stands there."""
    return python_flavour.build(load_block(name), folder / f"{name}.fmu")


def build_if_stale(name: str, folder: Path = DIST) -> Path:
    """`folder/NAME.fmu`, built if it is missing or its GUID is not that of the present sources."""
    path = folder / f"{name}.fmu"
    guid, members = python_flavour.content(load_block(name))
    if _guid_of(path) != guid:
        write_archive(path, members)
    return path


def _guid_of(path: Path) -> str | None:
    try:
        with zipfile.ZipFile(path) as archive:
            if archive.testzip():
                return None
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    except (OSError, zipfile.BadZipFile, zlib.error, KeyError, ElementTree.ParseError):
        return None
    return root.get("guid")
