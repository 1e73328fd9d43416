"""The single beams of a run or of files: read beside their beats, and how far they swing with them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analysis.arrays import Floats
from analysis.beam_swings import BeamModulation, beam_modulation
from instrument import InstrumentError, Waveform
from station.errors import StationError, UsageError
from station.lock_in.estimate import MEASURE, Gathered
from station.lock_in.settings import Settings, beams_corner_hz
from station.ring_laser.records import BEAMS, saved_waveform
from station.sources.batches import Source
from station.sources.find import open_source

_AT_ONCE = 200  # acquisitions whose samples are held at a time


@dataclass
class _Acquisition:
    """The beat of one acquisition, the row of its estimate, and the beams beside it that are whole."""

    row: int
    beat: Waveform
    beams: dict[str, Waveform]


def beams_of_run(source: Source, gathered: Gathered, settings: Settings) -> BeamModulation | None:
    """Read the beams of a run once more beside their beats; ``None`` where none was recorded."""
    if not settings.beams.channels or gathered.each is None:
        return None
    levels = source.facts.get("beam_levels_v") or ()
    return _modulation(_of_run(source, gathered), gathered.each.beat_frequency, settings, levels)


def beams_of_files(
    files: Sequence[str], opened: Mapping[str, Source], frequency: Floats, settings: Settings
) -> BeamModulation | None:
    """Read the beams beside the beats (n,) of files, F0001CH2 beside F0001CH1; ``None`` where there are none."""
    return _modulation(_of_files(files, opened, settings.beams.channels), frequency, settings, ())


def _modulation(
    acquisitions: Iterable[_Acquisition], frequency: Floats, settings: Settings, measured: Sequence[float]
) -> BeamModulation | None:
    """Modulation of the beams beside n beats, those of one time base some at a time."""
    purposes = BEAMS[: len(settings.beams.channels)]
    levels = settings.beams.level_v or measured or [math.nan] * len(purposes)
    if len(levels) != len(purposes):
        raise UsageError(f"beams.level_v: {len(levels)} levels for {len(purposes)} beams that were recorded")
    shape = frequency.size, 2
    swing = np.full(shape, np.nan, dtype=np.complex128)
    swing_u, over, flags, found = np.full(shape, np.nan), np.full(shape, np.nan), 0, False
    phase_u = np.full(frequency.size, np.nan)
    for some in _batches(acquisitions, purposes):
        rows = [one.row for one in some]
        made = beam_modulation(
            np.array([one.beat.volts for one in some]),
            np.array([[one.beams[purpose].volts for one in some] for purpose in purposes]),
            some[0].beat.sample_interval,
            beat_frequency=frequency[rows],
            level=levels,
            clipped=np.array([[one.beams[purpose].clipped_samples for one in some] for purpose in purposes]),
            ac_corner_hz=beams_corner_hz(settings),
        )
        swing[rows], swing_u[rows], over[rows] = made.modulation, made.modulation_u, made.beat_over_level
        phase_u[rows] = made.phase_u
        flags, found = flags | made.flags, True
    return BeamModulation(swing, swing_u, phase_u, over, flags) if found else None


def _batches(acquisitions: Iterable[_Acquisition], purposes: Sequence[str]) -> Iterator[list[_Acquisition]]:
    """Acquisitions of which beat and beams are whole and have one time base, some at a time."""
    waiting: dict[tuple[float, int], list[_Acquisition]] = {}
    for one in acquisitions:
        shapes = {(wave.sample_interval, len(wave)) for wave in (one.beat, *one.beams.values())}
        if len(one.beams) < len(purposes) or len(shapes) > 1:
            continue
        some = waiting.setdefault(shapes.pop(), [])
        some.append(one)
        if len(some) >= _AT_ONCE:
            yield some
            some.clear()
    yield from (some for some in waiting.values() if some)


def _of_run(source: Source, gathered: Gathered) -> Iterator[_Acquisition]:
    row_of = {int(number): row for row, number in enumerate(gathered.numbers)}
    now: _Acquisition | None = None
    for record in source.records():
        if record.purpose == MEASURE:
            if now is not None:
                yield now
            row = row_of.get(record.number)
            now = None if row is None else _Acquisition(row, saved_waveform(record, source.path), {})
        elif record.purpose in BEAMS and now is not None and record.intact:
            now.beams[record.purpose] = saved_waveform(record, source.path)
    if now is not None:
        yield now


def _of_files(
    files: Sequence[str], opened: Mapping[str, Source], channels: Sequence[str]
) -> Iterator[_Acquisition]:
    for row, name in enumerate(files):
        beams = {}
        for purpose, channel in zip(BEAMS, channels, strict=False):
            beside = Path(name).with_name(re.sub(r"CH\d(?=\.\w+$)", channel, Path(name).name, flags=re.IGNORECASE))
            try:
                beams[purpose] = _only_record(open_source(beside)) if str(beside) != name else None
            except (StationError, InstrumentError, OSError):
                continue
        beat = _only_record(opened.get(name) or open_source(Path(name)))
        whole = {purpose: wave for purpose, wave in beams.items() if wave is not None}
        if beat is not None:
            yield _Acquisition(row, beat, whole)


def _only_record(source: Source) -> Waveform | None:
    """The record of a file; ``None`` for a source of several."""
    records = list(source.records(range(1, 3)))
    return saved_waveform(records[0], source.path) if len(records) == 1 else None
