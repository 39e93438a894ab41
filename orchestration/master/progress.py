"""How a run tells its caller where it is."""

from typing import Protocol


class Progress(Protocol):
    """Called some ten times a second with the communication points done, and all of the run."""

    def __call__(self, done: int, total: int, /) -> object: ...
