"""The published figures that reproductions are compared with, and how scenarios map onto them.

Source: Maalouf, Chemori and Creuze (NOLCOS 2013): Tables 1 and 2, sections 5.2 and 5.3. The example has
no published figures: its oracles were computed independently (docs/fidelity.md).
"""

from dataclasses import dataclass

CONTROLLERS = {"l1": "L1", "extended": "extended L1"}
"""Name of a controller in the scenarios' names -> its name for readers."""
CASES = ("nominal", "buoyancy", "example")
"""The paper's experiments: the names of their scenarios begin with these."""


@dataclass(frozen=True)
class Published:
    """One figure: where it stands, which scenario and metric reproduce it, its value."""

    where: str
    case: str
    controller: str
    metric: str
    label: str
    unit: str
    value: float
    status: str  # how ours came about: fitted, predicted, or computed from published numbers alone

    @property
    def scenario(self) -> str:
        return f"{self.case}-{self.controller}"


def _row(
    where: str, case: str, metric: str, label: str, unit: str, l1: float, extended: float, status: str
) -> list[Published]:
    return [
        Published(where, case, "l1", metric, label, unit, l1, status),
        Published(where, case, "extended", metric, label, unit, extended, status),
    ]


PUBLISHED = (
    *_row("Table 1", "nominal", "settling_time", "Settling time", "s", 65.0, 45.0, "fitted"),
    *_row("Table 1", "nominal", "rmse", "RMSE", "cm", 12.1, 4.35, "fitted"),
    *_row("Table 2", "buoyancy", "settling_time", "Settling time", "s", 68.0, 45.0, "predicted"),
    *_row("Table 2", "buoyancy", "rmse", "RMSE", "cm", 13.8, 4.86, "predicted"),
    *_row("Section 5.2", "nominal", "holding_thrust", "Holding thrust", "N", 1.2, 1.2, "W - B, drag"),
    Published(
        "Section 5.3", "buoyancy", "extended", "holding_thrust", "Holding thrust", "N", 1.4, "W - B, drag"
    ),
    *_row("Oracle, x(0) = 0", "example", "lag", "Lag", "s", 1.403, 0.048, "computed"),
    *_row("Oracle, x(0) = 0", "example", "rmse", "RMSE", "1", 19.80, 0.798, "computed"),
)
"""Published figures and, for the example, the independent oracles."""
