"""The files of a new block, to start from: a PID controller of depth, and its test."""

import keyword
import re
from importlib import resources
from pathlib import Path
from string import Template

from fmus.block.block_file import is_free_module_name
from fmus.errors import ExportError
from fmus.files import write_text_atomically

_TEMPLATES = {"{}.py": "block.py.in", "test_{}.py": "test.py.in"}


def write_new_block(name: str, folder: Path) -> list[Path]:
    """Writes `folder/NAME.py` and `folder/test_NAME.py`; raises ExportError if one of them is there already.

    name: of the module, such as depth_pid; its block is called DepthPid
    """
    values = {"module": name, "name": "".join(map(str.capitalize, name.split("_")))}
    is_taken = not is_free_module_name(name) or keyword.iskeyword(values["name"])
    if is_taken or not re.fullmatch(r"[a-z](_?[a-z0-9])*", name):
        raise ExportError(
            f"{name!r}: expected lower-case letters, digits and single underscores, and no name of Python's, "
            "of an installed package or of a device of Windows"
        )
    templates = resources.files("fmus.build") / "templates"
    texts = {
        folder / file.format(name): Template((templates / template).read_text("utf-8")).substitute(values)
        for file, template in _TEMPLATES.items()
    }
    if present := next((path for path in texts if path.exists()), None):
        raise ExportError(f"{present}: is there already; expected another name than {name!r}")
    for path, text in texts.items():
        write_text_atomically(path, text)
    return list(texts)
