"""What becomes of inputs that nothing drives."""

from enum import StrEnum


class OpenInputs(StrEnum):
    """error: they are refused; start: they keep the start values of their FMUs."""

    ERROR = "error"
    START = "start"
