"""The types of variables in FMI 2.0, and the functions that transfer their values."""

FmiValue = float | int | bool | str

# type of a variable -> the type in the names of the functions that get and set it (FMI 2.0.5, 2.1.7)
TRANSFER_TYPE = {
    "Real": "Real",
    "Integer": "Integer",
    "Boolean": "Boolean",
    "String": "String",
    "Enumeration": "Integer",
}
# of fmi2Integer
INTEGER_RANGE = (-(2**31), 2**31 - 1)
TYPES = tuple(TRANSFER_TYPE)
NUMBERS = tuple(name for name in TYPES if name != "String")


def types_of_transfer(transfer_type: str) -> tuple[str, ...]:
    """Returns the types of the variables that the functions of this type get and set."""
    return tuple(name for name, transferred in TRANSFER_TYPE.items() if transferred == transfer_type)
