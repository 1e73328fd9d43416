"""What frames and commands look like, as a settings file describes them.

A table of the file goes through `description` (every entry by name), `fields`, `checksums` and `messages`; `parse`
makes a `FrameFormat` of it.
"""

from instrument.fibre_gyro.frame_format.fields import COUNTER, COUNTS, FRAME_UNITS, STATUS, TEMPERATURE, is_output
from instrument.fibre_gyro.frame_format.layout import FrameFormat
from instrument.fibre_gyro.frame_format.parse import parse_frame_format

__all__ = [
    "COUNTER",
    "COUNTS",
    "FRAME_UNITS",
    "STATUS",
    "TEMPERATURE",
    "FrameFormat",
    "is_output",
    "parse_frame_format",
]
