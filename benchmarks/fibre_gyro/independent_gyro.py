"""A fibre gyro on its rate table that shares no code with the product, and the logs that its recorder writes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LATITUDE, EARTH_DPH = 45.78, 15.041067
VERTICAL, HORIZONTAL = (EARTH_DPH / 3600 * f(np.deg2rad(LATITUDE)) for f in (np.sin, np.cos))
K = 251.37  # counts per deg/s
SETTLE_S = 5.0  # between two logs


@dataclass(frozen=True)
class Gyro:
    """A gyro and its bench, with what may be wrong with them; logs hold so many turns of each rate."""

    walk: float = 0.005  # deg/sqrt(h)
    instability_dph: float = 0.0  # of a flicker process, the coefficient B
    rate_walk_dph: float = 0.0  # deg/h/sqrt(h)
    quantization_deg: float = 0.0
    drift_dph_per_h: float = 0.0
    irreproducible: float = 0.0
    asymmetry: float = 0.0  # relative difference of K between the senses
    cubic: float = 0.0  # relative change of K at the largest rate
    tilt: float = 2e-3  # rad
    turns: int = 10
    rates: tuple[float, ...] = (20.0, 20.01, 20.1, 21.0)
    repeats: int = 1
    both_ends: bool = False
    filter_words: int = 1
    lost: float = 0.0
    spikes: int = 0
    stamps_s: float = 0.0
    output_hz: float = 10.0
    begin_anew: bool = False  # the recorder's clock starts at 0 with every log
    noise_known: bool = False  # a noise model of the gyro is given
    settings: Mapping[str, Any] = field(default_factory=dict)


def flicker(rng: np.random.Generator, count: int) -> Floats:
    """A series with a spectrum of 1/f, of a bias instability B of 1: its Allan deviation is flat at 0.664."""
    size = 1 << (2 * count - 1).bit_length()
    frequency = np.fft.rfftfreq(size)
    shape = np.zeros(frequency.size)
    shape[1:] = frequency[1:] ** -0.5
    white = np.fft.rfft(rng.normal(size=size))
    return np.asarray(np.fft.irfft(white * shape, size)[:count] / np.sqrt(2 * np.pi), dtype=np.float64)


def at_rest(gyro: Gyro, rng: np.random.Generator, count: int) -> Floats:
    """Output words of a gyro at rest without the earth, deg/s: all kinds of noise."""
    interval = 1 / gyro.output_hz
    words = rng.normal(0, gyro.walk / 60 / np.sqrt(interval), count)
    if gyro.instability_dph:
        words += gyro.instability_dph / 3600 * flicker(rng, count)
    if gyro.rate_walk_dph:
        size = gyro.rate_walk_dph / 216_000 * np.sqrt(interval)
        steps, within = size * rng.normal(size=count), size / np.sqrt(12) * rng.normal(size=count)
        words += np.concatenate([[0.0], np.cumsum(steps)])[:-1] + steps / 2 + within
    if gyro.quantization_deg:
        words += np.diff(rng.normal(0, gyro.quantization_deg, count + 1)) / interval
    return words + gyro.drift_dph_per_h / 3600 * np.arange(count) * interval / 3600


class Bench:
    """Time goes on from log to log: so a bias that wanders is the same one in all of them."""

    def __init__(self, gyro: Gyro, seed: int, folder: Path, seconds: float) -> None:
        self.gyro, self.rng, self.folder = gyro, np.random.default_rng(seed), folder
        self.now = 0
        words = int((seconds + 1) * gyro.output_hz)
        self.slow = np.zeros(words)
        if gyro.instability_dph:
            self.slow += gyro.instability_dph / 3600 * flicker(self.rng, words)
        self.slow += gyro.drift_dph_per_h / 3600 * np.arange(words) / gyro.output_hz / 3600

    def words(self, seconds: float, rate: float, step: float = 0.0, end_up: int = 1) -> Floats:
        """Output words, counts, of a table that turns and a step that is injected."""
        gyro, rng = self.gyro, self.rng
        count = round(seconds * gyro.output_hz)
        turning = rate * (1 + gyro.irreproducible * rng.normal())
        north = self._north(turning, count)
        omega = end_up * np.cos(gyro.tilt) * (turning + VERTICAL) + np.sin(gyro.tilt) * HORIZONTAL * north
        full = max(gyro.rates)
        omega = omega * (1 + gyro.asymmetry / 2 * np.sign(omega) + gyro.cubic * (omega / full) ** 2)
        words = K * (omega + self._white(count) + self.slow[self.now : self.now + count]) + step
        self.now += count + round(SETTLE_S * gyro.output_hz)
        return np.asarray(words, dtype=np.float64)

    def about(self, turned: int, rate: float, matrix: Floats) -> Floats:
        """Output words of three gyros at once, (3, n), counts, with one body axis along the table's."""
        gyro, rng = self.gyro, self.rng
        count = round((gyro.turns * 360 / abs(rate) + 1) * gyro.output_hz)
        true = rate * (1 + gyro.irreproducible * rng.normal())
        angle = np.deg2rad(true) * np.arange(count + 1) / gyro.output_hz + rng.uniform(0, 2 * np.pi)
        body = np.empty((3, count))
        body[turned] = true + VERTICAL
        body[(turned + 1) % 3] = HORIZONTAL * np.diff(np.sin(angle)) / np.diff(angle)
        body[(turned + 2) % 3] = -HORIZONTAL * np.diff(np.cos(angle)) / np.diff(angle)
        noise = np.array([self._white(count) for _ in range(3)])
        wander = rng.normal(0, gyro.instability_dph / 3600, (3, 1))
        self.now += count + round(SETTLE_S * gyro.output_hz)
        return np.asarray(matrix @ body + K * (noise + wander))

    def log(self, name: str, columns: Mapping[str, Floats]) -> None:
        """Write a log with what its recorder does to it: lost rows, spikes, rounded stamps."""
        gyro, rng = self.gyro, self.rng
        count = len(next(iter(columns.values())))
        begin = self.now - round(SETTLE_S * gyro.output_hz) - count
        times = np.arange(count) / gyro.output_hz + (0.0 if gyro.begin_anew else 1000.0 + begin / gyro.output_hz)
        if gyro.stamps_s:
            times = np.floor(times / gyro.stamps_s + 1e-6) * gyro.stamps_s
        kept = rng.random(count) >= gyro.lost
        table = np.column_stack([times, *columns.values()])
        for _ in range(gyro.spikes):
            table[rng.integers(count), 1] += 1e6 * rng.choice([-1, 1])
        form = "%.3f" + ",%.9g" * len(columns)
        text = "\n".join(form % tuple(row) for row in table[kept].tolist())
        (self.folder / name).write_text(f"{','.join(['time_s', *columns])}\n{text}\n", "utf-8")

    def _north(self, turning: float, count: int) -> Floats:
        """Mean of the cosine of the azimuth over each word."""
        angle = np.deg2rad(turning) / self.gyro.output_hz * np.arange(count + 1)
        start = self.rng.uniform(0, 2 * np.pi)
        if not turning:
            return np.full(count, np.cos(start))
        return np.asarray(np.diff(np.sin(angle + start)) / np.diff(angle))

    def _white(self, count: int) -> Floats:
        gyro, margin = self.gyro, self.gyro.filter_words - 1
        noise = self.rng.normal(0, gyro.walk / 60 * np.sqrt(gyro.output_hz), count + margin)
        if margin:
            noise = np.convolve(noise, np.full(gyro.filter_words, 1 / gyro.filter_words), "valid")
        return np.asarray(noise)
