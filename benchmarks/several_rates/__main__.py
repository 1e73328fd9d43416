"""Several rates: pull, coverage and flags of `fit_rates` over rates, senses and contaminants.

    python -m benchmarks.several_rates [--trials N]

Ratios are drawn from equation (1) with the noise of records of 2500 samples, 1 % of the amplitude, at phases of
all kinds; the first table has no noise and counts starts that went astray.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from analysis.budget import (
    SECOND_ORDER_LIMIT,
    THIRD_ORDER_LIMIT,
    BenchKnowledge,
    ResponseCorner,
    lowest_bandwidth,
    lowest_gain_corner,
)
from analysis.plan import run_order
from analysis.several_rates import RatesFit, RatesFlag, RatioData, Reference, fit_rate_ratios
from analysis.several_rates.ratio_model import beyond_first_order, predicted

K, LOCK_IN = 2000.0, 0.05
NOISE = 0.01 * np.sqrt(2 / 2500)
EXPECTED = RatesFlag.ONE_SENSE | RatesFlag.NOT_TESTED
STARTS: tuple[tuple[float, ...], ...] = (
    (1.2, 2, 4),
    (1.2, 2, 4, -1.2, -2, -4),
    (8, 15, 30, 60),
    (3, 5, 8, 15, 30, -3, -5, -8, -15, -30),
)


def both(*rates: float) -> tuple[float, ...]:
    """Rates in both senses, as a run goes through them: down in one, up in the other."""
    return (*rates[::-1], *(-rate for rate in rates))


def times(rates_fast: float) -> float:
    """Time constant in s of a corner at the beat of so many lock-in rates."""
    return 1 / (2 * np.pi * K * LOCK_IN * rates_fast)


Draw = Callable[[np.random.Generator], float]


def within(low: float, high: float) -> Draw:
    """Anything between two bounds, all equally likely."""
    return lambda rng: float(rng.uniform(low, high))


def corner_within(low: float, high: float) -> Draw:
    """Time constant in s of a corner at the beats of so many lock-in rates, logarithmically."""
    return lambda rng: times(float(np.exp(rng.uniform(np.log(low), np.log(high)))))


def within_the_bounds(slowest: float) -> dict[str, Draw]:
    """Everything that counts with a bound where nobody states it, drawn within it; the slowest rate in WL."""
    beat = K * LOCK_IN * np.sqrt(slowest**2 - 1)
    gain_time = 1 / (2 * np.pi * lowest_gain_corner(beat))
    return {
        "distortion": within(-SECOND_ORDER_LIMIT, SECOND_ORDER_LIMIT),
        "third_order": within(-THIRD_ORDER_LIMIT, THIRD_ORDER_LIMIT),
        "gain_time": within(0.0, gain_time),
        "lag_square": within(0.0, 1 / (2 * np.pi * lowest_bandwidth(beat)) ** 2),
    }


@dataclass(frozen=True)
class Scenario:
    """Rates in WL, records at each, what spoils them (a number, or how it is drawn), and what was stated of it."""

    rates: tuple[float, ...]
    records: int
    contaminants: Mapping[str, float | Draw] = field(default_factory=dict)
    receiver: BenchKnowledge | None = None

    def fits(self, trials: int) -> list[RatesFit]:
        """So many measurements and their fits."""
        rng, made = np.random.default_rng(1), []
        visits, records = self.rates, self.records
        if any(again for _, again in run_order(visits)):
            once = [rate for rate, again in run_order(visits) if not again]
            visits, records = (*once, *once[::-1]), records // 2
        for _ in range(trials):
            phase = rng.uniform(0, 2 * np.pi)
            sizes = {
                name: float(size(rng) if callable(size) else size) for name, size in self.contaminants.items()
            }
            known = {"reference": "beat", "receiver": self.receiver, "in_order": True}
            made.append(drawn(visits, records, phase, NOISE, rng, **known, **sizes))
        return made


ALL_OF_IT = {"distortion": 0.005, "third_order": 0.003, "gain_time": times(60), "lag_square": times(40) ** 2}
DEFAULT = both(3, 5.3, 9.5, 17, 30)
FAST_CHANNEL = BenchKnowledge(bandwidth=ResponseCorner(np.inf))
NO_CORNER = BenchKnowledge(bandwidth=ResponseCorner(np.inf), gain=ResponseCorner(np.inf))
SCENARIOS = {
    "default rates": Scenario(DEFAULT, 3),
    "default, second order -40 dBc": Scenario(DEFAULT, 3, {"distortion": 0.01}),
    "default, third order -40 dBc": Scenario(DEFAULT, 3, {"third_order": 0.01}),
    "default, gain corner 15 WL": Scenario(DEFAULT, 3, {"gain_time": times(15)}),
    "default, low pass 5 x slowest": Scenario(DEFAULT, 3, {"lag_square": times(15) ** 2}),
    "1.2, 2, 4 both": Scenario(both(1.2, 2, 4), 4),
    "1.2, 2, 4 one sense": Scenario((1.2, 2, 4), 4),
    "the same, -46 dBc": Scenario((1.2, 2, 4), 4, {"distortion": 0.005}),
    "the same, gain corner 2 to 80 WL": Scenario((1.2, 2, 4), 4, {"gain_time": corner_within(2, 80)}),
    "8, 15, 30, 60 both": Scenario(both(8, 15, 30, 60), 4),
    "3, 5 both": Scenario(both(3, 5), 4),
    "8 both": Scenario(both(8), 8),
    "the same, bandwidth stated": Scenario(both(8), 8, {"distortion": 0.005}, FAST_CHANNEL),
    "8 both, within the bounds": Scenario(both(8), 8, within_the_bounds(8)),
    "8, 15, 30, 60 one sense": Scenario((8, 15, 30, 60), 8),
    "the same, third order -40 dBc": Scenario((8, 15, 30, 60), 8, {"third_order": 0.01}),
    "the same, gain corner 120 WL": Scenario((8, 15, 30, 60), 8, {"gain_time": times(120)}),
    "3 to 30 one sense, all of it": Scenario((3, 5.3, 9.5, 17, 30), 4, ALL_OF_IT),
    "3, 30 one sense": Scenario((3, 30), 8),
    "3, 30 one sense, -46 dBc": Scenario((3, 30), 8, {"distortion": 0.005}),
    "the same, both corners stated": Scenario((3, 30), 8, {"distortion": 0.005}, NO_CORNER),
    "3, 30, gain corner 15 to 600 WL": Scenario((3, 30), 8, {"gain_time": corner_within(15, 600)}),
    "3, 30 one sense, within the bounds": Scenario((3, 30), 8, within_the_bounds(3)),
}


def drawn(
    rates: tuple[float, ...],
    records: int,
    phase: float,
    noise: float,
    rng: np.random.Generator,
    *,
    reference: Reference = "beat",
    receiver: BenchKnowledge | None = None,
    in_order: bool | None = None,
    **contaminants: float,
) -> RatesFit:
    """One measurement and its fit."""
    rate = np.repeat(np.array(rates, dtype=float) * LOCK_IN, records)
    frequency = K * np.sqrt(rate**2 - LOCK_IN**2)
    names = ("distortion", "gain_time", "lag_square", "third_order", "between_senses", "turned", "bent", "drift")
    z = LOCK_IN * np.exp(1j * phase)
    truth = np.array([[z.real, z.imag, *(contaminants.get(name, 0.0) for name in names)]])
    nothing = np.zeros(rate.size)
    data = RatioData(
        rate=rate,
        beat_rate=frequency / K,
        angular=2 * np.pi * frequency,
        ratio=nothing.astype(complex),
        whitening=np.zeros((1, rate.size, 2, 2)),
        amplitude=np.ones(rate.size),
        when=np.arange(rate.size) / (rate.size - 1) - 0.5 if rate.size > 1 else nothing,
        third=nothing,
        third_weight=nothing,
        reference=reference,
    )
    ratio, third = (
        first[0] + more[0]
        for first, more in zip(predicted(truth, data), beyond_first_order(truth, data), strict=True)
    )
    shaken = ratio + noise * (rng.normal(size=rate.size) + 1j * rng.normal(size=rate.size))
    return fit_rate_ratios(
        rate,
        shaken,
        np.eye(2) * max(noise, 1e-6) ** 2,
        frequency,
        scale_factor=K,
        third_harmonic=third + noise * rng.normal(size=rate.size),
        third_harmonic_u=max(noise, 1e-6),
        reference=reference,
        receiver=receiver,
        in_order=bool(in_order),
    )


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=100)
    trials = parser.parse_args().trials
    sys.stdout.write("without noise: phases of 36 with WL off by more than 0.1 %" + "\n")
    for rates in STARTS:
        rng = np.random.default_rng(0)
        fits = [drawn(rates, 1, turn * np.pi / 18, 0.0, rng, distortion=0.005) for turn in range(36)]
        wrong = sum(abs(fit.lock_in_rate / LOCK_IN - 1) > 1e-3 for fit in fits)
        sys.stdout.write(f"  {', '.join(f'{rate:g}' for rate in rates):44s} {wrong}" + "\n")
    sys.stdout.write(f"\n{'scenario':36s}{'pull':>7s}{'covered':>9s}{'u, %':>8s}  flags" + "\n")
    for name, scenario in SCENARIOS.items():
        fits = scenario.fits(trials)
        pull = np.sqrt(np.mean([((fit.lock_in_rate - LOCK_IN) / fit.lock_in_rate_u) ** 2 for fit in fits]))
        covered = np.mean([fit.lock_in_rate_low_95 <= LOCK_IN <= fit.lock_in_rate_high_95 for fit in fits])
        u = 100 * np.median([fit.lock_in_rate_u for fit in fits]) / LOCK_IN
        seen = {flag: sum(bool(fit.flags & flag) for fit in fits) for flag in RatesFlag if not flag & EXPECTED}
        flags = ", ".join(f"{str(flag.name).lower()} {n}" for flag, n in seen.items() if n)
        sys.stdout.write(f"{name:36s}{pull:7.2f}{covered:9.2f}{u:8.3f}  {flags}" + "\n")


if __name__ == "__main__":
    main()
