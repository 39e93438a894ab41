"""The versions of SSP that are written, for the command line too, which loads no more than it needs."""

from enum import StrEnum


class SspVersion(StrEnum):
    """Of the standard that a package follows."""

    V1 = "1.0"
    V2 = "2.0"
