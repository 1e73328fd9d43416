"""Records whose rate moves: time, error, coverage and flags of each class, beside a steady record and one rfft.

    python -m benchmarks.moving [RECORDS] [--seed S] [--bench]

The error is over the standard uncertainty of a steady record with the same noise; a random rate costs more than
that, since what it does at the frequency of the beat itself looks like lock-in. `--bench` takes the records of the
program's default bench instead, as many of each time base as it has, and shows what a mixture costs.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from analysis import estimate_lock_in, flag_names, rate_varying_beat
from analysis.arrays import Floats
from analysis.flags import Flag
from benchmarks.reanalysis.records import default_runs
from station.terminal import say

N, INTERVAL, K, WL, RATE = 2500, 2e-5, 2000.0, 0.02, 0.3
AMPLITUDE, NOISE, HIGHEST = 90.0, 1.2, 127
TIMES = (np.arange(N - 1) + 0.5) / N
BENCH_RUNS = 3

Motion = Callable[[np.random.Generator, int], Floats]
"""Relative changes of the rate in every step, (R, N - 1)."""


def ripple(size: float, cycles: float) -> Motion:
    """A sine of any phase."""
    return lambda rng, count: size * np.sin(2 * np.pi * (cycles * TIMES + rng.uniform(0, 1, (count, 1))))


def wander(size: float, memory: float) -> Motion:
    """Noise of the rate that is forgotten after so many samples."""

    def motion(rng: np.random.Generator, count: int) -> Floats:
        from scipy.signal import lfilter

        keep = np.exp(-1 / memory)
        noise = rng.standard_normal((count, N - 1)) * np.sqrt(1 - keep**2)
        noise[:, 0] /= np.sqrt(1 - keep**2)
        return np.asarray(size * lfilter([1.0], [1.0, -keep], noise, axis=1))

    return motion


def step(size: float) -> Motion:
    """Another rate from somewhere inside on."""
    return lambda rng, count: size * (rng.uniform(0.25, 0.75, (count, 1)) < TIMES)


CLASSES: dict[str, tuple[Motion, float, float]] = {
    # motion, amplitude in levels, drift of the amplitude
    "steady": (ripple(0.0, 1.0), AMPLITUDE, 0.0),
    "ripple 0.1 %, 1.5 cycles": (ripple(1e-3, 1.5), AMPLITUDE, 0.0),
    "ripple 1 %, 1.5 cycles": (ripple(1e-2, 1.5), AMPLITUDE, 0.0),
    "ripple 3 %, 8 cycles": (ripple(3e-2, 8.0), AMPLITUDE, 0.0),
    "wander 0.03 %": (wander(3e-4, 500.0), AMPLITUDE, 0.0),
    "wander 0.1 %": (wander(1e-3, 500.0), AMPLITUDE, 0.0),
    "wander 1 %": (wander(1e-2, 500.0), AMPLITUDE, 0.0),
    "wander 3 %": (wander(3e-2, 500.0), AMPLITUDE, 0.0),
    "slow wander 1 %": (wander(1e-2, 5000.0), AMPLITUDE, 0.0),
    "quick wander 1 %": (wander(1e-2, 50.0), AMPLITUDE, 0.0),
    "step of 2 %": (step(0.02), AMPLITUDE, 0.0),
    "clipped, wander 1 %": (wander(1e-2, 500.0), 150.0, 0.0),
    "amplitude drifts 20 %, wander 1 %": (wander(1e-2, 500.0), AMPLITUDE, 0.2),
}


def codes_of(rng: np.random.Generator, name: str, count: int) -> Floats:
    """Records (count, N) of a class."""
    motion, amplitude, drift = CLASSES[name]
    beat = rate_varying_beat(
        RATE * (1 + motion(rng, count)),
        INTERVAL,
        scale_factor=K,
        lock_in_rate=np.full(count, WL),
        initial_phase=rng.uniform(0, 2 * np.pi, count),
        backscatter_phase=0.6,
    )
    beat *= amplitude * (1 + drift * np.linspace(-1, 1, N))
    return np.clip(np.round(beat + NOISE * rng.standard_normal(beat.shape)), -HIGHEST, HIGHEST)


def seconds(work: Callable[[], object]) -> float:
    """Processor time of a piece of work."""
    begun = time.process_time()
    work()
    return time.process_time() - begun


def bench_codes(folder: str) -> dict[float, Floats]:
    """Records of each sampling interval from some runs of the default bench."""
    from instrument.waveform import Preamble

    found: dict[float, list[Floats]] = {}
    for run in default_runs(Path(folder), BENCH_RUNS):
        for record in run.records():
            if record.purpose == "measure":
                interval = Preamble.parse(record.header).xincr
                found.setdefault(interval, []).append(np.frombuffer(record.payload, dtype=np.int8).astype(float))
    return {interval: np.array(codes, dtype=np.float64) for interval, codes in found.items()}


def report_bench(records: int, of_steady: float) -> None:
    """What a mixture of records costs."""
    with tempfile.TemporaryDirectory() as folder:
        groups = bench_codes(folder)
    kinds = sum(map(len, groups.values()))
    groups = {interval: np.tile(codes, (max(records // kinds, 1), 1)) for interval, codes in groups.items()}
    count, moving, spent = sum(map(len, groups.values())), 0, 0.0
    for interval, codes in groups.items():
        begun = time.process_time()
        found = estimate_lock_in(codes, interval, scale_factor=K)
        spent += time.process_time() - begun
        moving += np.count_nonzero(found.flags & int(Flag.RATE_WANDER))
    say(
        f"{count} records of the default bench, {moving / count:.0%} move: {1e6 * spent / count:.0f} us a record, "
        f"{spent / count / of_steady:.1f} times a steady one"
    )


def main() -> None:
    """Print a line for each class."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.moving")
    parser.add_argument("records", nargs="?", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--bench", action="store_true", help="records of the default bench")
    options = parser.parse_args()
    rng, count = np.random.default_rng(options.seed), options.records
    codes = codes_of(rng, "steady", max(count, 200))
    estimate_lock_in(codes, INTERVAL, scale_factor=K)
    of_fft = seconds(lambda: [np.fft.rfft(codes, axis=1) for _ in range(5)]) / 5 / len(codes)
    of_steady = seconds(lambda: estimate_lock_in(codes, INTERVAL, scale_factor=K)) / len(codes)
    bound = float(np.median(estimate_lock_in(codes, INTERVAL, scale_factor=K).lock_in_rate_u))
    say(f"{len(codes)} records; one rfft {1e6 * of_fft:.1f} us, a steady record {1e6 * of_steady:.1f} us")
    if options.bench:
        report_bench(count, of_steady)
        return
    say(f"{'class':34} {'ms':>7} {'/ steady':>8} {'error':>6} {'u':>6} {'covered':>8}  flags")
    for name in CLASSES:
        codes = codes_of(rng, name, count)
        begun = time.process_time()
        found = estimate_lock_in(codes, INTERVAL, scale_factor=K)
        spent = (time.process_time() - begun) / count
        error = np.sqrt(np.mean((found.lock_in_rate - WL) ** 2)) / bound
        inside = (found.lock_in_rate_low_95 <= WL) & (found.lock_in_rate_high_95 >= WL)
        flags = Counter(flag for one in found.flags for flag in flag_names(int(one)))
        told = ", ".join(f"{flag} {number}" for flag, number in flags.most_common())
        u = float(np.median(found.lock_in_rate_u)) / bound
        figures = f"{1e3 * spent:7.2f} {spent / of_steady:8.0f} {error:6.2f} {u:6.2f} {inside.mean():8.1%}"
        say(f"{name:34} {figures}  {told}")


if __name__ == "__main__":
    main()
