"""One description tried on some bytes: frames, rate, gaps, checksums, what is left over."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from instrument.fibre_gyro.frame_format.layout import FrameFormat
from instrument.fibre_gyro.frame_stream import Damage, FrameStream
from instrument.fibre_gyro.frames import Frame
from instrument.fibre_gyro.host_clock import Arrivals
from instrument.fibre_gyro.meaning import doubts_about
from instrument.fibre_gyro.record_builder import CounterClock
from instrument.fibre_gyro.recording import HostClock
from instrument.fibre_gyro.sniff.capture import Capture

_PIECE = 16_384  # bytes of a file that are looked at in one go
_ENOUGH = 60_000  # bytes without a frame after which none is expected
_FEWEST = 8  # frames that are more than chance
_MOSTLY = 0.5  # of the bytes that a description must explain to be proposed


@dataclass(frozen=True)
class Trial:
    """What one description makes of the bytes."""

    name: str  # of the description
    frames: int  # frames that are right in everything; of them those with a bad status or a value out of range
    unusable: int
    damaged: int  # frames, in lengths of one, between right ones that are not
    checksum_misses: int  # of the damaged ones those with header, length and ending, but another checksum
    has_checksum: bool  # whether the description has them at all
    has_counter: bool
    gaps: int  # places where the counter skips, and frames that it skips
    missing: int
    stated_rate_hz: float
    rate_hz: float | None  # frames per second of the computer's clock; None for a file
    clock: HostClock | None  # the same with its uncertainty, where it can be told
    explained: float  # part of all bytes that right frames are made of
    doubts: tuple[str, ...]  # what shows that the numbers may mean something else
    evidence_bits: int  # bits of each frame that only the right one has

    @property
    def fits(self) -> bool:
        """Whether so much is explained that the description may be the right one."""
        return self.frames >= _FEWEST and self.explained >= _MOSTLY

    @property
    def merit(self) -> tuple[bool, float, bool, int]:
        """The largest is the likeliest: little left over, no doubts, most that chance cannot bring about."""
        right = self.frames - self.unusable
        share = self.explained * (0.5 + 0.5 * right / max(1, self.frames))
        return self.fits and not self.doubts, round(share, 1), not self.missing, self.evidence_bits


def try_format(name: str, layout: FrameFormat, capture: Capture) -> Trial:
    """Try one description on a capture."""
    stream = FrameStream(layout)
    clock, arrivals = CounterClock(layout.counter, layout.interval_s), Arrivals()
    rows: list[tuple[float, ...]] = []
    reasons: Counter[str] = Counter()
    gaps = missing = damaged = explained = 0
    index = -1
    for host_s, piece in [*_pieces(capture), (capture.seconds, b"")]:
        before = index
        if index < 0 and stream.tally.received > _ENOUGH:
            break
        for event in stream.feed(piece, silent=not piece):
            if isinstance(event, Damage):
                damaged += event.frames
                reasons[event.reason] += event.frames
            elif isinstance(event, Frame):
                tick = clock.place(
                    event.counter, host_s=host_s, silent_s=0.0, damaged=damaged if index >= 0 else 0
                )
                damaged = 0
                rows.append(event.values)
                if tick is not None:
                    lost = tick.index - index - 1 if index >= 0 else 0
                    gaps, missing, index = gaps + (lost > 0), missing + lost, tick.index
        if capture.timed and piece and index > before:
            arrivals.add(index, host_s)
    tally = stream.tally
    received = max(1, tally.received)
    found = arrivals.clock(layout.interval_s) if capture.timed else None
    explained = tally.received - tally.discarded - stream.held
    rate = found.output_rate_hz if found is not None else None
    if rate is None and capture.timed and capture.seconds > 0:
        rate = index / capture.seconds
    return Trial(
        name=name,
        frames=tally.good + tally.unusable,
        unusable=tally.unusable,
        damaged=tally.damaged,
        checksum_misses=reasons["wrong checksum"] + reasons["wrong parity"],
        has_checksum=layout.check is not None or any(one.name in ("check", "parity") for one in layout.fields),
        has_counter=layout.has_counter,
        gaps=gaps,
        missing=missing,
        stated_rate_hz=layout.output_rate_hz,
        rate_hz=rate if tally.good + tally.unusable else None,
        clock=found,
        explained=explained / received if tally.good + tally.unusable else 0.0,
        doubts=doubts_about(layout, rows),
        evidence_bits=layout.evidence_bits if layout.kind == "binary" else _text_evidence(layout),
    )


def _pieces(capture: Capture) -> list[tuple[float, bytes]]:
    if capture.timed:
        return list(capture.pieces)
    data = capture.data
    return [(0.0, data[begin : begin + _PIECE]) for begin in range(0, len(data), _PIECE)]


def _text_evidence(layout: FrameFormat) -> int:
    return 8 * (len(layout.header) + len(layout.ending) + (layout.check.size if layout.check else 0)) + len(
        layout.fields
    )
