"""Scenarios as TOML for readers."""

import re
from collections.abc import Mapping
from typing import Any

import tomli_w

_ITEM = r'(?:"(?:[^"\\\n]|\\.)*"|[^\[\]",\s]+)'  # a text, or a number
_SHORT_LIST = re.compile(rf"\[\n((?: +{_ITEM},\n){{1,4}}) *\]")


def toml(content: Mapping[str, Any]) -> str:
    """What tomli_w writes, with lists of up to four items on one line."""
    return _SHORT_LIST.sub(_on_one_line, tomli_w.dumps(content))


def _on_one_line(match: re.Match[str]) -> str:
    items = [line.strip(" ").removesuffix(",") for line in match[1].removesuffix("\n").split("\n")]
    return f"[{', '.join(items)}]"
