"""A look at the bench of a fibre gyro before a campaign: does it send frames, and without losses."""

from __future__ import annotations

from instrument import InstrumentError
from station.errors import StationError, one_line
from station.fibre_gyro.segments import PlannedSegment
from station.fibre_gyro.serial_bench import open_fog_bench
from station.fibre_gyro.settings import FogSettings
from station.results.check import Check

_SECONDS = 2.0


def examine(settings: FogSettings) -> list[Check]:
    """Record two seconds of output at rest."""
    told: list[str] = []
    try:
        with open_fog_bench(settings, tell=told.append) as bench:
            planned = PlannedSegment("look", _SECONDS, 0.0, {"purpose": "look", "rate_dps": 0.0})
            recording = bench.record(planned, lambda seconds: None)
    except (InstrumentError, StationError, OSError) as error:
        return [Check("fibre gyro", "bad", one_line(error))]
    at = settings.link.port or "the simulated bench"
    losses, clock = recording.losses, recording.host_clock
    text = f"{losses.good} frames in {_SECONDS:g} s at {at}, {losses.missing} missing"
    state: list[Check] = [Check("fibre gyro", "note" if losses.missing else "ok", text)]
    if clock is not None and clock.used:
        state.append(
            Check("gyro's clock", "note", f"{clock} against the computer's: it is measured and allowed for")
        )
    state += [Check("frame format", "bad", doubt) for doubt in recording.doubts]
    return [*state, *(Check("bench", "note", one) for one in told)]
