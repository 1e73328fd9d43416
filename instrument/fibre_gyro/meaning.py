"""Numbers that a frame format gives although their bytes mean something else.

A checksum shows that the bytes are right, not that they are read rightly: seven data bits a byte read as eight,
the bytes in another order, a signed number read as unsigned. A gyro's output moves little from one frame to the
next. Read wrongly it is torn over its whole range, or one bit of a lively byte never moves.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from instrument.fibre_gyro.frame_format.checksums import ByteOrder
from instrument.fibre_gyro.frame_format.fields import Field, is_output
from instrument.fibre_gyro.frame_format.layout import FrameFormat

_FEWEST = 64  # frames: by chance a bit stands still so long once in 1e19
_MOST = 4096
_LIVELY = 24  # different values of a byte whose low bits all move
_TORN = 2.0**-6  # part of its range that an output moves from frame to frame, read wrongly
_CALM = 2.0**-5  # how much less it must move, read in another way, before that is said

Bytes = NDArray[np.uint8]


def doubts_about(layout: FrameFormat, rows: Sequence[tuple[float, ...]]) -> tuple[str, ...]:
    """What the outputs of some frames show of a wrong description; sentences, none where nothing does."""
    if len(rows) < _FEWEST or layout.kind != "binary":
        return ()
    table = np.array(rows[:_MOST], dtype=np.float64)
    fields = {one.name: one for one in layout.fields}
    said = []
    for place, name in enumerate(layout.names):
        if is_output(name):
            said.append(_doubt(fields[name], table[:, place]))
    return tuple(one for one in said if one)


def _doubt(entry: Field, values: NDArray[np.float64]) -> str:
    if entry.kind == "float":
        return _strange_float(entry, (values - entry.offset) / entry.scale)
    if entry.bits or entry.carried_bits > 52 or entry.carried_bits < 16:
        return ""
    sent = _as_sent(entry, values)
    return _seven_bits(entry, sent) or _other_reading(entry, sent)


def _strange_float(entry: Field, values: NDArray[np.float64]) -> str:
    sizes = np.abs(values[values != 0])
    if sizes.size < _FEWEST or np.mean((sizes < 1e-25) | (sizes > 1e25)) < 0.2:
        return ""
    return (
        f"{entry.name}: its floats are of every size from {sizes.min():.0e} to {sizes.max():.0e}; is it a float, "
        "in this byte order?"
    )


def _as_sent(entry: Field, values: NDArray[np.float64]) -> Bytes:
    """The bytes of a whole number as they came, one row for each frame."""
    whole = np.round((values - entry.offset) / entry.scale).astype(np.int64) & ((1 << entry.carried_bits) - 1)
    shifts = entry.data_bits * np.array(entry.significance, dtype=np.int64)
    return np.asarray(whole[:, None] >> shifts & ((1 << entry.data_bits) - 1), dtype=np.uint8)


def _seven_bits(entry: Field, sent: Bytes) -> str:
    """Seven data bits a byte, read as eight: a byte moves in all its low bits, none ever in the highest."""
    if entry.data_bits != 8:
        return ""
    different = sorted((len(set(column.tolist())) for column in sent.T), reverse=True)
    # a byte that carries into the next one has been through all of its values
    if sent.max() >= 128 or different[0] < _LIVELY or different[1] < 2:
        return ""
    return (
        f"{entry.name}: the highest bit of all its bytes was 0 in {len(sent)} frames; if they carry seven bits "
        "each, say data_bits = 7"
    )


def _other_reading(entry: Field, sent: Bytes) -> str:
    """Another order of the bytes, or a sign, with which the output moves much less."""
    now = _moves(entry, sent)
    if now < _TORN:
        return ""
    calmest, how = now, ""
    for other, name in _readings(entry):
        if (moves := _moves(other, sent)) < calmest:
            calmest, how = moves, name
    if calmest > _CALM * now:
        return ""
    return (
        f"{entry.name}: jumps by {100 * now:.2g} % of its range from frame to frame; read {how} it would move by "
        f"{100 * calmest:.2g} % only"
    )


def _readings(entry: Field) -> list[tuple[Field, str]]:
    orders: dict[ByteOrder, str] = {"little": "low byte first", "big": "high byte first"}
    kinds = {"signed": "as a signed number", "unsigned": "as an unsigned number"}
    found = []
    named = [(replace(entry, order=(), byte_order=order), text) for order, text in orders.items()]
    if entry.size == 3:
        mixed = (order for order in itertools.permutations(range(3)) if order not in ((0, 1, 2), (2, 1, 0)))
        named += [(replace(entry, order=order), f"with byte_order = {list(order)}") for order in mixed]
    for kind, sign in kinds.items():
        for one, text in named:
            if (one.significance, kind) != (entry.significance, entry.kind):
                parts = [] if one.significance == entry.significance else [text]
                parts += [] if kind == entry.kind else [sign]
                found.append((replace(one, kind=kind), ", ".join(parts)))
    return found


def _moves(entry: Field, sent: Bytes) -> float:
    """How far a number moves from frame to frame, the 95th percentile, as part of its range."""
    shifts = entry.data_bits * np.array(entry.significance, dtype=np.int64)
    numbers = np.sum(sent.astype(np.int64) << shifts, axis=1)
    if entry.kind == "signed":
        half = 1 << (entry.carried_bits - 1)
        numbers = (numbers ^ half) - half
    return float(np.quantile(np.abs(np.diff(numbers)), 0.95)) / float(1 << entry.carried_bits)
