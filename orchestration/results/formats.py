"""The kinds of files that results are written to, by their ending."""

from enum import StrEnum


class RecordingFormat(StrEnum):
    """The format of a recording."""

    CSV = "csv"
    PARQUET = "parquet"


class FigureFormat(StrEnum):
    """The format of a figure: pixels, or lines for print."""

    PNG = "png"
    PDF = "pdf"
    SVG = "svg"
