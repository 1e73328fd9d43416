"""The records of one run as arrays, and what is known of the bench that they were taken on."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from analysis.arrays import Bools, Floats, Indices, Ints
from analysis.budget import BenchKnowledge
from analysis.budget.unstated import SCALE_FACTOR_LIMIT, TABLE_RATE_LIMIT
from analysis.channel import ChannelResponse

_RECORDS_AT_ONCE = 1000
"""20 MB of samples."""


@dataclass(frozen=True)
class Batch:
    """Records of one time base and length."""

    rows: Indices  # (n,): Which of the records they are
    sample_interval: float  # s
    # (n_channels, n, n_samples): nan where there is no sample. The first channel is that of the measurement, a
    # second one that of the other photodiode.
    volts: Floats
    clipped: Bools  # samples at the end of the converter's range


@dataclass(frozen=True)
class RecordArrays:
    """Records that were taken for one purpose, in their order; a number that nobody knows is nan."""

    # every record once. It may make the volts as it goes: those of a long run need much memory.
    batches: Iterable[Batch]
    n_channels: int  # 1, or 2 where every record has a second photodiode
    samples: Ints  # (n,): Of each record
    level_spacing: Floats  # (n,): Volts per level of the converter
    table_rate: Floats  # (n,): deg/s, signed
    azimuth_start: Floats  # (n,): deg, as the table counts, read before and after each record
    azimuth_end: Floats
    over_lock_in: Floats  # (n,): Rate that was asked for, in expected lock-in rates

    def __len__(self) -> int:
        return int(self.samples.size)

    @property
    def azimuth(self) -> Floats:
        """Middle of the two readings, deg; the record was taken somewhere between them."""
        return (self.azimuth_start + self.azimuth_end) / 2

    @property
    def turned(self) -> Floats:
        """Angle between the two readings, deg."""
        return np.abs(self.azimuth_end - self.azimuth_start)


@dataclass(frozen=True)
class RunArrays:
    """All records of a run."""

    slow: RecordArrays  # those that show lock-in, at one rate or at several
    fast: RecordArrays  # those of the fast run, which shows the tilt; none where there was no table


@dataclass(frozen=True)
class RunKnowledge:
    """What is known of gyro, table and channel beside the records of a run."""

    scale_factor: float  # K in pulses per degree, by which the fast run gives the tilt
    latitude_deg: float  # of the bench; the azimuth of the table at which the gyro's axis points north
    north_azimuth_deg: float = 0.0
    both_senses: bool = True  # whether the fast run goes through both senses of rotation
    response: ChannelResponse | None = None  # of the channel, to be taken out of the records
    # what the budget counts besides the records, without a table
    bench: BenchKnowledge = field(default_factory=BenchKnowledge)
    latitude_u_deg: float = 0.0  # standard uncertainties; 0: not known
    table_rate_u_ppm: float = 0.0
    # angle between gyro axis and table axis as it is known without the gyro; nan: it is not
    known_tilt_deg: float = math.nan
    known_tilt_u_deg: float = math.nan

    @property
    def relative_scale_u(self) -> float:
        """Relative standard uncertainty of the scale factor: as stated, or what an unstated one is worth."""
        ppm = self.bench.scale_factor_u_ppm
        return SCALE_FACTOR_LIMIT / math.sqrt(3) if math.isnan(ppm) else 1e-6 * ppm

    @property
    def relative_table_u(self) -> float:
        """The same of the table's rate."""
        return 1e-6 * self.table_rate_u_ppm or TABLE_RATE_LIMIT / math.sqrt(3)


def rows_of_batches(sample_interval: Floats, samples: Ints) -> list[Indices]:
    """Sort records into batches of one time base and length, small enough for the memory.

    Examples
    --------
    >>> [rows.tolist() for rows in rows_of_batches(np.array([1e-5, 2e-5, 1e-5]), np.array([2500, 2500, 2500]))]
    [[0, 2], [1]]
    """
    batches: list[Indices] = []
    left = np.arange(samples.size)
    while left.size:
        first = left[0]
        alike = (sample_interval[left] == sample_interval[first]) & (samples[left] == samples[first])
        alike[0] = True
        rows, left = left[alike], left[~alike]
        batches += [rows[begin : begin + _RECORDS_AT_ONCE] for begin in range(0, rows.size, _RECORDS_AT_ONCE)]
    return batches
