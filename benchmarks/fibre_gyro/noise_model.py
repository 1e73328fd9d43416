"""`python -m benchmarks.fibre_gyro.noise_model`: the noise model of `gyrolock fog allan` beside its bound.

131 072 words at 10 Hz of a gyro with N = 0.005 deg/sqrt(h), K = 2e-6 deg/s/sqrt(s), Q = 2e-5 deg, made here. The
bound is that of Cramer and Rao, from the spectrum as written out here. "Slopes": the rule of common scripts, a
line of the term's slope through the point of the Allan deviation whose local slope is nearest to it. The last
line is the time of a million words.
"""

from __future__ import annotations

import argparse
import sys
import time

import allantools
import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import fit_noise

Floats = NDArray[np.float64]

COUNT, INTERVAL = 131_072, 0.1
N, K, Q = 0.005 / 60, 2e-6, 2e-5
NAMES = ("angle_random_walk", "rate_random_walk", "quantization")
TRUTH = np.array([N, K, Q])


def words(rng: np.random.Generator, count: int) -> Floats:
    """Words: white noise, a random walk averaged over each word, white noise of the angle at its ends."""
    steps = rng.normal(size=count) * K * np.sqrt(INTERVAL)
    within = rng.normal(size=count) * K * np.sqrt(INTERVAL / 12)
    level = np.concatenate([[0.0], np.cumsum(steps)])[:-1] + steps / 2 + within
    angle = rng.normal(0, Q, count + 1)
    return np.asarray(rng.normal(0, N / np.sqrt(INTERVAL), count) + level + np.diff(angle) / INTERVAL)


def bound() -> Floats:
    """Smallest standard deviation that an unbiased estimate can have, relative to each of N, K, Q."""
    omega = (np.arange(COUNT // 2) + 0.5) * 2 * np.pi / COUNT
    square = 2 - 2 * np.cos(omega)
    parts = np.array(
        [N**2 / INTERVAL * square, K**2 * INTERVAL * (2 + np.cos(omega)) / 3, Q**2 / INTERVAL**2 * square**2]
    )
    shares = parts / parts.sum(axis=0)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(shares @ shares.T))) / 2)


def by_slopes(values: Floats) -> Floats:
    """N, K and Q as common scripts read them off the Allan deviation."""
    steps = np.unique(np.geomspace(1, COUNT // 9, 100).round().astype(int))
    tau, deviation, _, _ = allantools.oadev(values, rate=1 / INTERVAL, data_type="freq", taus=steps * INTERVAL)
    x, y = np.log10(tau), np.log10(deviation)
    slopes = np.diff(y) / np.diff(x)
    found = []
    for slope, at in ((-0.5, 1.0), (0.5, 3.0), (-1.0, np.sqrt(3.0))):
        place = int(np.argmin(np.abs(slopes - slope)))
        found.append(10 ** (y[place] - slope * x[place] + slope * np.log10(at)))
    return np.array(found)


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; 0 if bias, spread, coverage and time are as they should be."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fibre_gyro.noise_model", description=__doc__)
    parser.add_argument("--trials", type=int, default=200)
    options = parser.parse_args(arguments)
    ours, spread, inside, others = [], [], [], []
    for seed in range(options.trials):
        values = words(np.random.default_rng(seed), COUNT)
        fit = fit_noise(values, INTERVAL)
        ours.append([fit.coefficients.get(name, 0.0) for name in NAMES])
        spread.append([fit.coefficients_u.get(name, np.nan) for name in NAMES])
        inside.append([fit.low_95[n] <= t <= fit.high_95[n] for n, t in zip(NAMES, TRUTH, strict=True)])
        others.append(by_slopes(values))
    relative, u = np.array(ours) / TRUTH - 1, np.nanmean(np.array(spread) / TRUTH, axis=0)
    bias, deviation, least = relative.mean(axis=0) / u, relative.std(axis=0, ddof=1), bound()
    out = sys.stdout.write
    out("| | bias, u | sd, % | bound, % | sd/bound | u stated, % | 95 % holds, % | slopes: off, % | sd, % |\n")
    out("|---|---|---|---|---|---|---|---|---|\n")
    read = np.array(others) / TRUTH - 1
    for place, name in enumerate(("N", "K", "Q")):
        out(f"| {name} | {bias[place]:+.2f} | {100 * deviation[place]:.2f} | {100 * least[place]:.2f} ")
        out(f"| {deviation[place] / least[place]:.2f} | {100 * u[place]:.2f} ")
        out(f"| {100 * np.mean(inside, axis=0)[place]:.1f} ")
        out(f"| {100 * read[:, place].mean():+.0f} | {100 * read[:, place].std():.0f} |\n")
    began = time.process_time()
    fit_noise(words(np.random.default_rng(1), 1_000_000), INTERVAL)
    seconds = time.process_time() - began
    out(f"\na million words: {seconds:.1f} s of one core\n")
    slack = 4 / np.sqrt(options.trials)
    return 0 if np.all(np.abs(bias) < 0.1 + slack) and np.all(deviation < (1.1 + slack) * least) else 1


if __name__ == "__main__":
    sys.exit(main())
