"""`python -m benchmarks.dithered`: the lock-in rate of single records of dithered gyros, integrated in time.

Lock-in rates of 0.02 to 0.2 deg/s, dithers of 50 to 150 deg/s at 300 to 600 Hz whose amplitude breathes by 2 %
from period to period, bias of -2 to 2 deg/s, gain corners of 2 to 30 kHz that the light follows (2.12), receivers
of 3 to 10 times the fastest beat, eight bits. Printed for each length of the record in dither periods: how many
give a number without a doubt, their coverage, the rms of error over u, and over the bound of Cramér and Rao for
this laser, the median u, and the largest error over u.

`--hours 40` counts the pulses of so many hours instead, every turning point a step of the phase: the random walk
in counts of a second, its u, the lock-in rate by it over the true one, and how many intervals hold that.
"""

from __future__ import annotations

import argparse
import math
import sys

import numpy as np
from scipy.interpolate import CubicSpline

from analysis.arrays import Floats, Ints
from analysis.dithered import DitherFlag, dithered_bound, estimate_dithered, lock_in_of_random_walk, walk_of_counts

K, SAMPLES, FINER, NOISE, FILL, BREATH = 2000.0, 2500, 8, 0.6, 90, 0.02
FASTEST = 0.38  # beats in a sample
LENGTHS = (0.6, 1.0, 1.5, 2.0, 3.0, 6.0, 12.0)


def records(
    rng: np.random.Generator, count: int, periods: float, dither: float
) -> tuple[Floats, Floats, float, Floats]:
    """Volts (count, SAMPLES), true lock-in rates, sample interval, bounds: fourth-order Runge and Kutta."""
    step = periods / dither / SAMPLES / FINER
    most = min(150.0, FASTEST / (step * FINER) / K - 2)
    swing, bias = rng.uniform(min(50.0, most), most, count), rng.uniform(-2, 2, count)
    true, phase = np.exp(rng.uniform(math.log(0.02), math.log(0.2), count)), rng.uniform(0, 2 * np.pi, count)
    begin, starts = rng.uniform(0, 2 * np.pi, (2, count))
    psi = starts
    knots = (np.arange(math.ceil(periods) + 4) - 2) / dither
    breath = CubicSpline(knots, 1 + BREATH * rng.standard_normal((knots.size, count)))

    def turning(time: float) -> Floats:
        return np.asarray(
            2 * np.pi * K * (bias + swing * breath(time) * np.cos(2 * np.pi * dither * time + begin))
        )

    gain = 2 * np.pi * np.exp(rng.uniform(math.log(2e3), math.log(3e4), count))
    kept = np.exp(-2 * np.pi * rng.uniform(3, 10, count) * K * most * step)
    pull, seen, after = 2 * np.pi * K * true, np.empty((count, SAMPLES)), turning(0.0)
    light, behind = np.zeros(count), np.sin(psi)
    for number in range(SAMPLES * FINER):
        volts = (1 + light) * np.sin(psi) + 0.003 * np.cos(2 * psi)
        behind = volts + (behind - volts) * kept
        light += step * (pull * np.cos(psi + phase) - gain * light)
        if number % FINER == 0:
            seen[:, number // FINER] = behind
        before, middle, after = after, turning((number + 0.5) * step), turning((number + 1) * step)
        one = before - pull * np.sin(psi + phase)
        two = middle - pull * np.sin(psi + step / 2 * one + phase)
        three = middle - pull * np.sin(psi + step / 2 * two + phase)
        four = after - pull * np.sin(psi + step * three + phase)
        psi = psi + step / 6 * (one + 2 * two + 2 * three + four)
    middle = begin + np.pi * periods  # phase of the dither there
    # rounding to codes is noise of a twelfth of a squared level
    bench = {"scale_factor": K, "dither_frequency": dither, "sample_interval": step * FINER, "n_samples": SAMPLES}
    bounds = [
        dithered_bound(
            wl * np.exp(1j * b), rate * np.exp(1j * turn), noise=math.hypot(NOISE, 12**-0.5) / FILL,
            bias=w0, start=first, gain_corner=g / 2 / math.pi, **bench,
        )
        for wl, b, rate, turn, w0, first, g in zip(true, phase, swing, middle, bias, starts, gain, strict=True)
    ]  # fmt: skip
    return (
        np.round(FILL * seen + NOISE * rng.standard_normal(seen.shape)) / FILL,
        true,
        step * FINER,
        np.array(bounds),
    )


def hour_of_counts(rng: np.random.Generator, k: float, true: float, rate: float, seconds: int = 3600) -> Ints:
    """Counts of gates of a second, (seconds,), of a dither whose amplitude differs from turning to turning."""
    frequency = int(rng.integers(300, 600))
    turnings = 2 * frequency * seconds
    bend = 4 * np.pi**2 * k * frequency * rate * (1 + 0.1 * rng.standard_normal(turnings)).clip(0.3)
    steps = k * true * np.sqrt(2 * np.pi / bend) * np.cos(rng.uniform(0, 2 * np.pi, turnings))
    phase = np.cumsum(steps)[2 * frequency - 1 :: 2 * frequency] + rng.uniform()
    drift = k * rng.uniform(-0.004, 0.004)
    return np.diff(np.floor(phase + drift * np.arange(1, seconds + 1)), prepend=0.0).astype(np.int64)


def _print_walks(rng: np.random.Generator, hours: int) -> None:
    heads = ("walk, counts", "u/walk", "found/true", "walks")
    sys.stdout.write("".join(f"{head:>14s}" for head in heads) + "\n")
    held = 0
    for _ in range(hours):
        k, true = np.exp(rng.uniform(np.log([500, 0.015]), np.log([5000, 0.2])))
        rate = rng.uniform(50, 150)
        found = walk_of_counts(hour_of_counts(rng, k, true, rate), 1.0, scale_factor=k)
        per_walk = lock_in_of_random_walk(1.0, scale_factor=k, dither_rate=rate)
        held += found.random_walk_low_95 <= true / per_walk <= found.random_walk_high_95
        share = found.random_walk_u / found.random_walk
        walk, right = k * true / per_walk, per_walk * found.random_walk / true
        sys.stdout.write(f"{walk:14.3f}{share:14.3f}{right:14.3f}{found.walks!s:>14s}\n")
        sys.stdout.flush()
    sys.stdout.write(f"intervals that hold the true lock-in rate: {held} of {hours}\n")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--hours", type=int, default=0)
    asked = parser.parse_args()
    rng = np.random.default_rng(asked.seed)
    if asked.hours:
        _print_walks(rng, asked.hours)
        return
    heads = ("periods", "usable", "covered", "error/u", "error/bound", "u, deg/s", "worst/u")
    sys.stdout.write("".join(f"{head:>12s}" for head in heads) + "\n")
    for periods in LENGTHS:
        dither = float(rng.uniform(300, 600))
        volts, true, interval, bounds = records(rng, asked.records, periods, dither)
        each = estimate_dithered(
            volts, interval, scale_factor=K, dither_frequency=dither * rng.uniform(0.99, 1.01)
        )
        usable = (each.flags & ~int(DitherFlag.NOT_SIGNIFICANT)) == 0
        off = ((each.lock_in_rate - true) / each.lock_in_rate_u)[usable]
        held = ((each.lock_in_rate_low_95 <= true) & (true <= each.lock_in_rate_high_95))[usable]
        cells = (
            periods,
            float(usable.mean()),
            float(held.mean()),
            math.sqrt(float(np.mean(off**2))),
            math.sqrt(float(np.mean(((each.lock_in_rate - true) / bounds)[usable] ** 2))),
            float(np.median(each.lock_in_rate_u[usable])),
            float(np.max(np.abs(off))),
        )
        sys.stdout.write("".join(f"{cell:12.3g}" for cell in cells) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
