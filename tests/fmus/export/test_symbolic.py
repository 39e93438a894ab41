"""Which initial values follow from which parameters and inputs: the sparsity of the traced initialisation."""

from fmus import catalogue
from fmus.export.symbolic import initial_dependencies


def test_the_plant_starts_independently_of_its_voltages() -> None:
    """Otherwise controller and plant would form a loop in initialisation mode."""
    plant = catalogue.load_block("RovDepthPlant")
    voltages = {v.value_reference for v in plant.variables if v.name.startswith("voltage")}
    for known in initial_dependencies(plant).values():
        assert not voltages & set(known)


def test_initial_outputs_of_the_controller_follow_its_measurement() -> None:
    controller = catalogue.load_block("L1DepthController")
    reference = {v.name: v.value_reference for v in controller.variables}
    dependencies = initial_dependencies(controller)
    assert reference["measured_depth"] in dependencies[reference["tracking_error"]]
    assert dependencies[reference["omega_hat"]] == (reference["input_gain"],)
