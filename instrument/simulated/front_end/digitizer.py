"""The codes of a record: samples each channel of a completed acquisition when somebody asks for it."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from instrument.facts import NO_DATA, POINTS, POINTS_PER_DIVISION
from instrument.simulated.front_end.acquisition import Record
from instrument.simulated.front_end.frontend import (
    Codes,
    Floats,
    Signal,
    convert,
    gain,
    levels_per_volt,
    mean_shown,
    shown_smooth,
    shown_volts,
)
from instrument.simulated.front_end.smooth import tells_its_noise
from instrument.simulated.panel.panel import ChannelSettings

_PEAK_RATE = 100e6  # S/s at which Peak Detect looks for the smallest and the largest sample
_PEAK_TIME_CONSTANT = 1 / (2 * math.pi * 75e6)  # s, bandwidth of Peak Detect, user manual p. 151
_MOST_PEAK_SAMPLES = 64  # a pair
_LINES = 8  # straight ones between two points that tell all about the smooth part
_FEW_NEW = 3  # acquisitions of an average that are added to the mean of the others
_KEPT = 16  # records by channel


class Digitizer:
    """Turns records into codes; the same record gives the same codes every time."""

    def __init__(self, signal: Callable[[str], Signal], noise_levels: float, seed: int) -> None:
        self._signal, self._noise_levels, self._seed = signal, noise_levels, seed
        self._averaged: dict[str, tuple[tuple[float, ChannelSettings], dict[float, Floats]]] = {}
        self._means: dict[str, tuple[tuple[float, ChannelSettings, int], tuple[float, ...], Floats]] = {}
        self._kept: OrderedDict[tuple[int, float, str], Codes] = OrderedDict()

    def codes(self, record: Record, name: str) -> Codes:
        """Codes of one channel of a record."""
        channel = record.channels.get(name)
        if channel is None:
            return np.full(POINTS, NO_DATA, dtype=np.int8)
        key = (record.number, record.until, name)
        codes = self._kept.get(key)
        if codes is None:
            codes = self._kept[key] = self._digitize(record, name, channel)
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return codes

    def _digitize(self, record: Record, name: str, channel: ChannelSettings) -> Codes:
        if record.rolling:
            return self._scan(record, name, channel)
        if record.mode == "PEAKDETECT":
            return self._peaks(record, name, channel)
        count = len(record.starts)
        noise = self._noise(record.number, name, POINTS) / np.sqrt(count)
        if count > 1:
            signal = self._signal(name)
            mean = self._smooth_mean(record, name, channel)
            if mean is not None and tells_its_noise(signal):
                # the noise of the signal and that of the scope in one
                levels = signal.noise_rms * abs(gain(channel)) * levels_per_volt(channel) / np.sqrt(count)
                noise = noise + levels * self._rng(record.number, name, 1).standard_normal(POINTS)
                return convert(mean, channel, noise)
        return convert(self._mean(record, name, channel), channel, noise)

    def _smooth_mean(self, record: Record, name: str, channel: ChannelSettings) -> Floats | None:
        """Mean volts of the acquisitions of a record without noise: that of before, and what is new of it.

        None where it takes a look at each of them.
        """
        times = record.xincr * np.arange(POINTS, dtype=np.float64)
        signal, settings = self._signal(name), (record.xincr, channel, len(record.starts))
        before = self._means.get(name)
        if before is not None and before[0] == settings:
            come = set(record.starts).difference(before[1])
            gone = set(before[1]).difference(record.starts)
            if len(come) <= _FEW_NEW:

                def look(start: float) -> Floats:
                    return shown_smooth(signal, channel, start + times)

                change = sum(map(look, come)) - sum(map(look, gone))
                mean = before[2] + change / len(record.starts)
                self._means[name] = settings, record.starts, mean
                return mean
        found = mean_shown(signal, channel, np.array(record.starts), times)
        if found is not None:
            self._means[name] = settings, record.starts, found
        return found

    def _mean(self, record: Record, name: str, channel: ChannelSettings) -> Floats:
        """Mean volts of the acquisitions of a record; those that the last average had, too, are kept."""
        times = record.xincr * np.arange(POINTS, dtype=np.float64)
        signal = self._signal(name)
        if len(record.starts) == 1:
            return shown_volts(signal, channel, record.starts[0] + times)
        settings = (record.xincr, channel)
        known, looks = self._averaged.get(name, (settings, {}))
        if known != settings:
            looks = {}
        looks = {
            start: looks[start] if start in looks else shown_volts(signal, channel, start + times)
            for start in record.starts
        }
        self._averaged[name] = settings, looks
        return np.asarray(np.mean(list(looks.values()), axis=0))

    def _peaks(self, record: Record, name: str, channel: ChannelSettings) -> Codes:
        """Pairs of the smallest and the largest sample of two intervals, p. 2-250."""
        samples = min(_MOST_PEAK_SAMPLES, max(2, round(2 * record.xincr * _PEAK_RATE)))
        count = POINTS // 2 * samples
        slower = replace(channel, time_constant=max(channel.time_constant, _PEAK_TIME_CONSTANT))
        # irregular sampling, so that no frequency hides between the samples of a slow sweep
        rng = np.random.default_rng([self._seed, record.number])
        irregular = rng.random(count, dtype=np.float32)
        step = 2 * record.xincr / samples
        signal = self._signal(name)
        start, smooth = record.starts[-1], 0.0
        if tells_its_noise(signal) and (smooth := signal.interval(start, start + count * step)) > step:
            # nothing hides: straight lines, and both noises in one
            together = _samples_a_line(samples, smooth / step)
            edges = shown_smooth(signal, slower, start + together * step * np.arange(count // together + 1.0))
            edges = edges.astype(np.float32)
            places = (irregular.reshape(-1, together) + np.arange(together, dtype=np.float32)) / together
            volts = (edges[:-1, np.newaxis] + np.diff(edges)[:, np.newaxis] * places).ravel()
            rms = float(
                np.hypot(self._noise_levels, signal.noise_rms * abs(gain(channel)) * levels_per_volt(channel))
            )
            noise = np.float32(rms) * self._rng(record.number, name).standard_normal(count, dtype=np.float32)
        else:
            volts = shown_volts(signal, slower, start + step * (np.arange(count, dtype=np.float64) + irregular))
            noise = self._noise(record.number, name, count)
        levels = (volts * levels_per_volt(channel) + noise).reshape(-1, samples)
        ends = np.stack([levels.min(axis=1), levels.max(axis=1)], axis=1).ravel()
        return convert(ends / levels_per_volt(channel), channel)

    def _scan(self, record: Record, name: str, channel: ChannelSettings) -> Codes:
        """The rolling record at one moment: new samples up to the blank, old ones behind it."""
        codes = np.full(POINTS, NO_DATA, dtype=np.int8)
        taken = int((record.until - record.starts[0]) / record.xincr)  # samples since the scan began
        if taken <= 0:
            return codes
        first = max(0, taken - POINTS)
        indices = np.arange(first, taken)
        times = record.starts[0] + record.xincr * indices.astype(np.float64)
        volts = shown_volts(self._signal(name), channel, times)
        sweeps = [self._noise(record.number, name, POINTS, s) for s in (first // POINTS, first // POINTS + 1)]
        noise = np.concatenate(sweeps)[first % POINTS :][: len(indices)]
        codes[indices % POINTS] = convert(volts, channel, noise)
        if taken % POINTS or taken < POINTS:
            codes[np.arange(taken, taken + POINTS_PER_DIVISION) % POINTS] = NO_DATA
        return codes

    def _noise(self, number: int, name: str, count: int, sweep: int = 0) -> Floats:
        return self._noise_levels * self._rng(number, name, sweep).standard_normal(count)

    def _rng(self, number: int, name: str, sweep: int = 0) -> np.random.Generator:
        return np.random.default_rng([self._seed, number, int(name.removeprefix("CH")), sweep])


def _samples_a_line(samples: int, smooth: float) -> int:
    """Samples of a pair on one straight line: a divisor of all, with several lines in an interval `smooth`."""
    divisors = (many for many in range(1, samples + 1) if samples % many == 0)
    return max(many for many in divisors if many == 1 or many * _LINES <= smooth)
