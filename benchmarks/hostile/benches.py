"""Whole measurements on benches that nobody has described: does the result hold, or say that it does not?

Every bench is simulated with a truth of its own and goes the way of `gyrolock measure`: rates are chosen, beats
looked for, records saved and evaluated. What spoils it is drawn from what benches have; `[budget]` states nothing.
"""

from __future__ import annotations

import itertools
import math
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from station.errors import StationError
from station.live.events import Progress
from station.lock_in.measurement import MEASUREMENT
from station.lock_in.settings import load_settings
from station.runs.store import open_run
from station.shell.finish import evaluate_run, start_run

DEFAULT_BENCHES = 40

Sections = dict[str, dict[str, Any]]
Possible = dict[str, Callable[[], dict[str, float]]]

_HARMLESS = frozenset({"rate_wander", "coloured_noise"})
"""Flags that say how a record was fitted, not that its result is in doubt."""

_NOBODY_SAYS = {"distortion_limit_dbc": 0.0, "bandwidth_hz": 0.0, "gain_corner_hz": 0.0}
_SLOWEST_OVER_LOCK_IN, _FASTEST_OVER_LOCK_IN = 3.0, 30.0


@dataclass(frozen=True)
class Bench:
    """One bench: what is wrong with it, in words, and its settings."""

    what: str
    settings: Sections


@dataclass(frozen=True)
class Outcome:
    """What came of a measurement.

    Attributes
    ----------
    truth, lock_in_rate, u_95 : float
        deg/s; the last two nan where there is no result.
    distance : float
        Error of the lock-in rate over half its 95 % interval.
    flags : tuple of str
        Those that put the result in doubt.
    refused : str
        Why there is no result.
    exit_code : int
    """

    bench: Bench
    truth: float
    lock_in_rate: float = math.nan
    u_95: float = math.nan
    distance: float = math.nan
    flags: tuple[str, ...] = ()
    refused: str = ""
    exit_code: int = 0

    @property
    def verdict(self) -> str:
        """One of `VERDICTS`."""
        if self.refused:
            return "refused" if self.exit_code == 4 else "failed"
        if self.distance <= 1:
            return "covered"
        return "flagged" if self.flags else "wrong in silence"


VERDICTS = ("covered", "flagged", "refused", "failed", "wrong in silence")


def spoilt_bench(seed: int) -> Bench:
    """A gyro with some contaminants that nobody has stated, drawn with this seed."""
    draw = np.random.default_rng([seed, 0xBE])
    lock_in = _log_uniform(draw, 0.004, 0.1)
    scale_factor = float(draw.uniform(800.0, 4000.0))
    fastest_beat = scale_factor * lock_in * _FASTEST_OVER_LOCK_IN
    possible: Possible = {
        "second harmonic": lambda: {"second_harmonic_dbc": float(draw.uniform(-60.0, -42.0))},
        "third harmonic": lambda: {"third_harmonic_dbc": float(draw.uniform(-70.0, -45.0))},
        "bandwidth": lambda: {"bandwidth_hz": fastest_beat * _log_uniform(draw, 1.0, 20.0)},
        "gain corner": lambda: {"gain_corner_hz": fastest_beat * _log_uniform(draw, 0.5, 20.0)},
        "table ripple": lambda: {
            "rate_ripple_dps": lock_in * _log_uniform(draw, 1e-3, 2e-2),
            "rate_ripple_hz": _log_uniform(draw, 0.2, 3.0),
        },
        "pump ripple": lambda: {"pump_ripple": _log_uniform(draw, 2e-4, 2e-3), "pump_ripple_hz": 100.0},
        "scale factor": lambda: {"scale_factor_error_ppm": float(draw.normal(0.0, 50.0))},
        "phase of backscatter": lambda: {"backscatter_phase_sum_deg": float(draw.uniform(-40.0, 40.0))},
    }
    return _unstated(draw, seed, lock_in, scale_factor, possible, share=0.5, guess=2.0, tilts=(60.0, 89.0))


def odd_bench(seed: int) -> Bench:
    """The same with more that may be wrong, and by more: of channel, laser, tilt, and what is expected."""
    draw = np.random.default_rng([seed, 0x0DD])
    lock_in = _log_uniform(draw, 0.001, 0.5)
    scale_factor = _log_uniform(draw, 500.0, 4000.0)
    beat = scale_factor * lock_in
    slowest_beat, fastest_beat = beat * _SLOWEST_OVER_LOCK_IN, beat * _FASTEST_OVER_LOCK_IN
    possible: Possible = {
        "second harmonic": lambda: {"second_harmonic_dbc": float(draw.uniform(-60.0, -40.0))},
        "third harmonic": lambda: {"third_harmonic_dbc": float(draw.uniform(-70.0, -40.0))},
        "bandwidth": lambda: {"bandwidth_hz": fastest_beat * _log_uniform(draw, 0.7, 20.0)},
        "AC coupling": lambda: {"ac_corner_hz": slowest_beat * _log_uniform(draw, 0.001, 0.05)},
        "gain corner": lambda: {
            "gain_corner_hz": fastest_beat * _log_uniform(draw, 0.3, 20.0),
            "cross_saturation": float(draw.uniform(0.2, 0.8)),
        },
        "table ripple": lambda: {
            "rate_ripple_dps": lock_in * _log_uniform(draw, 1e-3, 3e-2),
            "rate_ripple_hz": _log_uniform(draw, 0.2, 5.0),
        },
        "pump ripple": lambda: {
            "pump_ripple": _log_uniform(draw, 2e-4, 5e-3),
            "pump_ripple_hz": _log_uniform(draw, 50.0, 300.0),
        },
        "scale factor": lambda: {"scale_factor_error_ppm": float(draw.normal(0.0, 50.0))},
        "drift of it": lambda: {"scale_factor_drift_ppm_per_hour": float(draw.normal(0.0, 50.0))},
        "light of single beams": lambda: {"single_beams": float(draw.uniform(0.0, 0.3))},
        "phase of backscatter": lambda: {"backscatter_phase_sum_deg": float(draw.uniform(-60.0, 60.0))},
    }
    return _unstated(draw, seed, lock_in, scale_factor, possible, share=0.4, guess=10.0, tilts=(0.0, 89.7))


def _unstated(
    draw: np.random.Generator,
    seed: int,
    lock_in: float,
    scale_factor: float,
    possible: Possible,
    *,
    share: float,
    guess: float,
    tilts: tuple[float, float],
) -> Bench:
    """A bench with a share of what is possible, its lock-in rate guessed wrong by up to a factor, tilts in deg."""
    names = [name for name in possible if draw.random() < share]
    contaminants: dict[str, float] = dict(_CLEAN)
    for name in names:
        contaminants |= possible[name]()
    settings: Sections = {
        "gyro": {
            "scale_factor_pulses_per_deg": scale_factor,
            "expected_lock_in_rate_dps": lock_in * _log_uniform(draw, 1 / guess, guess),
        },
        "site": {"latitude_deg": float(draw.uniform(-60.0, 60.0))},
        "simulation": {
            "seed": seed,
            "link": "tcp",
            "lock_in_rate_dps": lock_in,
            "tilt_deg": float(draw.uniform(*tilts)),
            "backscatter_phase_deg": float(draw.uniform(0.0, 360.0)),
            "amplitude_v": _log_uniform(draw, 0.05, 2.0),
            "contaminants": contaminants,
        },
        "budget": _NOBODY_SAYS,
    }
    settings["simulation"]["detector_noise_v"] = settings["simulation"]["amplitude_v"] * 0.008
    return Bench(", ".join(names) or "nothing", settings)


def slow_or_fast_bench(seed: int) -> Bench:
    """The shipped bench with another gyro: lock-in from 0.0005 to 2 deg/s, 200 to 5000 pulses a degree."""
    draw = np.random.default_rng([seed, 0x5F])
    return shipped_bench(_log_uniform(draw, 0.0005, 2.0), _log_uniform(draw, 200.0, 5000.0), seed)


def shipped_bench(lock_in: float, scale_factor: float, seed: int) -> Bench:
    """The shipped bench with a gyro of this lock-in rate, deg/s, and scale factor, pulses per degree."""
    gyro = {"scale_factor_pulses_per_deg": scale_factor, "expected_lock_in_rate_dps": lock_in}
    simulation = {"seed": seed, "link": "tcp", "lock_in_rate_dps": lock_in}
    what = f"{lock_in:.2g} deg/s, {scale_factor:.0f} pulses/deg"
    return Bench(what, {"gyro": gyro, "simulation": simulation})


def measured(bench: Bench) -> Outcome:
    """Measure on a bench, as `gyrolock measure` does it, and compare with the truth."""
    truth = float(bench.settings["simulation"]["lock_in_rate_dps"])
    with tempfile.TemporaryDirectory() as folder:
        settings = load_settings(overrides={**bench.settings, "output": {"directory": folder}})
        try:
            taken = start_run(MEASUREMENT, settings, Progress())
            if taken.failure is not None:
                failure = taken.failure
                return Outcome(bench, truth, refused=failure.message, exit_code=failure.exit_code)
            result = evaluate_run(open_run(Path(taken.path))).result
        except StationError as error:
            return Outcome(bench, truth, refused=str(error), exit_code=error.exit_code)
    flags = tuple(flag for flag in result.flags if flag not in _HARMLESS)
    if result.problem:
        return Outcome(bench, truth, refused=result.problem, exit_code=4, flags=flags)
    value, low, high = (float(result.document[name]) for name in _NUMBERS)
    beyond = value - truth if truth < value else truth - value
    half = value - low if truth < value else high - value
    return Outcome(bench, truth, value, (high - low) / 2, beyond / half if half > 0 else math.inf, flags)


_NUMBERS = ("lock_in_rate_dps", "lock_in_rate_low_95_dps", "lock_in_rate_high_95_dps")

_CLEAN = {
    "second_harmonic_dbc": -200.0,
    "third_harmonic_dbc": -200.0,
    "bandwidth_hz": 0.0,
    "gain_corner_hz": 0.0,
    "rate_ripple_dps": 0.0,
    "pump_ripple": 0.0,
    "scale_factor_error_ppm": 0.0,
}


def benches_table(title: str, outcomes: Sequence[Outcome]) -> str:
    """One line for each measurement, and how many ended how."""
    lines = [title, "", f"{'':>3}  {'ended':<16} {'error/U95':>9} {'U95, %':>7}  bench"]
    for number, one in enumerate(outcomes, start=1):
        percent = 100 * one.u_95 / one.truth
        what = one.bench.what + (f"; {', '.join(one.flags)}" if one.flags else "")
        if one.refused:
            what += f"; {one.refused}"
        lines.append(f"{number:>3}  {one.verdict:<16} {one.distance:>9.2f} {percent:>7.3f}  {what}")
    counted = Counter(one.verdict for one in outcomes)
    found = [100 * one.u_95 / one.truth for one in outcomes if math.isfinite(one.u_95)]
    told = ", ".join(f"{verdict} {counted[verdict]}" for verdict in VERDICTS)
    median = f"; U95 {np.median(found):.2g} % in the median" if found else ""
    return "\n".join([*lines, "", f"of {len(outcomes)}: {told}{median}"])


def run(seed: int = 1, count: int = DEFAULT_BENCHES) -> str:
    """Measure on `count` benches of each kind; return a table for each."""
    kinds: dict[str, Callable[[int], Bench]] = {
        "Benches with contaminants that nobody has stated": spoilt_bench,
        "Odd benches, with more of them": odd_bench,
        "Slow and fast gyros on the shipped bench": slow_or_fast_bench,
    }
    return "\n\n".join(benches_table(what, _all(make, range(seed, seed + count))) for what, make in kinds.items())


GRID_LOCK_IN = (0.0005, 0.002, 0.01, 0.05, 0.25, 1.0, 2.0)
GRID_SCALE_FACTORS = (200.0, 1000.0, 5000.0)


def grid(seed: int, count: int) -> str:
    """Measure with every gyro of the grid on the shipped bench, `count` seeds each; return one line for each."""
    lines = [f"Every gyro of a grid on the shipped bench, {count} seeds", ""]
    lines.append(f"{'deg/s':>7} {'pulses/deg':>10} {'U95 median, %':>14} {'largest, %':>11}  ended")
    for lock_in, scale_factor in itertools.product(GRID_LOCK_IN, GRID_SCALE_FACTORS):
        outcomes = _all(partial(shipped_bench, lock_in, scale_factor), range(seed, seed + count))
        found = [100 * one.u_95 / one.truth for one in outcomes if math.isfinite(one.u_95)] or [math.nan]
        counted = Counter(one.verdict for one in outcomes)
        told = ", ".join(f"{verdict} {counted[verdict]}" for verdict in VERDICTS if counted[verdict])
        size = f"{np.median(found):>14.3g} {max(found):>11.3g}"
        lines.append(f"{lock_in:>7g} {scale_factor:>10.0f} {size}  {told}")
    return "\n".join(lines)


def _all(make: Callable[[int], Bench], seeds: Iterable[int]) -> list[Outcome]:
    return [measured(make(seed)) for seed in seeds]


def _log_uniform(draw: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(draw.uniform(math.log(low), math.log(high))))
