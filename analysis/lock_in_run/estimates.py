"""Each record by itself: those of one time base together, batch by batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np

from analysis.arrays import Floats, Indices
from analysis.channel import ChannelResponse, correct_response
from analysis.flags import Flag
from analysis.lock_in_run.records import RecordArrays
from analysis.lockin_equation import Relation
from analysis.lockin_rate import LockInEstimate, estimate_lock_in, noise_model, with_ratio

Estimate = TypeVar("Estimate")


@dataclass(frozen=True)
class Method:
    """How records are turned into a lock-in rate."""

    scale_factor: float  # k, pulses per degree
    relation: Relation = "exact"  # {"exact", "paper-13", "paper-10"}
    input_rate: float | None = None  # rate on the gyro's axis in deg/s; ``None``: each record is its own reference


def estimate_records(records: RecordArrays, method: Method) -> LockInEstimate:
    """Estimate each record from its first channel."""
    parts, rows = [], []
    for batch in records.batches:
        estimate = estimate_lock_in(
            batch.volts[0],
            batch.sample_interval,
            scale_factor=method.scale_factor,
            input_rate=method.input_rate,
            relation=method.relation,
            clipped=batch.clipped[0],
            nan_policy="omit",
        )
        parts.append(estimate)
        rows.append(batch.rows)
    return joined(parts, rows)


def by_themselves(each: LockInEstimate, response: ChannelResponse | None) -> LockInEstimate:
    """What records say that went through a channel, each by itself; it does not depend on the others."""
    beats = only_beats(each)
    return beats if response is None else without_channel(beats, response)


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


def without_channel(each: LockInEstimate, response: ChannelResponse) -> LockInEstimate:
    """The estimates that the records would have given without the channel."""
    return replace(correct_response(each, response), noise_model=without_channel_model(each))


def without_channel_model(each: LockInEstimate) -> str:
    """What the uncertainties rest on where the channel is taken out.

    That of the response is not among it: all records share it, so it stands in the budget.
    """
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
    for field in fields(first):
        each = [getattr(part, field.name) for part in parts]
        if is_dataclass(each[0]):
            values[field.name] = _in_order(each, order)
        elif np.ndim(each[0]):
            values[field.name] = np.concatenate(each) if order is None else np.concatenate(each)[order]
    joint: Estimate = replace(first, **values)
    return joint


def _of_all(each: Estimate) -> Estimate:
    """The same estimates, their noise model that of all of them: not that of the batch they were made in."""
    if not isinstance(each, LockInEstimate):
        return each
    words = noise_model(each.flags)
    return each if words == each.noise_model else replace(each, noise_model=words)
