"""`python -m benchmarks.sbc`: is the interval of a whole run right over all benches that the settings allow?

Simulation-based calibration: every unknown of a bench is drawn from what is stated of it, or from its bound where
nothing is; its records are made (beat, gain saturation, distortion, one pole, noise, rounding) and evaluated as
`gyrolock measure` does. Then the place of the true lock-in rate in the answer is uniform: the Kolmogorov-Smirnov
test says with which chance, beside pull (rms of error over u) and coverage of the 95 % interval of all results but
those that call themselves doubtful, whose share is told too.

Backscatter may be 60 degrees apart and unequal up to 2.5 times, beams unequal by 10 %, the gain's dispersion 0.03.
Runs with beams are those of `benchmarks.beams`: lasers with any coupling, integrated in time.

`--drift` lets phase and lock-in rate go by so much of their bounds (1) over each run. `--faults` takes runs with
something wrong instead that nobody stated: of each kind how many miss without a word, by 1.96 and by 5 u.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import sys
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.special
import scipy.stats

from analysis.arrays import Complexes, Floats
from analysis.beam_swings import BeamsFlag
from analysis.budget import (
    LOCK_IN_DRIFT_LIMIT,
    PHASE_CHANGE_LIMIT,
    PROBE_HZ,
    SECOND_ORDER_LIMIT,
    THIRD_ORDER_LIMIT,
    BenchKnowledge,
    ResponseCorner,
    lowest_bandwidth,
    lowest_gain_corner,
)
from analysis.flags import DOUBTFUL
from analysis.lock_in_run import AxisRates, Batch, Method, RecordArrays, RunArrays, RunKnowledge, evaluate
from analysis.plan import default_rates, off_mains, run_order
from analysis.ring_laser import Detector, Gyro, Winking, detector_signal
from analysis.several_rates.laser_fit import BACKSCATTER
from benchmarks import beams

K, WL, SAMPLES, PERIODS, HUM_HZ = 2000.0, 0.01, 2500, 20.3, 50.0
LATITUDE, NOISE, LEVEL = 28.2, 0.01, 0.01
SCALE_FACTOR_U_PPM, TIME_BASE_PPM, STATED_HZ = 50.0, 50.0, 30e3
POINTS = 1024  # of a period, from which its harmonics are taken


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


WITH_BEAMS = {
    "with beams, both senses": "3 5 9 17 30, both senses",
    "with beams, one sense": "3 5 9 17 30, one sense",
    "with beams, few rates": "3 30, one sense",
    "with beams, one rate": "8, both senses",
}


Channel = Callable[[Floats], Complexes]
"""Gain at frequencies in Hz."""


@dataclass(frozen=True)
class Fault:
    """What is wrong with a run; sizes are drawn between two bounds, with either sign."""

    plan: str = "default run"
    between: tuple[float, float] | None = None  # phase between the senses, rad
    turns: tuple[float, float] = (0.0, 0.0)  # change of the phase over the run, rad
    grows: tuple[float, float] = (0.0, 0.0)  # change of WL over the run, relative
    channel: Callable[[np.random.Generator], Channel] | None = None  # instead of the stated pole
    hum: tuple[float, float] = (0.0, 0.0)  # harmonics of the mains, each over the beat
    shot_noise: bool = False
    fifth_order: tuple[float, float] = (0.0, 0.0)  # fifth harmonic that the receiver makes of a sine
    widths: tuple[float, float] = (0.0, 0.0)  # of the converter's codes, rms error in levels
    copies: int = 1  # of every record
    stated_tail: float = 0.0  # thermal tail that may be there, as it is stated


def _one_pole(corner: float) -> Channel:
    return lambda hz: np.asarray(1 / (1 + 1j * hz / corner), dtype=np.complex128)


def _probe(rng: np.random.Generator) -> Channel:
    """A 10X probe whose compensation is off by 2 to 10 %."""
    x = 1j / (PROBE_HZ * math.exp(rng.uniform(-0.3, 0.3)))
    off = 1 + _either(rng, (0.02, 0.1))
    return lambda hz: np.asarray((1 + off * x * hz) / (1 + x * hz), dtype=np.complex128)


def _tail(rng: np.random.Generator) -> Channel:
    """A thermal tail of 0.2 to 1 % after 0.3 to 3 ms."""
    x, size = 2j * np.pi * math.exp(rng.uniform(math.log(3e-4), math.log(3e-3))), _either(rng, (0.002, 0.01))
    return lambda hz: np.asarray(1 + size / (1 + x * hz))


def _two_poles(rng: np.random.Generator) -> Channel:
    """Poles at about 5 and 8 kHz."""
    first, second = np.array([5e3, 8e3]) * np.exp(rng.uniform(-0.2, 0.2, 2))
    return lambda hz: np.asarray(1 / ((1 + 1j * hz / first) * (1 + 1j * hz / second)))


FAULTS = {
    "0.05 rad between the senses, one rate": Fault("one rate in both senses", between=(0.05, 0.05)),
    "0.2 rad": Fault("one rate in both senses", between=(0.2, 0.2)),
    "1 rad": Fault("one rate in both senses", between=(1.0, 1.0)),
    "phase drifts by 0.5 to 2 rad": Fault(turns=(0.5, 2.0)),
    "WL drifts by 1 to 2 %": Fault(grows=(0.01, 0.02)),
    "WL drifts by 1 to 2 %, one sense": Fault("one sense", grows=(0.01, 0.02)),
    "10X probe off by 2 to 10 %": Fault(channel=_probe),
    "thermal tail of 0.2 to 1 %": Fault(channel=_tail),
    "the same, 1 % stated": Fault(channel=_tail, stated_tail=0.01),
    "poles at 5 and 8 kHz": Fault(channel=_two_poles),
    "hum of 0.2 to 2 %": Fault(hum=(0.002, 0.02)),
    "shot noise": Fault(shot_noise=True),
    "fifth order of 0.02 to 0.5 %": Fault(fifth_order=(2e-4, 5e-3)),
    "codes uneven by 0.05 to 0.3 levels": Fault(widths=(0.05, 0.3)),
    "every record ten times": Fault(copies=10),
}
"""Every kind that a bench may have and nobody states. All else is as in the calibration, drifts a tenth of it."""


@dataclass(frozen=True)
class Outcome:
    """One bench: error over u, place of the truth in the answer, coverage, relative u, doubt."""

    pull: float
    place: float
    covered: bool
    relative_u: float
    doubtful: bool


def outcome(plan: Plan, drift: float, fault: Fault | None, seed: int) -> Outcome:
    """Draw a bench, take its run, evaluate it."""
    rng = np.random.default_rng(seed)
    # a fault stands beside what is otherwise even
    bends = 0.0 if fault else drift * PHASE_CHANGE_LIMIT * float(np.random.default_rng((seed, 1)).uniform(-1, 1))
    fault = fault or Fault()
    slowest = K * WL * math.sqrt(min(abs(rate) for rate in plan.rates) ** 2 - 1)
    longest = 1 / (2 * np.pi * (STATED_HZ if plan.stated else lowest_bandwidth(slowest)))
    pole = 1 / (2 * np.pi * longest * math.sqrt(rng.uniform(1e-6, 1)))  # P = tau^2 is what is bounded
    gain_hz = lowest_gain_corner(slowest) / rng.uniform(1e-3, 1)
    true_k = K * (1 + 1e-6 * SCALE_FACTOR_U_PPM * rng.normal())
    stretch = 1 + 1e-6 * rng.uniform(-TIME_BASE_PPM, TIME_BASE_PPM)
    second, third = rng.uniform(-SECOND_ORDER_LIMIT, SECOND_ORDER_LIMIT), rng.uniform(-1, 1) * THIRD_ORDER_LIMIT
    between, turns = drift * PHASE_CHANGE_LIMIT * rng.uniform(-1, 1, 2) + (0, _either(rng, fault.turns))
    between = between if fault.between is None else _either(rng, fault.between)
    grows = drift * LOCK_IN_DRIFT_LIMIT * rng.uniform(-1, 1) + _either(rng, fault.grows)
    start, readout = rng.uniform(0, 2 * np.pi, 2)
    angle, logarithm, saturation = rng.uniform(*BACKSCATTER)
    imbalance, dispersion = rng.spawn(1)[0].uniform(-1, 1, 2) * (beams.IMBALANCE, beams.DISPERSION)
    receiver = Detector(start, second_order=2 * second, third_order=4 * third)
    channel: Channel = fault.channel(rng) if fault.channel else _one_pole(pole)
    hums = [_either(rng, fault.hum) * np.exp(2j * np.pi * rng.uniform()) for _ in range(6)]
    fifth = _either(rng, fault.fifth_order) if fault.fifth_order[1] else 0.0
    widths = _either(rng, fault.widths) * rng.normal(size=300)

    visits = run_order(plan.rates)
    shared = {rate for rate, again in visits if again}
    counts = [fault.copies * (plan.records // (2 if rate in shared else 1)) for rate, _ in visits]
    rates = [WL * rate + (_moved(rate) if fault.hum[1] else 0.0) for rate, _ in visits]
    when = np.arange(sum(counts)) / (sum(counts) - 1) - 0.5
    batches = []
    for rate, end, count in zip(rates, np.cumsum(counts), counts, strict=True):
        rows = np.arange(end - count, end)
        interval = _interval(rate)
        times = stretch * interval * np.arange(float(SAMPLES))
        records: list[Floats] = []
        for row in rows:
            if len(records) % fault.copies:
                records.append(records[-1])
                continue
            then = WL * (1 + grows * when[row])
            winking = Winking(true_k, then, gain_hz, angle, saturation, math.exp(logarithm), imbalance, dispersion)
            factor = float(winking.frequency_factor(np.array([rate]))[0])
            beat = true_k * math.sqrt(rate**2 - then**2) * factor
            level = LEVEL * abs(channel(np.array([beat]))[0])  # what is weaker behind the channel is shown larger
            phase = (
                readout
                + between * math.copysign(0.5, rate)
                + turns * when[row]
                + bends * (6 * when[row] ** 2 - 0.5)
            )
            gyro = Gyro(true_k, then, phase, 0.0, 0.0, winking=winking)
            turned = np.asarray(rng.uniform() + beat * times)
            seen = _signal(gyro, receiver, fifth, channel, rate, turned, beat)
            # the light of a beat is never less than nothing: half of the noise is that of a contrast of 0.9
            noise = NOISE * np.sqrt(1 + seen / 1.1) if fault.shot_noise else NOISE
            volts = np.asarray(seen + noise * rng.normal(size=SAMPLES))
            shift = rng.uniform(0, 1 / HUM_HZ)
            for order, hum in enumerate(hums, 1):
                volts += (hum * np.exp(2j * np.pi * order * HUM_HZ * (times + shift))).real
            records.append(level * _codes(volts / level, widths))
        batches.append(Batch(rows, interval, np.array([records]), np.zeros((1, count, SAMPLES), dtype=bool)))
    table = np.repeat(rates, counts)
    unknown = np.full(table.size, np.nan)
    slow = RecordArrays(
        batches, 1, np.full(table.size, SAMPLES), np.full(table.size, LEVEL), table, unknown, unknown, unknown
    )
    nothing = RecordArrays([], 1, np.array([], dtype=int), *(np.array([]) for _ in range(5)))
    bandwidth = ResponseCorner(STATED_HZ if plan.stated else math.nan)
    coupled = ResponseCorner(0.0)  # DC
    corners = {"bandwidth": bandwidth, "high_pass": coupled}
    bench = BenchKnowledge(SCALE_FACTOR_U_PPM, TIME_BASE_PPM, tail_limit=fault.stated_tail, **corners)
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


def outcome_with_beams(name: str, seed: int) -> Outcome | None:
    """Draw a laser, take beat and beams, fit them; ``None``: no laser fits, and the run says so."""
    found = beams.outcome(beams.PLANS[WITH_BEAMS[name]], seed)
    if found is None:
        return None
    doubtful = bool(found.flags & BeamsFlag.MISFIT)
    return Outcome(-found.pull, float(scipy.special.ndtr(-found.pull)), found.covered, found.u, doubtful)


def _signal(
    gyro: Gyro, receiver: Detector, fifth: float, channel: Channel, rate: float, turns: Floats, beat: float
) -> Floats:
    """What leaves the channel at so many turns of the beat; its harmonics are taken from one period."""
    turning = math.copysign(2 * np.pi, rate) * np.arange(POINTS) / POINTS
    volts = detector_signal(gyro, receiver, np.full(POINTS, rate), np.asarray(turning))
    lines = np.fft.rfft(volts + 16 * fifth * volts**5) / POINTS
    lines = lines[: 1 + np.flatnonzero(np.abs(lines) > 1e-7)[-1]]
    lines[0] /= 2
    lines = lines * channel(beat * np.arange(float(lines.size)))
    return np.asarray(2 * np.polynomial.polynomial.polyval(np.exp(2j * np.pi * turns), lines).real)


def _codes(levels: Floats, widths: Floats) -> Floats:
    """Codes of a converter whose codes are too wide by so many levels each."""
    off = np.cumsum(widths)
    off -= np.linspace(off[0], off[-1], off.size)
    middle = off.size // 2
    return np.asarray(np.searchsorted(np.sort(np.arange(off.size) - middle - 0.5 + off), levels) - 1.0 - middle)


def _either(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """A size between two bounds, of either sign."""
    return float(rng.uniform(*bounds) * rng.choice([-1, 1]))


def _interval(rate: float) -> float:
    """Sample interval of the records at a rate (deg/s), s."""
    return PERIODS / (K * math.sqrt(rate**2 - WL**2)) / SAMPLES


def _moved(rate: float) -> float:
    """The change of a rate (lock-in rates) that keeps it off the mains, deg/s."""
    duration = _interval(WL * rate) * SAMPLES
    return math.copysign(off_mains(PERIODS / duration, WL, K, duration, (HUM_HZ,)), rate)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--benches", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--drift", type=float, default=1.0)
    parser.add_argument("--faults", action="store_true")
    parser.add_argument("--only", default="", metavar="TEXT")
    asked = parser.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # for the workers, which begin afresh: each has a core
    seeds = range(asked.seed * 100_000, asked.seed * 100_000 + asked.benches)
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as workers:
        if asked.faults:
            _faults(workers, seeds, asked.only)
        else:
            _plans(workers, seeds, asked.only, asked.drift)


def _plans(workers: Executor, seeds: range, only: str, drift: float) -> None:
    sys.stdout.write(f"{'run':28s}{'pull':>6s}{'covered':>9s}{'u, %':>8s}{'doubtful':>10s}{'KS p':>8s}\n")
    for name in (name for name in (*PLANS, *WITH_BEAMS) if only in name):
        if name in PLANS:
            every = workers.map(partial(outcome, PLANS[name], drift, None), seeds)
        else:
            every = workers.map(partial(outcome_with_beams, name), seeds)
        found = [each for each in every if each is not None]
        doubtful = float(np.mean([each.doubtful for each in found]))
        found = [each for each in found if not each.doubtful]
        pull, covered = math.sqrt(np.mean([e.pull**2 for e in found])), float(np.mean([e.covered for e in found]))
        u = 100 * np.median([each.relative_u for each in found])
        chance = scipy.stats.kstest([each.place for each in found], "uniform").pvalue
        sys.stdout.write(f"{name:28s}{pull:6.2f}{covered:9.3f}{u:8.3f}{doubtful:10.3f}{chance:8.3f}\n")
        sys.stdout.flush()


def _faults(workers: Executor, seeds: range, only: str) -> None:
    sys.stdout.write(f"{len(seeds)} runs of each kind, seeds from {seeds[0]} on.\n\n")
    sys.stdout.write("| what is wrong | unflagged, > 1.96 u | > 5 u | covered | doubtful | pull | u, % |\n")
    sys.stdout.write("| --- | --- | --- | --- | --- | --- | --- |\n")
    for name in (name for name in FAULTS if only in name):
        found = list(workers.map(partial(outcome, PLANS[FAULTS[name].plan], 0.1, FAULTS[name]), seeds))
        pulls = np.abs([each.pull for each in found])
        silent = np.array([not each.doubtful for each in found])
        cells = [f"{100 * np.mean(silent & (pulls > limit)):.1f} %" for limit in (1.96, 5.0)]
        cells += [f"{100 * np.mean([getattr(e, f) for e in found]):.0f} %" for f in ("covered", "doubtful")]
        cells += [f"{math.sqrt(np.mean(pulls**2)):.2f}", f"{100 * np.median([e.relative_u for e in found]):.2g}"]
        sys.stdout.write(f"| {name} | {' | '.join(cells)} |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
