"""Extension of griffe for the API pages: arguments that a docstring explains are the items of a list.

    signals: "component.variable" -> function of time    one argument, or more: "parameters, inputs: ..."
    step(t, h, state) -> State                           a function that a class expects

Markdown runs lines that follow one another together.
"""

import re

from griffe import Extension, Object

_ARGUMENTS = re.compile(r"^([a-z_]\w*(?:, [a-z_]\w*)*): ")
_FUNCTION = re.compile(r"^([a-z_]\w*\(.*?\)) -> ")


class Lists(Extension):
    """Extension that changes the docstrings of classes and functions."""

    def on_object(self, *, obj: Object, **_: object) -> None:
        """Changes the docstring of an object."""
        if obj.docstring and not obj.is_module:
            # the value alone: a new docstring would lose the style by which it is parsed
            obj.docstring.value = with_lists(obj.docstring.value)


def with_lists(text: str) -> str:
    """Returns a docstring in which each argument is an item, which a blank line or a capital letter ends."""
    lines, in_list = list[str](), False
    for line in text.splitlines():
        item = _FUNCTION.sub(r"- `\1` -> ", _ARGUMENTS.sub(r"- `\1`: ", line))
        is_item = item != line
        if is_item > in_list or (in_list and not is_item and line[:1].isupper()):
            lines.append("")
        in_list = is_item or (in_list and bool(line) and not line[:1].isupper())
        lines.append(item)
    return "\n".join(lines)
