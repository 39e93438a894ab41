"""Page reference/vehicles.md, the vehicles with equations and parameters, from the code."""

from controllers_page import lines, section

from plant_fmu import blue_rov2_plant, depth_plant, example_plant, heave_pitch_plant, wave_source

_HEAD = """\
# Vehicles

The blocks of the [vehicle interface](vehicle-interface.md), of waves and of the paper's example, with the
source of each number.
[Disturbances](../explanation/disturbances.md) has results with them."""


def page() -> str:
    """The whole page. A vehicle that pitches has what it does not share with `RovDepthPlant`."""
    depth, pitch, blue = depth_plant.BLOCK, heave_pitch_plant.BLOCK, blue_rov2_plant.BLOCK
    names = {v.name for v in depth.of_causality("parameter")}
    same = {v.name for v in pitch.of_causality("parameter") if v in set(blue.of_causality("parameter"))}
    sections = (
        section(depth, set(), set()),
        section(pitch, names, {*lines(depth), ""}),
        section(blue, same, {*lines(pitch), ""}),
        section(wave_source.BLOCK, set(), set()),
        section(example_plant.BLOCK, set(), set()),
    )
    return "\n\n".join((_HEAD, *sections)) + "\n"
