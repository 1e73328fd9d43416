"""The staircase on a phase modulator, as an oscilloscope shows it: a check of the 2-pi voltage on the bench.

A record runs through `cut` (where the steps are), `levels` (how high each level is), `rounded_fit` (a straight fit
that knows what rounding does) and `witness` (resets, heights, times, flags).
"""

from analysis.fibre_gyro.staircase.rounded_fit import rounding_left
from analysis.fibre_gyro.staircase.witness import (
    StaircaseWitness,
    describe_witness_flag,
    two_pi_error_of_drive,
    witness_staircase,
)

__all__ = [
    "StaircaseWitness",
    "describe_witness_flag",
    "rounding_left",
    "two_pi_error_of_drive",
    "witness_staircase",
]
