"""Bytes of an unknown gyro: which description fits them, and what they show without any."""

from instrument.fibre_gyro.sniff.capture import LOOKED_AT, Capture, capture_port, captured_file, poll_of
from instrument.fibre_gyro.sniff.structure import Structure, find_structure
from instrument.fibre_gyro.sniff.trial import Trial, try_format

__all__ = [
    "LOOKED_AT",
    "Capture",
    "Structure",
    "Trial",
    "capture_port",
    "captured_file",
    "find_structure",
    "poll_of",
    "try_format",
]
