"""The records of one run as arrays, what is known of their bench, and the estimate of each."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np

from analysis.arrays import Bools, Floats, Indices, Ints
from analysis.beam_swings import BeamModulation
from analysis.budget import (
    LOWEST_GAIN_CORNER_HZ,
    SCALE_FACTOR_LIMIT,
    SECOND_ORDER_LIMIT,
    TABLE_RATE_LIMIT,
    BenchKnowledge,
)
from analysis.channel import ChannelResponse, correct_response
from analysis.combine import combine_estimates
from analysis.flags import FATAL, Flag
from analysis.harmonics import fit_free_harmonics
from analysis.lockin_equation import Relation
from analysis.lockin_rate import LockInEstimate, estimate_lock_in, noise_model, with_ratio
from analysis.single_beams import BeamsKnowledge

_RECORDS_AT_ONCE = 1000  # 20 MB of samples


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
    beams: BeamModulation | None = None  # of the slow records, where the single beams were recorded


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
    beams: BeamsKnowledge = field(default_factory=BeamsKnowledge)  # of the channels of the single beams

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


# --------------------
# Each record by itself: those of one time base together, batch by batch


Estimate = TypeVar("Estimate")


@dataclass(frozen=True)
class Method:
    """How records are turned into a lock-in rate: the fields are arguments of the estimate."""

    scale_factor: float  # k, pulses per degree
    relation: Relation = "exact"  # {"exact", "paper-13", "paper-10"}
    input_rate: float | None = None  # rate on the gyro's axis in deg/s; ``None``: each record is its own reference
    mains_hz: float | None = None  # ``None``: 50 or 60

    def estimate(self, batch: Batch) -> LockInEstimate:
        """Every record of a batch by itself, from its first channel."""
        volts, clipped = batch.volts[0], batch.clipped[0]
        return estimate_lock_in(volts, batch.sample_interval, clipped=clipped, nan_policy="omit", **vars(self))


def estimate_records(records: RecordArrays, method: Method) -> LockInEstimate:
    """Estimate each record from its first channel."""
    return joined([method.estimate(batch) for batch in records.batches], [batch.rows for batch in records.batches])


def by_themselves(each: LockInEstimate, response: ChannelResponse | None) -> LockInEstimate:
    """What records say that went through a channel, each by itself; it does not depend on the others."""
    beats = only_beats(each)
    if response is None:
        return beats
    return replace(correct_response(beats, response), noise_model=without_channel_model(beats))


def only_beats(each: LockInEstimate) -> LockInEstimate:
    """Withhold what rests on a piece of some curve: fewer than 3 periods that do not fit either."""
    curve = int(Flag.FEW_PERIODS | Flag.MISFIT)
    pieces = (each.flags & curve) == curve
    if not pieces.any():
        return each
    rates = ("lock_in_rate", "lock_in_rate_u", "lock_in_rate_low_95", "lock_in_rate_high_95")
    withheld: dict[str, Any] = {name: np.where(pieces, np.nan, getattr(each, name)) for name in rates}
    flags = np.where(pieces, each.flags | int(Flag.NOT_LOCK_IN_LIKE), each.flags)
    return replace(each, flags=flags, **withheld)


def without_channel_model(each: LockInEstimate) -> str:
    """What the uncertainties rest on where the channel is taken out."""
    # That of the response is not among it: all records share it, so it stands in the budget.
    return f"{noise_model(each.flags)}; corrected for the response of the channel"


def at_known_rates(each: LockInEstimate, rates: Floats) -> LockInEstimate:
    """The same ratios with rates on the gyro's axis (n,), deg/s, signed, as reference instead of the beat."""

    def given(some: LockInEstimate, rows: slice) -> LockInEstimate:
        known = replace(some, input_rate=rates[rows], rate_given=True)
        return with_ratio(known, some.complex_ratio, some.complex_ratio_covariance)

    return each.changed(given)


def joined(parts: Sequence[Estimate], rows: Sequence[Indices]) -> Estimate:
    """Put estimates of several batches into the order of the records."""
    places = np.concatenate(rows)
    in_order = np.array_equal(places, np.arange(places.size))
    if in_order and len(parts) == 1:
        return _of_all(parts[0])
    return _of_all(_in_order(parts, None if in_order else np.argsort(places)))


def _in_order(parts: Sequence[Estimate], order: Indices | None) -> Estimate:
    first: Any = parts[0]
    values: dict[str, Any] = {}
    for part_field in fields(first):
        each = [getattr(part, part_field.name) for part in parts]
        if is_dataclass(each[0]):
            values[part_field.name] = _in_order(each, order)
        elif np.ndim(each[0]):
            values[part_field.name] = np.concatenate(each) if order is None else np.concatenate(each)[order]
    joint: Estimate = replace(first, **values)
    return joint


def _of_all(each: Estimate) -> Estimate:
    """The same estimates, their noise model that of all of them: not that of the batch they were made in."""
    if not isinstance(each, LockInEstimate):
        return each
    words = noise_model(each.flags)
    return each if words == each.noise_model else replace(each, noise_model=words)


# --------------------
# What the records of one rate say of the lock-in rate, while those of others are still to be taken


_SURE = 4.0
"""Standard uncertainties within which a value surely lies: rates that are chosen anew by chance cost the run."""


@dataclass(frozen=True)
class PreliminaryLockIn:
    """A lock-in rate, and between which values it surely lies, deg/s."""

    lock_in_rate: float
    least: float
    most: float

    @property
    def spread(self) -> float:
        """Of the values that are possible, a factor."""
        return self.most / max(self.least, 1e-3 * self.most)


def preliminary_lock_in(records: RecordArrays, scale_factor: float) -> PreliminaryLockIn | None:
    """Say what records at one rate say of the lock-in rate; ``None`` if they show none."""
    # Distortion and a gain corner of which nobody knows anything count in it: the first adds to the second
    # harmonic or takes from it, the second takes from it where the beat is fast.
    mean = combine_estimates(only_beats(estimate_records(records, Method(scale_factor))))
    rate, rate_u = float(mean.lock_in_rate), float(mean.lock_in_rate_u)
    if int(mean.flags) & int(FATAL) or not (rate > 0 and math.isfinite(rate_u)):
        return None
    # second order d puts the lock-in rate off by 2 W d
    off = math.hypot(_SURE * rate_u, 2 * abs(float(mean.input_rate)) * SECOND_ORDER_LIMIT)
    lost = math.hypot(1.0, float(mean.beat_frequency) / LOWEST_GAIN_CORNER_HZ)
    return PreliminaryLockIn(rate, max(rate - off, 0.0), (rate + off) * lost)


# --------------------
# Third-order distortion of the receiver, by the third harmonic of the records.
#
# The beat's own third harmonic is c3 = c2^2/c1, whatever second-order distortion adds. A cube adds a real number h
# to c3 |c1|^-1 exp(-3i arg c1), the same in every record of one amplitude, and changes r by up to its share h
# (`analysis.budget`)


_HARMONICS = 4
_MOST_RECORDS, _AT_ONCE = 400, 40

_OWN_UNCERTAIN = 0.05  # share of the beat's own third harmonic, r^2, that a slow channel may take away

_UNSTEADY = int(Flag.CLIPPED | Flag.RATE_WANDER | Flag.HARMONICS_ALIASED | Flag.SECOND_HARMONIC_ABOVE_NYQUIST)


def third_order_limit(slow: RecordArrays, each: LockInEstimate, stated: float) -> float:
    """Largest third harmonic that the receiver may make of a pure sine, over the sine, as the records show it."""
    good = each.usable & ((each.flags & _UNSTEADY) == 0)
    found = list(_beside_own(slow, each, good))
    if not found:
        return stated
    beside, noise_u, own = (np.concatenate(column) for column in zip(*found, strict=True))
    weights = 1 / (noise_u**2 + (_OWN_UNCERTAIN * own) ** 2)
    weights /= weights.sum()
    seen = abs(float(weights @ beside))
    scatter = float(np.sqrt(weights**2 @ (beside - weights @ beside) ** 2)) if beside.size > 2 else 0.0
    u = math.hypot(max(float(np.sqrt(weights**2 @ noise_u**2)), scatter), _OWN_UNCERTAIN * float(own.min()))
    most = seen + 2 * u
    return most if math.isnan(stated) else max(min(stated, most), seen - 2 * u)


def _beside_own(slow: RecordArrays, each: LockInEstimate, good: Bools) -> Iterator[tuple[Floats, Floats, Floats]]:
    """Of some records at a time: the third harmonic beside the beat's own, its noise, and r^2."""
    left = _MOST_RECORDS
    for batch in slow.batches:
        kept = np.flatnonzero(good[batch.rows] & np.isfinite(batch.volts[0]).all(axis=-1))[:left]
        left -= kept.size
        for part in (kept[first : first + _AT_ONCE] for first in range(0, kept.size, _AT_ONCE)):
            rows, volts = batch.rows[part], batch.volts[0][part]
            omega = 2 * np.pi * batch.sample_interval * each.beat_frequency[rows]
            # one step from amplitudes of zero: linear least squares at this frequency
            centred = volts - volts.mean(axis=-1, keepdims=True)
            _, _, c, _ = fit_free_harmonics(centred, None, omega, _HARMONICS, iterations=1)
            size, turn = np.abs(c[:, 0]), np.exp(-1j * np.angle(c[:, 0]))
            second, third = c[:, 1] / size * turn**2, c[:, 2] / size * turn**3
            noise_u = each.noise_rms[rows] / size * math.sqrt(2 / volts.shape[1])
            yield (third - second**2).real, noise_u, np.abs(second) ** 2
        if left <= 0:
            return
