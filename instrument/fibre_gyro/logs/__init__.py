"""Logs of a fibre gyro as CSV files: the output with or without time stamps, temperature, counter and others.

Written by all sorts of programs, so preamble, separator, header, comments and decimal comma are found out from the
file. The numbers are not: a row that cannot be read is an error with its line number, never left out.
"""

from instrument.fibre_gyro.logs.columns import OUTPUT_UNITS
from instrument.fibre_gyro.logs.read import GyroLog, LogChoices, parse_gyro_log, read_gyro_log, read_log
from instrument.fibre_gyro.logs.write import write_gyro_log

__all__ = [
    "OUTPUT_UNITS",
    "GyroLog",
    "LogChoices",
    "parse_gyro_log",
    "read_gyro_log",
    "read_log",
    "write_gyro_log",
]
