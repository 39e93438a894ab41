"""A value as a command line has it: a text, which the variable makes a number, true, false or a String."""

import tomllib

from fmus.fmi.variable_types import FmiValue


class AssignedText(str):
    """The assigned text of `--set component.variable=1.50`, behind the =: TOML, or a text without quotes."""

    __slots__ = ()

    def value(self, fmi_type: str) -> FmiValue:
        """Returns the value for a variable of this type: of a String 1.50 stays 1.50."""
        text = str(self)
        try:
            value = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            return text
        is_taken = isinstance(value, str) or (isinstance(value, bool | int | float) and fmi_type != "String")
        return value if is_taken else text
