"""What one record of the staircase says as soon as it is there, and all so far: for those who watch."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import StaircaseWitness
from instrument import Waveform
from station.events.seen import See, Seen, Trace, Value
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.witness.evaluate import witnessed
from station.results.numbers import with_uncertainty
from station.runs.store import NewRecord
from station.scope.at_once import trace_of, waveform_of

_RESETS = 3.0
"""Falls of the staircase that are shown."""


def watch(settings: FogSettings) -> See:
    """Return what looks at records of `gyrolock fog witness` as they come."""
    return _Watch(settings)


class _Watch:
    def __init__(self, settings: FogSettings) -> None:
        self._transit_time = settings.coil.transit_time
        self._found: list[StaircaseWitness] = []

    def __call__(self, records: Sequence[NewRecord]) -> Seen | None:
        record = records[0]
        waveform = waveform_of(record)
        clipped = ("clipped",) if waveform.clipped else ()
        try:
            found, _ = witnessed(waveform, self._transit_time)
        except ValueError:  # the result will say why it is left out
            return Seen(
                record.key, record.purpose, (), flags=(*clipped, "no_staircase"), trace=_trace(waveform, None)
            )
        self._found.append(found)
        running = _values(self._found)
        flags = (*clipped, *found.flags)
        return Seen(
            record.key, record.purpose, _values([found]), running, running[:1], flags, _trace(waveform, found)
        )


def _values(found: Sequence[StaircaseWitness]) -> tuple[Value, ...]:
    """Means by their weights; without the gain of the oscilloscope, which all records share."""
    voltage, voltage_u = _mean([(one.two_pi_voltage, one.two_pi_voltage_u) for one in found])
    time, time_u = _mean([(one.step_time, one.step_time_u) for one in found])
    step, step_u = _mean([(one.step_height, one.step_height_u) for one in found])
    said = with_uncertainty(voltage, voltage_u, "V") if math.isfinite(voltage) else "no reset"
    return (
        Value("two_pi_voltage_v", voltage, voltage_u, said, len(found)),
        Value("step_height_v", step, step_u, with_uncertainty(step, step_u, "V"), len(found)),
        Value("step_time_s", time, time_u, with_uncertainty(1e6 * time, 1e6 * time_u, "µs"), len(found)),
    )


def _mean(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    known = np.array([pair for pair in values if all(map(math.isfinite, pair)) and pair[1] > 0])
    if not len(known):
        return math.nan, math.nan
    weights = 1 / known[:, 1] ** 2
    return float(np.average(known[:, 0], weights=weights)), float(1 / math.sqrt(weights.sum()))


def _trace(waveform: Waveform, found: StaircaseWitness | None) -> Trace:
    """A few resets with the even staircase through them; without one the whole record."""
    if found is None or not found.step_time > 0:
        return trace_of(waveform, math.inf, None)

    def staircase(times: NDArray[np.float64]) -> NDArray[np.float64]:
        edges = (found.times[1:] + found.times[:-1]) / 2
        return np.asarray(found.model[np.searchsorted(edges, times)])

    steps = found.two_pi_voltage / abs(found.step_height) if found.step_height else math.nan
    shown = _RESETS * steps * found.step_time
    return trace_of(waveform, shown if math.isfinite(shown) else math.inf, staircase)
