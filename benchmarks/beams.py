"""`python -m benchmarks.beams`: beat and single beams together, on lasers that are integrated in time.

Each bench draws its coupling (phase sum 0 to 180 degrees, a2/a1 0.3 to 3), the gain (slowest beat over its corner
0.01 to 3, dispersion up to 0.03), cross saturation, beams unequal by up to 10 %, contrast, distortion of second
order, levels, crosstalk of -40 dB, and the corner of the AC coupling; with `--all` whatever else
the fit bounds: what turns and grows over the run and between senses, scale and bias of the table's rates,
distortion of third order, poles of three receivers.
The equations of the laser go through time with an integrator of high order. Printed for each plan: how the answer
with beams and that of the beat alone cover the truth, their pull (rms of error over u), the chance of a uniform
place of the truth (Kolmogorov and Smirnov), the median u, the median width of the interval with beams over that
without, how many are flagged or fit no laser, and the largest error over u of those that are not.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.stats
from scipy.integrate import solve_ivp

from analysis import estimate_lock_in, fit_rates
from analysis.arrays import Complexes, Floats, NoFit
from analysis.beam_swings import BeamModulation, BeamsFlag, beam_modulation
from analysis.budget import (
    LOCK_IN_DRIFT_LIMIT,
    PHASE_CHANGE_LIMIT,
    SCALE_FACTOR_LIMIT,
    SECOND_ORDER_LIMIT,
    TABLE_RATE_LIMIT,
    THIRD_ORDER_LIMIT,
    lowest_bandwidth,
)
from analysis.single_beams import BeamsKnowledge, fit_beams

K, WL, SAMPLES, PERIODS, RECORDS = 2000.0, 0.01, 2500, 20, 4
CROSSTALK, LEVEL_U, AC_HZ, AC_SPREAD, NOISE, FILL, EARTH = 0.01, 0.01, 10.0, 0.2, 0.6, 90, 0.004
IMBALANCE, DISPERSION = 0.05, 0.03
POINTS = 256  # of one period, taken from the integrator
_SETTLING, _MOST_PERIODS, _LONGEST, _LOCKED, _STEADY_LIGHT = 15.0, 400, 12, 1e-6, 1e-7

PLANS: dict[str, tuple[float, ...]] = {
    "3 5 9 17 30, both senses": (3, 5, 9, 17, 30, -30, -17, -9, -5, -3),
    "3 5 9 17 30, one sense": (3, 5, 9, 17, 30),
    "3 10 30, one sense": (3, 10, 30),
    "3 30, one sense": (3, 30),
    "8, both senses": (8, -8),
}


@dataclass(frozen=True)
class Bench:
    """One laser and its three receivers."""

    a1: float  # rad/s
    a2: float
    phase_sum: float
    gain: float  # rad/s
    saturation: float
    imbalance: float  # of the beams' light
    dispersion: float  # of the gain
    readout: float
    contrast: float
    distortion: float
    third_order: float
    lags: Floats  # s, poles of the beat's receiver and of both beams'
    between: float  # what turns the phase, rad: with the sense, over the run, as its bend
    turn: float
    bend: float
    drift: float  # of the backscatter over the run, relative
    levels: Floats  # V, of both beams
    crosstalk: Floats  # of the beat, and of the other beam, into each
    other: Floats
    corner_hz: float

    @staticmethod
    def drawn(rng: np.random.Generator, rates: tuple[float, ...]) -> tuple[Bench, Floats]:
        """A bench that locks at WL, and the rates at which it is looked at, deg/s."""
        ratio, phase_sum = math.exp(rng.uniform(math.log(0.3), math.log(3))), rng.uniform(0, math.pi)
        of_gain = rng.spawn(1)[0]
        imbalance, dispersion = IMBALANCE * of_gain.uniform(-1, 1), DISPERSION * of_gain.uniform(-1, 1)
        back = np.exp(0.5j * phase_sum) * (1 + 1j * dispersion)
        together = abs(np.conj(back) + ratio * back)
        a1 = 2 * math.pi * K * WL / together
        # where little of the coupling locks, rates near WL would be near nothing
        base = WL * max(1.0, 0.35 * (1 + ratio) / together)
        slowest = 2 * math.pi * K * math.sqrt((base * min(map(abs, rates))) ** 2 - WL**2)
        gain = slowest / math.exp(rng.uniform(math.log(0.01), math.log(3)))
        bench = Bench(
            a1,
            a1 * ratio,
            phase_sum,
            gain,
            rng.uniform(0.1, 0.9),
            imbalance,
            dispersion,
            rng.uniform(0, 2 * math.pi),
            rng.uniform(0.5, 1),
            SECOND_ORDER_LIMIT * rng.uniform(-1, 1),
            THIRD_ORDER_LIMIT * rng.uniform(-1, 1),
            rng.uniform(0, 1, 3) / (2 * math.pi * lowest_bandwidth(slowest / (2 * math.pi))),
            *PHASE_CHANGE_LIMIT * rng.uniform(-1, 1, 3),
            LOCK_IN_DRIFT_LIMIT * rng.uniform(-1, 1),
            np.exp(rng.uniform(math.log(0.3), math.log(3), 2)),
            rng.uniform(-CROSSTALK, CROSSTALK, 2),
            rng.uniform(-CROSSTALK, CROSSTALK, 2),
            AC_HZ * math.exp(rng.uniform(-AC_SPREAD, AC_SPREAD)),
        )
        return bench, base * np.array(rates)

    def period(self, rate: float) -> tuple[Complexes, float] | None:
        """Fields of both beams over one period (2, POINTS), and the beat in Hz; ``None``: locked or not steady."""
        back, xi = np.exp(-0.5j * self.phase_sum), self.saturation
        sagnac, light_of = 2 * math.pi * K * rate, 1 + self.imbalance * np.array([1.0, -1.0])
        saturating = 0.5 * self.gain * (1 + 1j * self.dispersion) / (1 + xi)

        def slope(_: float, parts: Floats) -> Floats:
            y = parts.view(np.complex128)
            left = light_of * (1 - (y * np.conj(y)).real)
            own = saturating * (left + xi * left[::-1]) + 0.5j * sagnac * np.array([1.0, -1.0])
            return np.asarray(own * y + np.array([self.a2, self.a1]) * back * y[::-1]).view(np.float64)

        beat = 2 * math.pi / abs(sagnac)
        settling = min(_SETTLING * (1 + xi) / self.gain / (1 - xi) + 3 * beat, _MOST_PERIODS * beat)
        exact = {"method": "LSODA", "rtol": 1e-9, "atol": 1e-11}  # gain much faster than the beat is stiff
        start, begin = np.array([1.0, 0, 1, 0]), np.complex128()

        def passes(_: float, parts: Floats) -> float:
            y = np.ascontiguousarray(parts).view(np.complex128)
            return float((y[0] * np.conj(y[1]) * np.conj(begin)).imag)

        passes.direction = math.copysign(1.0, sagnac)  # type: ignore[attr-defined]  # as scipy asks for it
        for longer in (1, 4, 16):  # one beam may win over the other much more slowly than its light follows
            start = np.ascontiguousarray(solve_ivp(slope, (0, longer * settling), start, **exact).y[:, -1])
            fields, going_on = start.view(np.complex128), slope(0.0, start).view(np.complex128)
            if abs(np.diff((going_on / fields).imag)[0]) < _LOCKED * abs(sagnac):
                return None
            begin = 1j * fields[0] * np.conj(fields[1])  # not where it starts, and rounding passes too
            going = solve_ivp(slope, (0, _LONGEST * beat), start, events=passes, dense_output=True, **exact)
            passed = [float(time) for time in going.t_events[0] if time > 0.1 * beat]
            if len(passed) < 2:
                return None
            lights = [np.abs(np.ascontiguousarray(going.sol(time)).view(np.complex128)) for time in passed[:2]]
            if np.allclose(*lights, rtol=_STEADY_LIGHT):
                break
        else:
            return None
        first, length = passed[0], passed[1] - passed[0]
        fields = (
            np.ascontiguousarray(going.sol(first + np.arange(POINTS) * length / POINTS).T).view(np.complex128).T
        )
        turned = np.unwrap(np.angle(fields[0] * np.conj(fields[1])))
        return (fields, 1 / length) if np.ptp(turned) > np.pi else None  # rounding of a locked laser turns too

    def records(self, rate: float, when: Floats, rng: np.random.Generator) -> tuple[Floats, float] | None:
        """Volts (3, RECORDS, SAMPLES) in eight bits, taken at such places in the run, and the sample interval."""
        every, interval = [], 0.0
        for place in map(float, when):
            grown = 1 + self.drift * place
            found = replace(self, a1=self.a1 * grown, a2=self.a2 * grown).period(rate)
            if found is None:
                return None
            interval = interval or PERIODS / found[1] / SAMPLES
            turns = rng.uniform() + found[1] * interval * np.arange(SAMPLES)
            every.append(self._volts(rate, place, *found, turns))
        volts = np.stack(every, axis=1)
        level = np.abs(volts).max(axis=(1, 2), keepdims=True) / FILL
        return np.round(volts / level + NOISE * rng.standard_normal(volts.shape)) * level, interval

    def _volts(self, rate: float, when: float, fields: Complexes, frequency: float, turns: Floats) -> Floats:
        """Beat and both beams, (3, SAMPLES), at so many turns of the beat."""
        turned = self.between * math.copysign(0.5, rate) + self.turn * when + self.bend * (6 * when**2 - 0.5)
        light, both = np.abs(fields) ** 2, fields[0] * np.conj(fields[1])
        single = np.average(light, axis=0, weights=[1 + self.imbalance, 1 - self.imbalance]) - 1
        fringes = (both * np.exp(1j * (self.readout - turned))).imag + single / self.contrast
        fringes = fringes + 2 * self.distortion * fringes**2 + 4 * self.third_order * fringes**3
        lines: Complexes = np.fft.rfft(np.stack([fringes, *self.levels[:, np.newaxis] * light])) * (2 / POINTS)
        lines[:, 0] = 0
        lines /= 1 + 2j * np.pi * frequency * self.lags[:, np.newaxis] * np.arange(lines.shape[1])
        # crosstalk is that of the channels, behind the receivers
        lines[1:] += self.crosstalk[:, np.newaxis] * lines[0] + self.other[:, np.newaxis] * lines[:0:-1]
        lines[1:, 1:] /= 1 - 1j * self.corner_hz / (frequency * np.arange(1, lines.shape[1]))
        orders = np.flatnonzero(np.abs(lines).max(axis=0) > 1e-8)
        return np.asarray((lines[:, orders] @ np.exp(2j * np.pi * orders[:, np.newaxis] * turns)).real)


@dataclass(frozen=True)
class Outcome:
    """Errors over u with beams and without, whether the intervals hold, their widths, and the flags."""

    pull: float
    alone_pull: float
    covered: bool
    alone_covered: bool
    u: float
    narrower: float
    flags: int


_STEADY = dict.fromkeys(("third_order", "between", "turn", "bend", "drift"), 0.0) | {"lags": np.zeros(3)}


def outcome(rates: tuple[float, ...], seed: int, *, everything: bool = True) -> Outcome | None:
    """Draw a bench, take its records, fit them; ``None`` where no laser fits."""
    rng = np.random.default_rng(seed)
    records = None
    while records is None or any(one is None for one in records):
        bench, axis = Bench.drawn(rng, rates)
        bench = bench if everything else replace(bench, **_STEADY)
        places = np.linspace(-0.5, 0.5, len(axis) * RECORDS).reshape(-1, RECORDS)
        with np.errstate(over="ignore", invalid="ignore"):  # of a step that the integrator takes back
            records = [bench.records(float(rate), when, rng) for rate, when in zip(axis, places, strict=True)]
    known = bench.levels * np.exp(LEVEL_U * rng.standard_normal(2))
    estimates, parts = [], []
    for one in records:
        assert one is not None
        volts, interval = one
        each = estimate_lock_in(volts[0], interval, scale_factor=K)
        swing = beam_modulation(
            volts[0], volts[1:], interval, beat_frequency=each.beat_frequency, level=known, ac_corner_hz=AC_HZ
        )
        estimates.append(each)
        parts.append(swing)
    whole = BeamModulation(
        np.concatenate([one.modulation for one in parts]),
        np.concatenate([one.modulation_u for one in parts]),
        np.concatenate([one.phase_u for one in parts]),
        np.concatenate([one.beat_over_level for one in parts]),
        int(np.bitwise_or.reduce([one.flags for one in parts])),
    )
    try:
        scale, earth = rng.uniform(-1, 1, 2) * (math.hypot(SCALE_FACTOR_LIMIT, TABLE_RATE_LIMIT), EARTH)
        stated = (axis - earth) / (1 + scale) if everything else axis
        alone = fit_rates(estimates, input_rate=np.repeat(stated, RECORDS), reference="beat", in_order=True)
        fit = fit_beams(alone, whole, BeamsKnowledge(level_u=LEVEL_U, ac_corner_hz=AC_HZ))
    except NoFit:
        return None
    return Outcome(
        (fit.lock_in_rate - WL) / fit.lock_in_rate_u,
        (alone.lock_in_rate - WL) / alone.lock_in_rate_u,
        fit.lock_in_rate_low_95 <= WL <= fit.lock_in_rate_high_95,
        alone.lock_in_rate_low_95 <= WL <= alone.lock_in_rate_high_95,
        fit.lock_in_rate_u / WL,
        (fit.lock_in_rate_high_95 - fit.lock_in_rate_low_95)
        / (alone.lock_in_rate_high_95 - alone.lock_in_rate_low_95),
        fit.flags,
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--benches", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", metavar="TEXT")
    parser.add_argument("--all", action="store_true")
    asked = parser.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    heads = ("covered", "alone", "pull", "alone", "KS p", "u, %", "width", "misfit", "no fit", "worst")
    sys.stdout.write(f"{'rates (WL)':28s}" + "".join(f"{head:>8s}" for head in heads) + "\n")
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as workers:
        for name in (name for name in PLANS if asked.only in name):
            seeds = range(asked.seed * 10_000, asked.seed * 10_000 + asked.benches)
            every = list(workers.map(partial(outcome, PLANS[name], everything=asked.all), seeds))
            found = [one for one in every if one is not None]
            flagged = np.array([bool(one.flags & (BeamsFlag.MISFIT | BeamsFlag.NOT_SIGNIFICANT)) for one in found])
            pull = np.array([one.pull for one in found])
            places = scipy.stats.norm.cdf(pull)
            silent = np.abs(pull[~flagged])
            cells = (
                float(np.mean([one.covered for one in found])),
                float(np.mean([one.alone_covered for one in found])),
                math.sqrt(float(np.mean(pull**2))),
                math.sqrt(float(np.mean([one.alone_pull**2 for one in found]))),
                float(scipy.stats.kstest(places, "uniform").pvalue),
                100 * float(np.median([one.u for one in found])),
                float(np.median([one.narrower for one in found])),
                float(flagged.sum()),
                float(len(every) - len(found)),
                float(silent.max()) if silent.size else 0.0,
            )
            sys.stdout.write(f"{name:28s}" + "".join(f"{cell:8.3g}" for cell in cells) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
