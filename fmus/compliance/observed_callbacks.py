"""Callbacks of an instance under examination: what the FMU logs, and memory that is used up."""

from typing import Any

from fmus.compliance.process_settings import ProcessSettings
from fmus.fmi.callbacks import AllocateMemory, CountingAllocator, FreeMemory, Log, Logger

_MOST_MESSAGES = 1000


class MessageLog(Log):
    """Messages with the instance and the category that the FMU gave, and the floating-point settings."""

    def __init__(self, settings: ProcessSettings, known_environment: bool = True) -> None:
        super().__init__()
        self._known_environment = known_environment
        self.messages: list[list[Any]] = []
        self.changed_in_callback = False
        self._settings = settings

    def add(
        self, status: int, message: str, instance: str | None = None, category: str | None = None
    ) -> None:
        if self._settings.floating_point_differs():
            self.changed_in_callback = True
        if len(self.messages) < _MOST_MESSAGES:
            self.messages.append([status, message, instance, category, self._known_environment])


class RefusingAllocator(CountingAllocator):
    """Memory that is used up."""

    def _allocate(self, count: int, size: int) -> None:  # type: ignore[override]
        return None


def logger_of_formats(messages: MessageLog) -> Any:
    """Returns a logger that keeps the format of each message, as arguments do not reach Python."""

    def log(_: int | None, name: bytes, status: int, category: bytes, message: bytes) -> None:
        texts = [None if text is None else text.decode("utf-8", "replace") for text in (name, category)]
        messages.add(status, (message or b"").decode("utf-8", "replace"), *texts)

    return Logger(log)


def set_traps(structure: Any, usual: Any, traps: list[str]) -> list[Any]:
    """Replaces the callbacks of a structure, which the FMU may not look at any more, and returns them.

    usual: a structure with the callbacks that they call; traps: gets the name of each that the FMU calls
    """

    def log(*_: Any) -> None:
        traps.append("logger")

    def allocate(count: int, size: int) -> Any:
        traps.append("allocateMemory")
        return usual.allocateMemory(count, size)

    def free(address: Any) -> None:
        traps.append("freeMemory")
        usual.freeMemory(address)

    structure.logger = Logger(log)
    structure.allocateMemory = AllocateMemory(allocate)
    structure.freeMemory = FreeMemory(free)
    return [structure.logger, structure.allocateMemory, structure.freeMemory]
