"""What a plan promises of several rates, against fits of simulated records.

    python -m benchmarks.several_rates.planned [--trials N]

One phase of the backscatter, a receiver of -48 dBc of which the plan knows nothing, an eight-bit oscilloscope.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import replace

import numpy as np

from analysis import beat_signal, estimate_lock_in
from analysis.budget import NOTHING_BUT_RECORDS
from analysis.plan import OscilloscopeSteps, Plan, PlanRequest, plan_measurement, run_order
from analysis.several_rates import RatesFit, fit_rates

LOCK_IN, K, PHASE, DISTORTION = 0.01, 2000.0, 0.6, 0.004
CASES: tuple[tuple[tuple[float, ...], bool], ...] = (
    ((3.0,), True),
    ((3.0, 8.0), False),
    ((3.0, 30.0), False),
    ((3.0, 30.0), True),
    ((8.0, 15.0, 30.0), False),
    ((3.0, 5.3, 9.5, 17.0, 30.0), True),
)


def planned(over: tuple[float, ...], both_senses: bool) -> Plan:
    """A plan for rates over the lock-in rate, on a bench of which nothing else has to be known."""
    steps = OscilloscopeSteps(
        time_bases=tuple(float(f"{m}e{d}") for d in range(-9, 2) for m in (1, 2.5, 5)),
        vertical_scales=tuple(float(f"{m}e{d}") for d in range(-3, 1) for m in (1, 2, 5)),
    )
    request = PlanRequest(
        lock_in_rate=LOCK_IN,
        wanted_u=0.05,
        scale_factor=K,
        amplitude=0.38,
        noise_rms=0.004,
        noise_levels=0.5,
        oscilloscope=steps,
        knowledge=replace(NOTHING_BUT_RECORDS, scale_factor_u_ppm=0.0, distortion_limit=math.nan),
        rates_over_lock_in=over,
        both_senses=both_senses,
        phase=PHASE,
    )
    return plan_measurement(request)


def simulated_fits(
    plan: Plan, distortion: float, trials: int, rng: np.random.Generator, phase: float = PHASE
) -> list[RatesFit]:
    """What the records of a plan give, so many times, taken in the order of a run."""
    estimates, visits = [], [visited for visited, _ in run_order([rate.input_rate for rate in plan.rates])]
    for visited in visits:
        rate = next(rate for rate in plan.rates if rate.input_rate == visited)
        shape, records = rate.shape, math.ceil(rate.shape.records / visits.count(visited))
        count = trials * records
        clean = beat_signal(
            np.broadcast_to(np.arange(shape.samples) * shape.sample_interval, (count, shape.samples)),
            scale_factor=K,
            input_rate=rate.input_rate,
            lock_in_rate=LOCK_IN,
            amplitude=shape.amplitude,
            initial_phase=rng.uniform(0, 2 * np.pi, count),
            readout_phase=phase,
        )
        bent = clean + 2 * distortion / shape.amplitude * clean**2
        noisy = bent + shape.noise_rms * rng.standard_normal(clean.shape)
        codes = shape.level_spacing * np.rint(noisy / shape.level_spacing)
        every = estimate_lock_in(codes, shape.sample_interval, scale_factor=K, input_rate=rate.input_rate)
        estimates.append(every.reshaped(trials, records))
    receiver = plan.request.knowledge
    each = ([every[trial] for every in estimates] for trial in range(trials))
    return [fit_rates(one, reference="beat", receiver=receiver, in_order=True) for one in each]


def rms_error(fits: list[RatesFit]) -> float:
    """Of the lock-in rates, over it."""
    return float(np.sqrt(np.mean([(fit.lock_in_rate / LOCK_IN - 1) ** 2 for fit in fits])))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=200)
    trials = parser.parse_args().trials
    sys.stdout.write(f"{'rates':26s}{'records':>8s}{'planned u, %':>14s}{'rms error, %':>14s}" + "\n")
    for over, both in CASES:
        plan = planned(over, both)
        rms = 100 * rms_error(simulated_fits(plan, DISTORTION, trials, np.random.default_rng(7)))
        name = ", ".join(f"{ratio:g}" for ratio in over) + (" both" if both else "")
        promised = 100 * plan.budget.relative_u
        sys.stdout.write(f"{name:26s}{plan.records:8d}{promised:14.3f}{rms:14.3f}" + "\n")


if __name__ == "__main__":
    main()
