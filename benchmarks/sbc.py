"""`python -m benchmarks.sbc`: is the interval of a whole run right over all benches that the settings allow?

Simulation-based calibration: every unknown of a bench is drawn from what is stated of it, or from its bound where
nothing is; its records are made (beat, gain saturation, distortion, one pole, noise, rounding) and evaluated as
`gyrolock measure` does. Then the place of the true lock-in rate in the answer is uniform: the Kolmogorov-Smirnov
test says with which chance, beside pull (rms of error over u), coverage of the 95 % interval and doubtful results.

`--drift` lets phase and lock-in rate go by so much of their bounds (1) over each run.
"""

from __future__ import annotations

import argparse
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.special
import scipy.stats

from analysis.budget import BenchKnowledge, ResponseCorner
from analysis.budget.bench import (
    LOCK_IN_DRIFT_LIMIT,
    PHASE_CHANGE_LIMIT,
    SECOND_ORDER_LIMIT,
    THIRD_ORDER_LIMIT,
    lowest_bandwidth,
    lowest_gain_corner,
)
from analysis.flags import DOUBTFUL
from analysis.lock_in_run import AxisRates, Batch, Method, RecordArrays, RunArrays, RunKnowledge, evaluate
from analysis.plan import default_rates, run_order
from analysis.ring_laser import Detector, Gyro, Winking, detector_signal

K, WL, SAMPLES, PERIODS = 2000.0, 0.01, 2500, 20.3
LATITUDE, NOISE, LEVEL = 28.2, 0.01, 0.01
SCALE_FACTOR_U_PPM, TIME_BASE_PPM, STATED_HZ = 50.0, 50.0, 30e3


@dataclass(frozen=True)
class Plan:
    """Rates in lock-in rates, signed; records at each; and whether the corner of the channel is stated."""

    rates: tuple[float, ...]
    records: int
    stated: bool = True


DEFAULT = default_rates(WL, K)
PLANS = {
    "default run": Plan((*DEFAULT, *(-rate for rate in DEFAULT)), 4),
    "one sense": Plan(DEFAULT, 8),
    "two rates in both senses": Plan((3.0, 10.0, -3.0, -10.0), 8),
    "two rates in one sense": Plan((3.0, 30.0), 8),
    "one rate in both senses": Plan((8.0, -8.0), 20),
    "channel unstated": Plan((*DEFAULT, *(-rate for rate in DEFAULT)), 4, stated=False),
}


@dataclass(frozen=True)
class Outcome:
    """One bench: error over u, place of the truth in the answer, coverage, relative u, doubt."""

    pull: float
    place: float
    covered: bool
    relative_u: float
    doubtful: bool


def outcome(plan: Plan, drift: float, seed: int) -> Outcome:
    """Draw a bench, take its run, evaluate it."""
    rng = np.random.default_rng(seed)
    slowest = K * WL * math.sqrt(min(abs(rate) for rate in plan.rates) ** 2 - 1)
    longest = 1 / (2 * np.pi * (STATED_HZ if plan.stated else lowest_bandwidth(slowest)))
    pole = 1 / (2 * np.pi * longest * math.sqrt(rng.uniform(1e-6, 1)))  # P = tau^2 is what is bounded
    gain_hz = lowest_gain_corner(slowest) / rng.uniform(1e-3, 1)
    true_k = K * (1 + 1e-6 * SCALE_FACTOR_U_PPM * rng.normal())
    stretch = 1 + 1e-6 * rng.uniform(-TIME_BASE_PPM, TIME_BASE_PPM)
    second, third = rng.uniform(-SECOND_ORDER_LIMIT, SECOND_ORDER_LIMIT), rng.uniform(-1, 1) * THIRD_ORDER_LIMIT
    phases = drift * PHASE_CHANGE_LIMIT * rng.uniform(-1, 1, 2)
    grows = drift * LOCK_IN_DRIFT_LIMIT * rng.uniform(-1, 1)
    start, readout = rng.uniform(0, 2 * np.pi, 2)

    visits = run_order(plan.rates)
    shared = {rate for rate, again in visits if again}
    rates = [rate * WL for rate, _ in visits for _ in range(plan.records // (2 if rate in shared else 1))]
    batches = []
    for row, rate in enumerate(rates):
        when = row / (len(rates) - 1) - 0.5
        phase = readout + phases[0] * math.copysign(0.5, rate) + phases[1] * when
        then = WL * (1 + grows * when)
        winking = Winking(true_k, then, gain_hz)
        gyro = Gyro(true_k, then, phase, 0.0, 0.0, winking=winking)
        seen = Detector(start, second_order=2 * second, third_order=4 * third, low_pass_hz=pole)
        beat = true_k * math.sqrt(rate**2 - then**2) * float(winking.frequency_factor(np.array([abs(rate)]))[0])
        interval = PERIODS / (K * math.sqrt(rate**2 - WL**2)) / SAMPLES
        turns = beat * stretch * interval * np.arange(SAMPLES)
        turning = rng.uniform(0, 2 * np.pi) + 2 * np.pi * math.copysign(1.0, rate) * turns
        volts = detector_signal(gyro, seen, np.full(SAMPLES, rate), turning) + NOISE * rng.normal(size=SAMPLES)
        seen_by_scope = LEVEL / math.hypot(1.0, beat / pole)  # what is weaker behind the pole is shown larger
        volts = np.rint(volts / seen_by_scope) * seen_by_scope
        clipped = np.zeros((1, 1, SAMPLES), dtype=bool)
        batches.append(Batch(np.array([row]), interval, volts[np.newaxis, np.newaxis], clipped))
    table = np.array(rates)
    unknown = np.full(table.size, np.nan)
    slow = RecordArrays(
        batches, 1, np.full(table.size, SAMPLES), np.full(table.size, LEVEL), table, unknown, unknown, unknown
    )
    nothing = RecordArrays([], 1, np.array([], dtype=int), *(np.array([]) for _ in range(5)))
    bandwidth = ResponseCorner(STATED_HZ if plan.stated else math.nan)
    coupled = ResponseCorner(0.0)  # DC
    bench = BenchKnowledge(SCALE_FACTOR_U_PPM, TIME_BASE_PPM, bandwidth=bandwidth, high_pass=coupled)
    knowledge = RunKnowledge(K, latitude_deg=LATITUDE, bench=bench)
    axis = AxisRates(table, np.zeros(table.size), np.zeros(table.size))
    found = evaluate(RunArrays(slow, nothing), knowledge, Method(K), axis=axis)
    low, high = found.interval_95
    pull = (WL - found.lock_in_rate) / found.lock_in_rate_u
    return Outcome(
        pull,
        float(scipy.special.ndtr(pull)),
        low <= WL <= high,
        found.lock_in_rate_u / WL,
        bool(int(found.combined.flags) & DOUBTFUL),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--benches", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--drift", type=float, default=1.0)
    parser.add_argument("--only", default="", metavar="TEXT")
    asked = parser.parse_args()
    sys.stdout.write(f"{'run':28s}{'pull':>6s}{'covered':>9s}{'u, %':>8s}{'doubtful':>10s}{'KS p':>8s}\n")
    with ProcessPoolExecutor() as workers:
        for name, plan in PLANS.items():
            if asked.only not in name:
                continue
            seeds = range(asked.seed * 100_000, asked.seed * 100_000 + asked.benches)
            found = list(workers.map(partial(outcome, plan, asked.drift), seeds))
            pull = math.sqrt(np.mean([each.pull**2 for each in found]))
            covered, doubtful = (np.mean([getattr(e, f) for e in found]) for f in ("covered", "doubtful"))
            u = 100 * np.median([each.relative_u for each in found])
            chance = scipy.stats.kstest([each.place for each in found], "uniform").pvalue
            row = f"{name:28s}{pull:6.2f}{covered:9.3f}{u:8.3f}{doubtful:10.3f}{chance:8.3f}\n"
            sys.stdout.write(row)
            sys.stdout.flush()


if __name__ == "__main__":
    main()
