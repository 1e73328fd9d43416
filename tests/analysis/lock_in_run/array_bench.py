"""Arrays of whole runs, made without an instrument or a file: a gyro on a rate table, and nothing rounded."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis import beat_signal
from analysis.budget import BenchKnowledge
from analysis.lock_in_run import Batch, RecordArrays, RunArrays, RunKnowledge

K, WL, PHASE = 2000.0, 0.01, 0.4
LATITUDE, TILT = 28.2, 60.0
EARTH_DPS = 15.041067 / 3600
SAMPLES = 1000
KNOWN = RunKnowledge(
    scale_factor=K,
    latitude_deg=LATITUDE,
    bench=BenchKnowledge(scale_factor_u_ppm=50.0),
    latitude_u_deg=0.01,
    table_rate_u_ppm=20.0,
)


def axis_rate(table_rate, azimuth_deg=90.0):
    """W in deg/s by vectors: the turning table and the turning earth, both along the tilted axis."""
    tilt, latitude, azimuth = np.radians(TILT), np.radians(LATITUDE), np.radians(azimuth_deg)
    axis = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
    turning = np.array([0.0, 0.0, table_rate])
    return float(axis @ (turning + EARTH_DPS * np.array([np.cos(latitude), 0.0, np.sin(latitude)])))


def table_rate_for(rate):
    """Rate of the table, deg/s, that gives a rate on the axis when the gyro points east."""
    return (rate - axis_rate(0.0)) / np.cos(np.radians(TILT))


@dataclass(frozen=True)
class Gyro:
    """What makes the volts.

    square : second harmonic that the receiver makes, over the fundamental of an amplitude of 1 V
    pole_hz : corner of the channel, which is seen as it is after it has settled; inf for none
    stretch : time base of the scope, true over stated interval
    """

    rng: np.random.Generator
    noise: float = 0.005
    square: float = 0.0
    pole_hz: float = np.inf
    stretch: float = 1.0

    def volts(self, rate, interval, readout_phases=(0.0,)):
        """Records (n, SAMPLES) of photodiodes that see one beat, at a rate on the axis."""
        start = self.rng.uniform(0, 2 * np.pi)
        seen = np.array([self._seen(rate, interval, start, phase) for phase in readout_phases])
        return seen + self.rng.normal(scale=self.noise, size=seen.shape)

    def _seen(self, rate, interval, start, readout_phase):
        def received(times):
            clean = beat_signal(
                times,
                scale_factor=K,
                input_rate=rate,
                lock_in_rate=WL,
                initial_phase=start,
                backscatter_phase=PHASE,
                readout_phase=readout_phase,
            )
            return clean + 2 * self.square * clean**2

        times = np.arange(SAMPLES) * interval * self.stretch
        if np.isinf(self.pole_hz):
            return received(times)
        # every line of the beat weighed, from one exact period
        frequency = K * np.sqrt(rate**2 - WL**2)
        lines = np.fft.fft(received(np.arange(256) / 256 / frequency)) / 256
        orders = np.fft.fftfreq(256, 1 / 256)
        lines = lines / (1 + 1j * orders * frequency / self.pole_hz)
        kept = np.abs(orders) < 40
        return (np.exp(2j * np.pi * frequency * np.outer(times, orders[kept])) @ lines[kept]).real


def interval_at(rate, periods=20.3):
    """Sample interval in s with which a record holds so many periods."""
    return periods / SAMPLES / (K * np.sqrt(rate**2 - WL**2))


def records(gyro, table_rates, *, azimuths=None, turned=0.0, periods=20.3):
    """RecordArrays of records taken at these rates of the table, one each."""
    table = np.asarray(table_rates, dtype=float)
    where = np.full(table.shape, np.nan) if azimuths is None else np.asarray(azimuths, dtype=float)
    batches = []
    for row, (rate, azimuth) in enumerate(zip(table, where, strict=True)):
        on_axis = axis_rate(rate, azimuth if np.isfinite(azimuth) else 90.0)
        interval = interval_at(on_axis, periods)
        volts = gyro.volts(on_axis, interval)[:, np.newaxis]
        batches.append(Batch(np.array([row]), interval, volts, np.zeros(volts.shape, dtype=bool)))
    over = np.round(np.abs(table * np.cos(np.radians(TILT))) / WL)
    unknown = np.zeros(table.size)
    counts = np.full(table.size, SAMPLES)
    spread = np.broadcast_to(turned, table.shape) / 2
    return RecordArrays(batches, 1, counts, unknown, table, where - spread, where + spread, over)


def together(arrays):
    """The same records, those of one interval in one batch and in reversed order."""
    intervals = sorted({batch.sample_interval for batch in arrays.batches}, reverse=True)
    batches = []
    for interval in intervals:
        same = [batch for batch in arrays.batches if batch.sample_interval == interval][::-1]
        parts = [np.concatenate([getattr(b, name) for b in same], axis=1) for name in ("volts", "clipped")]
        batches.append(Batch(np.concatenate([batch.rows for batch in same]), interval, *parts))
    return replace(arrays, batches=batches)


def whole_run(gyro, slow, **more):
    """A run with a fast part in both senses, three records each, and the slow rates on the axis given."""
    fast = records(gyro, [20.0] * 3 + [-20.0] * 3, periods=60.3)
    return RunArrays(together(records(gyro, [table_rate_for(rate) for rate in slow], **more)), fast)


def no_records():
    """A run without a fast part has this one."""
    return RecordArrays([], 1, np.array([], dtype=int), *(np.array([]) for _ in range(5)))
