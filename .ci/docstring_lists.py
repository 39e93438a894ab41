"""Extension of griffe for the API pages, for what its reading of source and NumPy's sections leaves out.

    step(t, h, state) -> State    functions that a class expects are the items of a list
    sqrt = _of_one(...)           a function that another one makes has its signature and docstring

Markdown runs lines that follow one another together.
"""

import re
from typing import Any

from griffe import Extension, Module, Object, inspect

_FUNCTION = re.compile(r"^([a-z_]\w*\(.*?\)) -> ")


class Lists(Extension):
    """Extension that changes the docstrings of classes and functions."""

    def on_object(self, *, obj: Object, **_: object) -> None:
        """Changes the docstring of an object."""
        if obj.docstring and not obj.is_module:
            # the value alone: a new docstring would lose the style by which it is parsed
            obj.docstring.value = with_lists(obj.docstring.value)

    def on_module_members(self, *, mod: Module, agent: Any, **_: object) -> None:
        """Puts functions in the place of attributes that another function made."""
        made = [name for name, one in mod.attributes.items() if str(one.value).startswith("_of_")]
        style = agent.docstring_parser
        loaded: Any = made and inspect(
            mod.name, filepath=mod.filepath, parent=mod.parent, docstring_parser=style
        )
        for name in made:
            mod.set_member(name, loaded[name])


def with_lists(text: str) -> str:
    """Returns a docstring in which each function is an item, which a blank line or a capital letter ends."""
    lines, in_list = list[str](), False
    for line in text.splitlines():
        item = _FUNCTION.sub(r"- `\1` -> ", line)
        is_item = item != line
        if is_item > in_list or (in_list and not is_item and line[:1].isupper()):
            lines.append("")
        in_list = is_item or (in_list and bool(line) and not line[:1].isupper())
        lines.append(item)
    return "\n".join(lines)
