"""SOFiRpy's `simulate`, one row recorded at the end."""

from typing import Any

from sofirpy import simulate

from tests.speed.pair import LEVEL, SIGNAL, STEP_SIZE, Pair


def run(pair: Pair, steps: int) -> float:
    def link(source: str) -> list[dict[str, str]]:
        return [
            {"parameter_name": SIGNAL, "connect_to_system": source, "connect_to_external_parameter": LEVEL}
        ]

    stop_time = steps * STEP_SIZE
    links: Any = {"first": link("second"), "second": link("first")}
    result = simulate(
        stop_time,
        STEP_SIZE,
        fmu_paths=pair.fmus,
        connections_config=links,
        parameters_to_log={"first": [LEVEL]},
        logging_step_size=stop_time,
    )
    return float(result[f"first.{LEVEL}"].iloc[-1])
