"""One record: acquired with its conditions, saved, read again as the waveform that the scope sent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from instrument import InstrumentError, Preamble, Waveform
from station.errors import RunError
from station.ring_laser.bench import Bench
from station.ring_laser.settings import ScopeSettings
from station.runs.store import NewRecord, SavedRecord
from station.sources.over_time import check_over_time


def set_up(bench: Bench, wanted: ScopeSettings, channels: Sequence[str]) -> None:
    """Set what the trial records do not choose; a channel that is not there shows here."""
    for channel in channels:
        bench.scope.set_channel(
            channel,
            coupling=wanted.coupling,
            probe=wanted.probe,
            bandwidth_limit=wanted.bandwidth_limit,
            invert=False,
        )
    bench.scope.set_acquisition(mode="SAMPLE")


def take_record(bench: Bench, channels: tuple[str, ...]) -> tuple[tuple[Waveform, ...], dict[str, object]]:
    """Acquire the records of one acquisition and the conditions under which they were taken."""
    azimuth, waveforms, azimuth_after = bench.scope.step(
        lambda: (bench.azimuth(), bench.scope.acquire(channels), bench.azimuth())
    )
    conditions: dict[str, object] = {**bench.surroundings()}
    if azimuth is not None and azimuth_after is not None:
        conditions |= {"azimuth_start_deg": azimuth, "azimuth_end_deg": azimuth_after}
    if bench.truth is not None:
        conditions["truth"] = bench.truth()
    return waveforms, conditions


def acquisition_records(
    purpose: str,
    key: str,
    waveforms: Sequence[Waveform],
    channels: Sequence[str],
    conditions: Mapping[str, object],
) -> list[NewRecord]:
    """Return the records of one acquisition to be saved; a second channel is the quadrature of the first."""
    kinds = ((purpose, key), ("quadrature", f"{key}, {channels[-1]}"))
    return [
        NewRecord(name, kind, wave.preamble.to_text(), wave.codes.tobytes(), {"channel": channel, **conditions})
        for (kind, name), wave, channel in zip(kinds, waveforms, channels, strict=False)
    ]


def saved_waveform(record: SavedRecord, run: Path) -> Waveform:
    """Return a saved record as the waveform that the scope sent."""
    try:
        waveform = Waveform(record.codes, Preamble.parse(record.preamble))
    except InstrumentError as error:
        raise RunError(f"{run}: record {record.number} cannot be read: {error}") from None
    check_over_time(waveform, f"{run}: record {record.number}")
    return waveform
