"""What one record of the sweep shows as soon as it is there, a beat or none: for those who watch."""

from __future__ import annotations

import math
from collections.abc import Sequence

from station.dead_band.settings import DeadBandSettings
from station.events.seen import See, Seen, Value
from station.ring_laser.at_once import harmonics_of, trace_of_beat
from station.runs.store import NewRecord
from station.scope.at_once import waveform_of

_BEAT = 0.25
"""Of the largest swing so far: less than this is no beat, but noise or the edge of one."""


def watch(settings: DeadBandSettings) -> See:
    """Return what looks at records of `gyrolock deadband` as they come."""
    return _Watch()


class _Watch:
    def __init__(self) -> None:
        self._largest = 0.0

    def __call__(self, records: Sequence[NewRecord]) -> Seen | None:
        record = records[0]
        waveform = waveform_of(record)
        fit = harmonics_of(waveform)
        amplitude = 0.0 if fit is None else abs(complex(fit.amplitudes[0]))
        self._largest = max(self._largest, amplitude)
        beats = fit is not None and amplitude > _BEAT * self._largest
        frequency = float(fit.frequency) if fit is not None and beats else math.nan
        rate = float(record.conditions["rate_dps"])  # type: ignore[arg-type]  # plain JSON
        values = (
            Value("rate_dps", rate, math.nan, f"{rate:+.5g} deg/s"),
            Value("beat_frequency_hz", frequency, math.nan, f"{frequency:.5g} Hz" if beats else "no beat"),
        )
        group = str(record.conditions["direction"])
        return Seen(record.key, group, values, values, trace=trace_of_beat(waveform, fit if beats else None))
