"""Libraries that only some features need: one line for whoever has not installed them."""

from importlib import import_module
from types import ModuleType

from fmus.errors import MissingExtraError


def require(module: str, extra: str, purpose: str) -> ModuleType:
    """The imported module.

    purpose: subject of the message, such as "a sweep"
    Raises MissingExtraError, which names the command that installs it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        missing = (error.name or module).partition(".")[0]
        raise MissingExtraError(f"{purpose} needs {missing}: pip install 'l1-depth[{extra}]'") from None
