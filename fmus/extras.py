"""Libraries that only some features need: an error of one line where they are not installed."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType

from fmus.errors import MissingExtraError


@contextmanager
def imports_of(extra: str, purpose: str) -> Iterator[None]:
    """Guards imports: MissingExtraError names the command that installs a missing library.

    purpose: subject of the message, such as "a sweep"
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or "a library").partition(".")[0]
        raise MissingExtraError(f"{purpose} needs {missing}: pip install 'l1-depth[{extra}]'") from None


def require(module: str, extra: str, purpose: str) -> ModuleType:
    """Returns the imported module; raises MissingExtraError as `imports_of` does."""
    with imports_of(extra, purpose):
        return import_module(module)
