"""The treatment of inputs that nothing drives. Apart from `System`: options name it, which load no FMU."""

from enum import StrEnum


class OpenInputs(StrEnum):
    """A treatment of open inputs. error: refuse them; start: keep the start values of their FMUs."""

    ERROR = "error"
    START = "start"
