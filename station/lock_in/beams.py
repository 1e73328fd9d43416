"""The single beams of a run: read beside their beats, record by record, and how far they swing with them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from analysis.single_beams import BeamModulation, beam_modulation
from instrument import Waveform
from station.lock_in.estimate import MEASURE, Gathered
from station.lock_in.settings import Settings, beams_corner_hz
from station.ring_laser.records import BEAMS, saved_waveform
from station.sources.batches import Source

_AT_ONCE = 200  # acquisitions whose samples are held at a time


@dataclass
class _Acquisition:
    """The beat of one acquisition, the row of its estimate, and the beams beside it; ``None``: damaged."""

    row: int
    beat: Waveform
    beams: dict[str, Waveform]


def beams_of_run(source: Source, gathered: Gathered, settings: Settings) -> BeamModulation | None:
    """Read the beams of a run once more beside their beats; ``None`` where none was recorded."""
    channels = settings.beams.channels
    if not channels or gathered.each is None:
        return None
    levels = settings.beams.level_v or source.facts.get("beam_levels_v") or [math.nan] * len(channels)
    count, frequency = len(gathered), gathered.each.beat_frequency
    empty = np.full((count, 2), np.nan)
    swing, swing_u, over, flags = empty.astype(np.complex128), empty.copy(), empty.copy(), 0
    purposes, found = BEAMS[: len(channels)], False
    for some in _batches(source, gathered, purposes):
        rows, first = [one.row for one in some], some[0].beat
        volts = np.array([[one.beams[purpose].volts for one in some] for purpose in purposes])
        clipped = np.array([[one.beams[purpose].clipped_samples for one in some] for purpose in purposes])
        made = beam_modulation(
            np.array([one.beat.volts for one in some]),
            volts,
            first.sample_interval,
            beat_frequency=frequency[rows],
            level=levels,
            clipped=clipped,
            ac_corner_hz=beams_corner_hz(settings),
        )
        swing[rows], swing_u[rows], over[rows] = made.modulation, made.modulation_u, made.beat_over_level
        flags, found = flags | made.flags, True
    return BeamModulation(swing, swing_u, over, flags) if found else None


def _batches(source: Source, gathered: Gathered, purposes: Sequence[str]) -> Iterator[list[_Acquisition]]:
    """Acquisitions of one time base of which beat and beams are whole, some at a time."""
    row_of = {int(number): row for row, number in enumerate(gathered.numbers)}
    waiting: dict[tuple[float, int], list[_Acquisition]] = {}
    now: _Acquisition | None = None
    for record in source.records():
        if record.purpose == MEASURE:
            row = row_of.get(record.number)
            now = None if row is None else _Acquisition(row, saved_waveform(record, source.path), {})
        elif record.purpose in purposes and now is not None and record.intact:
            now.beams[record.purpose] = saved_waveform(record, source.path)
            if len(now.beams) == len(purposes) and _alike(now):
                some = waiting.setdefault((now.beat.sample_interval, len(now.beat)), [])
                some.append(now)
                if len(some) >= _AT_ONCE:
                    yield some
                    some.clear()
    yield from (some for some in waiting.values() if some)


def _alike(one: _Acquisition) -> bool:
    """Whether beat and beams have one time base: others are not of one acquisition."""
    beat = one.beat
    return all(
        len(beam) == len(beat) and math.isclose(beam.sample_interval, beat.sample_interval, rel_tol=1e-9)
        for beam in one.beams.values()
    )
