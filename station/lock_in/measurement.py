"""The lock-in rate of a ring laser gyro: the skeleton of measurements, filled in, and its live preview."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from analysis import HarmonicFit, fit_rate_ratios, lock_in_from_beat
from analysis.arrays import NoFit
from station.live.preview import Preview, PreviewValue, harmonics_of, trace_of_beat, waveform_of
from station.lock_in.evaluate import evaluate_records
from station.lock_in.quantities import QUANTITIES, record_documents
from station.lock_in.report import sections
from station.lock_in.result import fact_tables, result
from station.lock_in.settings import RING_LASER
from station.lock_in.take import take
from station.measurements import Measurement
from station.results.numbers import BEAT_FREQUENCY, LOCK_IN_RATE, RATIO
from station.results.result import with_uncertainty
from station.ring_laser.bench import examine
from station.runs.store import NewRecord

# --------------------
# What one record says of the lock-in rate as soon as it is there, and all so far: for those who watch.
#
# These values know the noise of the records and nothing else; the result, at the end, counts every input. They
# come from a fit that takes milliseconds: that of the result also follows a rate that moves within a record


_SHARE = 0.2  # of the time at most goes into fitting several rates together, which takes a tenth of a second
_LARGEST = 0.99  # square of a ratio; that of a beat is below 1


@dataclass
class _Rate:
    """Records at one rate and in one sense."""

    sense: int
    # of each record: rho = c2 |c1| / c1^2, the standard uncertainty of either part, and the beat's frequency
    ratios: list[complex] = field(default_factory=list)
    ratio_us: list[float] = field(default_factory=list)
    beats: list[float] = field(default_factory=list)

    def add(self, fit: HarmonicFit) -> None:
        first, second = complex(fit.amplitudes[0]), complex(fit.amplitudes[1])
        self.ratios.append(second * abs(first) / first**2)
        self.ratio_us.append(float(fit.amplitudes_u[1]) / abs(first))
        self.beats.append(float(fit.frequency))

    @property
    def ratio(self) -> tuple[complex, float]:
        """Mean of the complex ratios and its u: of the noise, or of the scatter where that is larger."""
        mean, count = complex(np.mean(self.ratios)), len(self.ratios)
        noise = math.sqrt(sum(u * u for u in self.ratio_us)) / count
        spread = (
            np.sqrt(np.mean(np.abs(np.array(self.ratios) - mean) ** 2) / 2 / (count - 1)) if count > 1 else 0.0
        )
        return mean, max(noise, float(spread))

    @property
    def beat(self) -> float:
        return float(np.mean(self.beats))


class _LockInPreview:
    def __init__(self, scale_factor: float) -> None:
        self._scale_factor = scale_factor
        self._rates: dict[str, _Rate] = {}
        self._together: tuple[PreviewValue, ...] = ()
        self._next_at = -math.inf

    def __call__(self, records: Sequence[NewRecord]) -> Preview | None:
        record = records[0]  # a second photodiode says the same
        waveform = waveform_of(record)
        fit, group = harmonics_of(waveform), _group(record)
        trace = trace_of_beat(waveform, fit)
        if fit is None:
            return Preview(record.key, group, (), flags=("no_beat",), trace=trace)
        alone = _Rate(1)
        alone.add(fit)
        sense = -1 if _number(record, "table_rate_dps", 1.0) < 0 else 1
        rate = self._rates.setdefault(group, _Rate(sense))
        rate.add(fit)
        flags = ("clipped",) if waveform.clipped else ()
        # the fast run is there for the tilt: so weak a second harmonic says little of the lock-in rate
        if record.purpose == "measure" and (began := time.monotonic()) >= self._next_at:
            self._together = self._so_far()
            ended = time.monotonic()
            self._next_at = ended + (ended - began) / _SHARE
        return Preview(record.key, group, self._values(alone), self._values(rate), self._together, flags, trace)

    def _values(self, rate: _Rate) -> tuple[PreviewValue, ...]:
        (ratio, u), beat, count = rate.ratio, rate.beat, len(rate.beats)
        size = math.sqrt(max(abs(ratio) ** 2 - u * u, 0.0))  # noise makes a small complex number larger
        lock_in, lock_in_u = math.nan, math.nan
        if size < 1:  # a record is its own reference
            beat_rate = beat / self._scale_factor
            lock_in = float(lock_in_from_beat(size, beat_rate))
            lock_in_u = 2 * beat_rate * (1 + size**2) / (1 - size**2) ** 2 * u
        return (
            PreviewValue(
                LOCK_IN_RATE.key(), lock_in, lock_in_u, with_uncertainty(lock_in, lock_in_u, "deg/s"), count
            ),
            PreviewValue(BEAT_FREQUENCY.key(), beat, math.nan, f"{beat:.5g} Hz", count),
            PreviewValue(RATIO.key(), size, u, with_uncertainty(size, u), count),
        )

    def _so_far(self) -> tuple[PreviewValue, ...]:
        """The lock-in rate that all rates together give, with distortion of the receiver taken out if they can."""
        rates = [rate for name, rate in self._rates.items() if not name.startswith("tilt")]
        if len(rates) < 2:
            return self._values(rates[0])[:1] if rates else ()
        ratios = [rate.ratio for rate in rates]
        beats = np.array([rate.beat for rate in rates])
        squares = np.array([min(abs(ratio) ** 2, _LARGEST) for ratio, _ in ratios])
        on_axis = np.array([rate.sense for rate in rates]) * beats / self._scale_factor
        on_axis *= (1 + squares) / (1 - squares)
        covariance = np.array([u * u * np.eye(2) for _, u in ratios])
        try:
            fit = fit_rate_ratios(
                on_axis,
                [ratio for ratio, _ in ratios],
                covariance,
                beats,
                scale_factor=self._scale_factor,
                input_rate_u=math.inf,
                reference="beat",
                model="distortion",
            )
        except NoFit:
            return ()
        value, u = fit.lock_in_rate, fit.lock_in_rate_u
        count = sum(len(rate.beats) for rate in rates)
        return (PreviewValue(LOCK_IN_RATE.key(), value, u, with_uncertainty(value, u, "deg/s"), count),)


def _group(record: NewRecord) -> str:
    """Records at one rate and in one sense."""
    table, over = _number(record, "table_rate_dps", 1.0), _number(record, "over_lock_in", math.nan)
    if record.purpose == "measure" and math.isfinite(over):
        return f"rate {math.copysign(over, table):+g}"
    return f"{record.purpose} {table:+g}" if "table_rate_dps" in record.conditions else record.purpose


def _number(record: NewRecord, name: str, default: float) -> float:
    value = record.conditions.get(name)
    return float(value) if isinstance(value, int | float) else default


MEASUREMENT = Measurement(
    name="measure",
    command="gyrolock measure",
    title="Lock-in rate",
    kind=RING_LASER,
    take=take,
    evaluate=evaluate_records,
    streams=True,
    damage=lambda found: found.damage,
    choices=("scale_factor", "relation", "input_rate"),
    quantities=QUANTITIES,
    result=result,
    sections=lambda found, run, settings, result: sections(found, result),
    facts=fact_tables,
    rows=lambda found: record_documents(found, "record"),
    examine=lambda settings: examine(settings, settings.table.fast_rate_dps),
    watch=lambda settings: _LockInPreview(settings.gyro.scale_factor_pulses_per_deg),
)
