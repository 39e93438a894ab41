"""Callbacks of an instance under examination: what the FMU logs, and memory that is used up."""

from typing import Any

from fmus.callbacks import CountingAllocator, Log
from fmus.compliance.process_settings import ProcessSettings

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
