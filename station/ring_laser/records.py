"""One record: acquired with its conditions, saved, read again as the waveform that the scope sent."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from instrument import TDS2014, InstrumentError, ManualRateTable, Preamble, RateTable, Waveform
from station.errors import RunError, UsageError
from station.ring_laser.settings import BeamsSettings, ScopeSettings
from station.runs.store import NewRecord, SavedRecord
from station.sources.batches import check_over_time


def set_up(
    bench: Bench, wanted: ScopeSettings, channels: Sequence[str], beams: BeamsSettings | None = None
) -> None:
    """Set what the trial records do not choose; a channel that is not there shows here."""
    for channel in channels:
        bench.scope.set_channel(
            channel,
            coupling=wanted.coupling if beams is None or channel not in beams.channels else beams.coupling,
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
    beams: Sequence[str] = (),
) -> list[NewRecord]:
    """Return the records of one acquisition to be saved; further channels are the quadrature, or beams."""
    made: list[NewRecord] = []
    for wave, channel in zip(waveforms, channels, strict=False):
        kind, name = ("quadrature", f"{key}, {channel}") if made else (purpose, key)
        if channel in beams:
            kind = BEAMS[beams.index(channel)]
        about = {"channel": channel, **conditions}
        made.append(NewRecord(name, kind, wave.preamble.to_text(), wave.codes.tobytes(), about))
    return made


BEAMS = ("beam 1", "beam 2")  # purposes of the records of the single beams


def saved_waveform(record: SavedRecord, run: Path) -> Waveform:
    """Return a saved record as the waveform that the scope sent."""
    try:
        waveform = Waveform(record.codes, Preamble.parse(record.preamble))
    except InstrumentError as error:
        raise RunError(f"{run}: record {record.number} cannot be read: {error}") from None
    check_over_time(waveform, f"{run}: record {record.number}")
    return waveform


# --------------------
# The bench as a measurement sees it: an oscilloscope, perhaps a rate table, and a way to wait


@dataclass(frozen=True)
class Bench:
    """What a measurement works with."""

    scope: TDS2014
    table: RateTable | None  # ``None`` where the table turns by itself
    sleep: Callable[[float], None] = time.sleep  # waits so many seconds, of the clock that the instruments live by
    # on a simulated bench: the true values of the last record, with the names of the results
    truth: Callable[[], dict[str, float]] | None = None
    now: Callable[[], float] = time.time  # seconds on that clock, from any beginning
    # what chamber and power supply read now, under names with their units; nothing where there are none
    surroundings: Callable[[], dict[str, float]] = dict

    def turn_table(self, rate_dps: float, settle_s: float, why: str = "") -> float:
        """Set the table's rate, wait until it turns steadily, and then let it settle."""
        if self.table is None:
            raise UsageError("this bench has no rate table that could be set")
        if isinstance(self.table, ManualRateTable):
            self.table.why = why
        self.table.set_rate(rate_dps)
        self.sleep(settle_s)
        return self.table.rate()

    def azimuth(self) -> float | None:
        """Return the table's azimuth in deg, or ``None`` where nobody knows it."""
        if self.table is None:
            return None
        azimuth = self.table.azimuth()
        return azimuth if math.isfinite(azimuth) else None
