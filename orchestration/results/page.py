"""An interactive page from a template, a style and scripts; it needs no network.

Jinja2 escapes text from files, data is JSON without markup, and the content security policy allows the
scripts whose hashes it lists, and no download.
"""

import base64
import hashlib
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from fmus.extras import imports_of

with imports_of("report", "a report"):
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

_SHARED = Path(__file__).with_name("page_files")


def page(
    template: Path,
    scripts: Sequence[str],
    filters: Mapping[str, Callable[..., Any]] = {},
    **content: Any,
) -> str:
    """Returns a self-contained HTML page.

    template: extends `base.html` of `page_files/`
    scripts: files beside the template or in `page_files/`, run after uplot.js and common.js
    filters: of the template, in addition to number and breakable
    content: variables of the template, with `title`, and `data` for the scripts
    """
    own = template.parent
    environment = Environment(
        loader=FileSystemLoader([own, _SHARED]), autoescape=True, undefined=StrictUndefined
    )
    environment.filters |= {"number": _number, "breakable": _breakable, **filters}
    folders = [own if (own / name).is_file() else _SHARED for name in scripts]
    files = [_SHARED / "uplot.js", _SHARED / "common.js", *map(Path, folders, scripts)]
    texts = [_text(file) for file in files]
    made_by = _text(_SHARED / "uplot.LICENSE").partition(" (")[0]
    return environment.get_template(template.name).render(
        **content,
        style=Markup(_text(_SHARED / "page.css") + _text(_SHARED / "uplot.css")),
        scripts=[Markup(text) for text in texts],
        hashes=" ".join(f"'sha256-{_sha256(text)}'" for text in texts),
        made_by=f"l1-depth {metadata.version('l1-depth')}, {made_by}",
    )


def packed(values: np.ndarray) -> str:
    """Returns doubles as base64 of zlib of their bytes: all first bytes, all second ones and so on."""
    # Neighbours in time share sign and exponent, and equal bytes side by side compress well.
    bytes_of_values = np.ascontiguousarray(values, dtype="<f8").view(np.uint8).reshape(-1, 8)
    return base64.b64encode(zlib.compress(bytes_of_values.T.tobytes())).decode("ascii")


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8")


def _sha256(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")


def _number(value: Any) -> str:
    """Returns five digits of a float, and other values as text."""
    return f"{value:.5g}" if isinstance(value, (float, np.floating)) else str(value)


def _breakable(name: str) -> Markup:
    """Returns a name that may break after a dot, an underscore or a comma before three letters."""
    return Markup("<wbr>").join(re.split(r"(?<=[._,])(?=\w{3})", name))
