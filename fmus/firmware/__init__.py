"""Blocks for a microcontroller: a header, one C file and a static library, with the numbers of the FMU."""
