"""The digital output of a fibre gyro, and its injection commands, on a serial line; and logs of it.

Bytes meet, in order: `link` (the port), `frame_stream` (where a frame begins), `frames` (checks and numbers, as
`frame_format` describes them), `recording`. `identify` finds out which description fits; `logs` reads files.
"""

from instrument.errors import CommandRefused, FrameFormatError, NoAcknowledgement
from instrument.fibre_gyro.frame_fields import ANGLE_UNITS, OUTPUT_UNITS, TABLE_ANGLE
from instrument.fibre_gyro.frame_format import FrameFormat, parse_frame_format
from instrument.fibre_gyro.link import FibreGyroLink
from instrument.fibre_gyro.logs import GyroLog, LogChoices, read_gyro_log, read_log, write_gyro_log
from instrument.fibre_gyro.recording import HOST_CLOCK_U, Gap, HostClock, Losses, Recording, counts_per_unit

__all__ = [
    "ANGLE_UNITS",
    "HOST_CLOCK_U",
    "OUTPUT_UNITS",
    "TABLE_ANGLE",
    "CommandRefused",
    "FibreGyroLink",
    "FrameFormat",
    "FrameFormatError",
    "Gap",
    "GyroLog",
    "HostClock",
    "LogChoices",
    "Losses",
    "NoAcknowledgement",
    "Recording",
    "counts_per_unit",
    "parse_frame_format",
    "read_gyro_log",
    "read_log",
    "write_gyro_log",
]
