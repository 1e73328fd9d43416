"""`python -m benchmarks.fibre_gyro.host_clock`: does the uncertainty of the gyro's clock hold?

Frames of a gyro are simulated one by one: handed over by a USB adapter every 16 ms or at once, read in slices of
20 ms, the computer stalling now and then. Printed for each output rate and length of recording: the uncertainty
that is stated, the error over it (root mean square and largest), and how often a clock that is right was called
wrong. Then rates that nearly keep step with the adapter's 16 ms, the clock off by up to 150 ppm: what the frames
drift against the adapter hardly shows.

    python -m benchmarks.fibre_gyro.host_clock --trials 40
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from numpy.typing import NDArray

from instrument.fibre_gyro import HostClock
from instrument.fibre_gyro.recording import Arrivals

Floats = NDArray[np.float64]

_SLICE_S = 0.02


def clock_of(
    rng: np.random.Generator,
    *,
    rate: float,
    seconds: float,
    off_ppm: float,
    latency: float = 0.0,
    stalls: float = 0.0,
    stall_at_end: bool = False,
) -> HostClock | None:
    """What is found of a gyro whose clock is fast by `off_ppm`.

    Parameters
    ----------
    latency : float
        A USB adapter hands over what it has every so often, s.
    stalls : float
        Chance of each read to be late by 0.1 s or so.
    """
    interval = 1 / (rate * (1 + 1e-6 * off_ppm))
    sent = np.arange(int(seconds / interval)) * interval + rng.uniform(0, 0.02)
    arrived = sent + rng.exponential(3e-4, sent.size)
    if latency:
        arrived = np.ceil(arrived / latency) * latency + rng.exponential(2e-4, sent.size)
    arrived = np.maximum.accumulate(arrived)
    arrivals, now, place = Arrivals(), 0.0, 0
    while place < sent.size:
        now += _SLICE_S + rng.exponential(1.5e-4)
        if rng.random() < stalls:
            now += rng.exponential(0.1)
        if stall_at_end and now > seconds - 0.6:
            now += 0.5
        behind = int(np.searchsorted(arrived, now, side="right"))
        if behind > place:
            arrivals.add(behind - 1, now)
            place = behind
    return arrivals.clock(1 / rate)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=40)
    trials = parser.parse_args().trials
    rng = np.random.default_rng(1)
    lines = [
        "| frames/s | s | u, ppm | with an adapter | error/u, rms | largest | called wrong |",
        "|---|---|---|---|---|---|---|",
    ]
    for rate in (10.0, 100.0, 1000.0):
        for seconds in (5, 60):
            pulls: list[float] = []
            u: dict[float, list[float]] = {0.0: [], 0.016: []}
            wrong = 0
            for trial in range(trials):
                for latency in u:
                    off = (0.0, 0.0, 21_000.0, -28_000.0)[trial % 4]
                    stalls = 0.01 * (trial % 2)
                    found = clock_of(rng, rate=rate, seconds=seconds, off_ppm=off, latency=latency, stalls=stalls)
                    if found is None:
                        continue
                    pulls.append((found.difference_ppm - off) / found.u_ppm)
                    u[latency].append(found.u_ppm)
                    wrong += off == 0 and found.used
            middle = [float(np.median(of)) for of in u.values()]
            lines.append(
                f"| {rate:g} | {seconds} | {middle[0]:.0f} | {middle[1]:.0f} | {_rms(np.array(pulls)):.2f} | "
                f"{np.abs(pulls).max():.2f} | {wrong} of {trials} |"
            )
    lines += [
        "",
        "| frames/s, in step | s | error, ppm, rms | u, ppm | error/u, rms | largest |",
        "|---|---|---|---|---|---|",
    ]
    for rate in (62.5, 125.0, 250.0, 500.0):
        for seconds in (20, 60):
            errors, stated = in_step(rng, rate=rate, seconds=seconds, trials=trials)
            pull = errors / stated
            lines.append(
                f"| {rate:g} | {seconds} | {_rms(errors):.0f} | {np.median(stated):.0f} | {_rms(pull):.2f} | "
                f"{np.abs(pull).max():.2f} |"
            )
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


def in_step(rng: np.random.Generator, *, rate: float, seconds: float, trials: int) -> tuple[Floats, Floats]:
    """Errors and stated uncertainties, ppm, of clocks off by up to 150 ppm, behind an adapter's 16 ms; (n,)."""
    rows = []
    for off in rng.uniform(-150, 150, trials):
        found = clock_of(rng, rate=rate, seconds=seconds, off_ppm=off, latency=0.016)
        if found is not None:
            rows.append((found.difference_ppm - off, found.u_ppm))
    errors, stated = np.array(rows).T
    return errors, stated


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    sys.exit(main())
