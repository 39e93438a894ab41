"""Metrics of margins, with what they assume and where they are from."""

import math
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Metric:
    """A metric of a margin.

    value: not a number if it does not exist, infinite if nothing is lost; unit: "" where it has none
    assumption: what it holds under; remark: what belongs to this metric alone
    """

    group: str
    name: str
    value: float
    unit: str
    assumption: str
    source: str
    remark: str = ""

    @property
    def shown(self) -> str:
        """The value in a table."""
        if math.isnan(self.value):
            return "none"
        return "not lost" if math.isinf(self.value) else f"{self.value:.4g}"

    def document(self) -> dict[str, Any]:
        """Returns the metric for JSON, which has neither infinity nor what is not a number: both are null."""
        return {
            **asdict(self),
            "value": self.value if math.isfinite(self.value) else None,
            "shown": self.shown,
        }
