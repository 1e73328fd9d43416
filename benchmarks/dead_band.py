"""Pull and coverage of the dead band: sweeps with noise, a bias that drifts, hysteresis; no instrument between.

    python -m benchmarks.dead_band [SWEEPS]

Each line: root mean square of (found - true) / u, and the share of sweeps whose 95 % interval holds the truth.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from analysis.dead_band import find_dead_band, simulate_sweep

K, WL, STEPS = 2000.0, 0.01, 20
STEP = 2 * WL / STEPS


@dataclass(frozen=True)
class Case:
    """Random walk in deg/sqrt(s); drift over the sweep and hysteresis in steps of the table."""

    name: str
    walk: float = 0.0
    drift: float = 0.0
    hysteresis: float = 0.0
    dwell: float = 10.0
    by_senses: bool = False

    def rates(self) -> np.ndarray:
        """The sweep: through zero and back, or one sense after the other."""
        if self.by_senses:
            up = np.arange(STEPS + 1) * STEP
            return np.concatenate([up, up[::-1], -up[1:], -up[::-1]])
        rates = STEP * (np.arange(-STEPS, STEPS + 1) + 0.25)
        return np.concatenate([rates, rates[-2::-1]])


CASES = (
    Case("steps alone"),
    Case("drift of 2 steps", drift=2.0),
    Case("drift of 2 steps, one sense after the other", drift=2.0, by_senses=True),
    Case("drift of 5 steps and hysteresis of 1.5", drift=5.0, hysteresis=1.5),
    Case("noise that slips", walk=0.5e-4, dwell=2.0),
    Case("noise that rounds, drift of 2 steps", walk=1.5e-4, drift=2.0, dwell=2.0),
)


def deviations(case: Case, seed: int) -> list[float]:
    """Deviations of lock-in rate, bias, corner and drift from the truth, over their uncertainties."""
    rng, rates = np.random.default_rng(seed), case.rates()
    lock_in, bias = rng.uniform(0.8, 1.3) * WL, rng.uniform(-0.3, 0.3) * WL
    drift, capture = case.drift * STEP, lock_in - case.hysteresis * STEP
    pulses = simulate_sweep(
        rates,
        case.dwell,
        scale_factor=K,
        lock_in_rate=lock_in,
        random_walk=case.walk,
        bias_rate=bias + drift * np.linspace(-0.5, 0.5, rates.size),
        capture_rate=capture,
        seed=seed,
    )
    band, true = find_dead_band(rates, pulses, case.dwell, scale_factor=K), (lock_in + capture) / 2
    return [
        (band.lock_in_rate - true) / band.lock_in_rate_u,
        (band.bias_rate - bias) / band.bias_rate_u,
        (band.corner_rate - true) / band.corner_rate_u,
        (band.drift - drift) / band.drift_u,
    ]


def main() -> None:
    """Print the table."""
    sweeps = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    sys.stdout.write(
        f"{sweeps} sweeps each: rms of (found - true) / u, share of 95 % intervals that hold the truth\n"
        f"{'':46}{'lock-in rate':>15}{'bias':>15}{'corner':>15}{'drift':>15}\n"
    )
    for case in CASES:
        found = np.array([deviations(case, seed) for seed in range(sweeps)])
        pull, covered = np.sqrt(np.mean(found**2, axis=0)), np.mean(np.abs(found) < 1.96, axis=0)
        cells = "".join(f"{p:8.2f} {100 * c:4.0f} %" for p, c in zip(pull, covered, strict=True))
        sys.stdout.write(f"{case.name:46}{cells}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
