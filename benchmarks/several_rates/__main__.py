"""Several rates: pull, coverage and flags of `fit_rates` over rates, senses and contaminants.

    python -m benchmarks.several_rates [--trials N]

Ratios are drawn from equation (1) with the noise of records of 2500 samples, 1 % of the amplitude, at phases of
all kinds; the first table has no noise and counts starts that went astray.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from analysis.several_rates import RatesFit, RatesFlag, RatioData, ReceiverKnowledge, Reference, fit_rate_ratios
from analysis.several_rates.ratio_model import predicted

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
    """Rates in both senses."""
    return (*rates, *(-rate for rate in rates))


def times(rates_fast: float) -> float:
    """Time constant in s of a corner at the beat of so many lock-in rates."""
    return 1 / (2 * np.pi * K * LOCK_IN * rates_fast)


ALL_OF_IT = {"distortion": 0.005, "third_order": 0.003, "gain_time": times(60), "lag_square": times(40) ** 2}
DEFAULT = both(3, 5.3, 9.5, 17, 30)
SCENARIOS: dict[str, tuple[tuple[float, ...], int, dict[str, float]]] = {
    "default rates": (DEFAULT, 3, {}),
    "default, second order -40 dBc": (DEFAULT, 3, {"distortion": 0.01}),
    "default, third order -40 dBc": (DEFAULT, 3, {"third_order": 0.01}),
    "default, gain corner 15 WL": (DEFAULT, 3, {"gain_time": times(15)}),
    "default, low pass 5 x slowest": (DEFAULT, 3, {"lag_square": times(15) ** 2}),
    "1.2, 2, 4 both": (both(1.2, 2, 4), 4, {}),
    "1.2, 2, 4 one sense": ((1.2, 2, 4), 4, {}),
    "the same, -46 dBc": ((1.2, 2, 4), 4, {"distortion": 0.005}),
    "8, 15, 30, 60 both": (both(8, 15, 30, 60), 4, {}),
    "3, 5 both": (both(3, 5), 4, {}),
    "8 both": (both(8), 8, {}),
    "8, 15, 30, 60 one sense": ((8, 15, 30, 60), 8, {}),
    "the same, third order -40 dBc": ((8, 15, 30, 60), 8, {"third_order": 0.01}),
    "the same, gain corner 120 WL": ((8, 15, 30, 60), 8, {"gain_time": times(120)}),
    "3 to 30 one sense, all of it": ((3, 5.3, 9.5, 17, 30), 4, ALL_OF_IT),
    "3, 30 one sense": ((3, 30), 8, {}),
    "3, 30 one sense, -46 dBc": ((3, 30), 8, {"distortion": 0.005}),
}


def drawn(
    rates: tuple[float, ...],
    records: int,
    phase: float,
    noise: float,
    rng: np.random.Generator,
    *,
    reference: Reference = "beat",
    receiver: ReceiverKnowledge | None = None,
    **contaminants: float,
) -> RatesFit:
    """One measurement and its fit."""
    rate = np.repeat(np.array(rates, dtype=float) * LOCK_IN, records)
    frequency = K * np.sqrt(rate**2 - LOCK_IN**2)
    names = ("distortion", "gain_time", "lag_square", "third_order")
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
        third=nothing,
        third_weight=nothing,
        reference=reference,
    )
    ratio, third = (values[0] for values in predicted(truth, data))
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
    sys.stdout.write(f"\n{'scenario':34s}{'pull':>7s}{'covered':>9s}{'u, %':>8s}  flags" + "\n")
    for name, (rates, records, contaminants) in SCENARIOS.items():
        rng = np.random.default_rng(1)
        fits = [
            drawn(rates, records, rng.uniform(0, 2 * np.pi), NOISE, rng, **contaminants) for _ in range(trials)
        ]
        pull = np.sqrt(np.mean([((fit.lock_in_rate - LOCK_IN) / fit.lock_in_rate_u) ** 2 for fit in fits]))
        covered = np.mean([fit.lock_in_rate_low_95 <= LOCK_IN <= fit.lock_in_rate_high_95 for fit in fits])
        u = 100 * np.median([fit.lock_in_rate_u for fit in fits]) / LOCK_IN
        seen = {flag: sum(bool(fit.flags & flag) for fit in fits) for flag in RatesFlag if not flag & EXPECTED}
        flags = ", ".join(f"{str(flag.name).lower()} {n}" for flag, n in seen.items() if n)
        sys.stdout.write(f"{name:34s}{pull:7.2f}{covered:9.2f}{u:8.3f}  {flags}" + "\n")


if __name__ == "__main__":
    main()
