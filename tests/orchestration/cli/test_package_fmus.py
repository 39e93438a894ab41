"""A block with other start values is the same block, but for what it starts with."""

import pytest

from fmus.block.instance import BlockInstance
from fmus.errors import ExportError
from fmus.generate import builder
from orchestration.cli.package_fmus import with_start_values

STARTS = {"augmentation": 2, "proportional_gain": 5.5, "measured_depth": 0.25}


def test_it_starts_with_the_values_and_differs_in_nothing_else() -> None:
    block = builder.load_block("L1DepthController")
    started = with_start_values(block, STARTS)
    assert {v.name: v.start for v in started.variables} == {v.name: v.start for v in block.variables} | STARTS
    assert [type(v.start) for v in started.variables] == [type(v.start) for v in block.variables]


def test_elements_of_a_matrix_are_set_by_their_names() -> None:
    block = builder.load_block("ExamplePlant")
    first, second = block.parameters.state_matrix
    started = with_start_values(block, {"state_matrix[2,1]": -7.0})
    assert started.parameters.state_matrix == (first, (-7.0, second[1]))


def test_it_steps_as_the_block_does_with_these_values_set() -> None:
    block = builder.load_block("ExamplePlant")
    values = {"omega": 2.0, "control": 1.5, "initial_state[1]": 0.5}
    started, plain = BlockInstance(with_start_values(block, values)), BlockInstance(block)
    references = {v.name: v.value_reference for v in block.variables}
    for name, value in values.items():
        plain.set(references[name], value)
    for instance in (started, plain):
        instance.exit_initialization_mode()
        instance.do_step(0.0, 0.1)
    outputs = [v.value_reference for v in block.of_causality("output")]
    assert [started.get(r) for r in outputs] == [plain.get(r) for r in outputs]
    assert started.get(references["output"]) != 0.0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"omegga": 1.0}, r"'ExamplePlant': no parameter or input 'omegga'; nearest is 'omega'"),
        ({"output": 1.0}, r"no parameter or input 'output'"),
        ({"internal_step": 1e9}, r"start value internal_step = 1000000000\.0: expected "),
    ],
)
def test_what_is_no_start_value_is_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(ExportError, match=message):
        with_start_values(builder.load_block("ExamplePlant"), values)
