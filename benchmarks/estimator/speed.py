"""Time per record of the estimator against yardsticks that run in the same minute on the same machine."""

from __future__ import annotations

import multiprocessing
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.fft
from scipy.integrate import solve_ivp
from scipy.optimize import OptimizeWarning, curve_fit

from analysis import beat_signal, estimate_lock_in, rate_varying_beat
from analysis.arrays import Floats
from benchmarks.estimator.gyros import N_SAMPLES, codes_of, draw_gyros, white_noise
from benchmarks.estimator.methods.general_fit import fit_curve
from benchmarks.estimator.progress import Progress

ROUNDS = 9
SMALLER_BATCHES = 1000, 200
"""Records for which the cost of calling NumPy shows."""

FEW = 25
"""Records given to the slow yardsticks."""

TOLERANCE = 1e-12
"""Of the integrator: its beat is then still further from the truth than the closed form, see `Speed.accuracy`."""


@dataclass(frozen=True)
class Speed:
    """One comparison: seconds per record of ours and of the yardstick, and the ratio to quote.

    accuracy is empty or says how far the two results are apart.
    """

    what: str
    ours: float
    yardstick: float
    ratio: float
    accuracy: str = ""


def measure_speed(n_records: int, seed: int) -> list[Speed]:
    """All comparisons, with batches of `n_records`."""
    rng = np.random.default_rng([seed, 300])
    far, near = (_codes(rng, n_records, limits) for limits in ((3.0, 100.0), (1.02, 3.0)))
    smaller = [few for few in SMALLER_BATCHES if few < n_records]
    with Progress("speed", 8 + len(smaller)) as progress:
        results = []
        for what, codes in (
            (f"W/WL 3 to 100, batches of {n_records}", far),
            (f"W/WL 1.02 to 3, batches of {n_records}", near),
            *((f"W/WL 3 to 100, batches of {few}", far[:few]) for few in smaller),
        ):
            ours, fft = _alternate([partial(_estimate, codes), partial(scipy.fft.rfft, codes, axis=1)])
            results.append(Speed(f"estimate / rfft, {what}", ours / len(codes), fft / len(codes), ours / fft))
            progress.done()
        results.append(_against_curve_fit(far, results[0].ours))
        progress.done()
        for against in (_against_closed_form, _against_physical_fit):
            results.append(against(far, results[0].ours))
            progress.done()
        results.append(_two_processes(far))
        progress.done()
        results.append(_synthesis(rng, n_records))
        progress.done()
        results.append(_synthesis_of_a_moving_rate(rng, n_records))
        progress.done()
    return results


def _codes(rng: np.random.Generator, n_records: int, rate_over_lock_in: tuple[float, float]) -> Floats:
    gyros = draw_gyros(rng, n_records, rate_over_lock_in=rate_over_lock_in)
    return codes_of(gyros, white_noise(rng, gyros))


def _estimate(codes: Floats) -> None:
    estimate_lock_in(codes, 1.0, scale_factor=1.0)


def _alternate(works: list[Callable[[], object]]) -> list[float]:
    """Least seconds of each work over rounds in turn: what a busy neighbour disturbs least."""
    for work in works:
        work()
    taken = np.empty((ROUNDS, len(works)))
    for row in range(ROUNDS):
        for column, work in enumerate(works):
            before = time.perf_counter()
            work()
            taken[row, column] = time.perf_counter() - before
    return [float(seconds) for seconds in taken.min(axis=0)]


def _against_curve_fit(codes: Floats, ours: float) -> Speed:
    before = time.perf_counter()
    with np.errstate(all="ignore"):
        fit_curve(codes[:FEW], np.ones(FEW))
    theirs = (time.perf_counter() - before) / FEW
    what = "curve_fit of the series, from a close start / estimate, W/WL 3 to 100"
    return Speed(what, ours, theirs, theirs / ours)


def _against_physical_fit(codes: Floats, ours: float) -> Speed:
    """The fit as a user of `beat_signal` would write it: rate, lock-in rate, amplitude, two phases, offset."""

    def beat(
        times: Floats, rate: float, lock_in: float, amplitude: float, phase: float, readout: float, offset: float
    ) -> Floats:
        signal = beat_signal(
            times,
            scale_factor=1.0,
            input_rate=rate,
            lock_in_rate=abs(lock_in),
            amplitude=amplitude,
            initial_phase=phase,
            readout_phase=readout,
        )
        return np.asarray(offset + signal)

    def first_two(omega: float) -> tuple[float, float]:
        return omega / (2 * np.pi) * 1.01, omega / (2 * np.pi) * 0.1

    return _against_fit_from_the_peak("beat_signal", beat, first_two, codes, ours)


def _against_closed_form(codes: Floats, ours: float) -> Speed:
    """The fit as one writes it from the closed form: frequency, ratio, amplitude, two phases, offset."""

    def beat(
        times: Floats, omega: float, ratio: float, amplitude: float, phase: float, readout: float, offset: float
    ) -> Floats:
        u = np.exp(1j * (omega * times + phase))
        return np.asarray(offset + amplitude * (1j * (ratio - u) / (1 - ratio * u) * np.exp(1j * readout)).imag)

    return _against_fit_from_the_peak("the closed form", beat, lambda w: (w, 0.05), codes, ours)


def _against_fit_from_the_peak(
    what: str,
    beat: Callable[..., Floats],
    first_two: Callable[[float], tuple[float, float]],
    codes: Floats,
    ours: float,
) -> Speed:
    """curve_fit of a physical model, started at the highest bin of the spectrum."""
    times, gave_up, before = np.arange(float(N_SAMPLES)), 0, time.perf_counter()
    for record in codes[:FEW]:
        spectrum = np.abs(scipy.fft.rfft(record - record.mean()))
        w = 2 * np.pi * float(spectrum.argmax()) / N_SAMPLES
        phase = float(np.angle(np.sum(record * np.exp(-1j * w * times)))) + np.pi / 2
        start = [*first_two(w), np.ptp(record) / 2, phase, 0.0, record.mean()]
        try:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore", OptimizeWarning)
                curve_fit(beat, times, record, p0=start)
        except RuntimeError:
            gave_up += 1
    theirs = (time.perf_counter() - before) / FEW
    return Speed(
        f"curve_fit of {what}, from the FFT peak / estimate, W/WL 3 to 100",
        ours,
        theirs,
        theirs / ours,
        f"curve_fit gave up on {gave_up} of {FEW} records" if gave_up else "",
    )


def _two_processes(codes: Floats) -> Speed:
    """The same work twice: one process after itself, and two processes at once."""
    context = multiprocessing.get_context("spawn")
    with context.Pool(2) as pool:
        pool.map(_worker, [codes[:8]] * 8, chunksize=1)  # both have started and imported
        singles, doubles = [], []
        for _ in range(5):
            singles.append(pool.apply(_worker, (codes,)))
            doubles.append(max(pool.map(_worker, [codes, codes], chunksize=1)))
    single, double = min(singles) / len(codes), min(doubles) / len(codes) / 2
    return Speed("two processes against one (one process on the right)", double, single, single / double)


def _worker(codes: Floats) -> float:
    """Seconds of one of a few estimates; the codes have arrived before the clock starts."""
    before = time.perf_counter()
    for _ in range(4):
        _estimate(codes)
    return (time.perf_counter() - before) / 4


def _synthesis(rng: np.random.Generator, n_records: int) -> Speed:
    """`beat_signal` against an eighth-order integrator at a tolerance where it is no better."""
    gyros = draw_gyros(rng, n_records, periods=(20.0, 200.0))
    times = np.arange(float(N_SAMPLES))
    rate, lock_in = np.abs(gyros.input_rate), gyros.lock_in_rate

    def ours() -> Floats:
        return beat_signal(times, scale_factor=1.0, input_rate=rate, lock_in_rate=lock_in)

    seconds = _alternate([ours])[0] / n_records
    signal = ours()
    worst, before = 0.0, time.perf_counter()
    for row in range(FEW):
        solved = _integrated(lambda _t, row=row: rate[row], lock_in[row], times)
        worst = max(worst, float(np.abs(solved - signal[row]).max()))
    theirs = (time.perf_counter() - before) / FEW
    return Speed("solve_ivp (DOP853) / beat_signal", seconds, theirs, theirs / seconds, _differ(worst))


def _synthesis_of_a_moving_rate(rng: np.random.Generator, n_records: int) -> Speed:
    """`rate_varying_beat` on a rate that ripples by a tenth, with the exact mean rate of each step."""
    gyros = draw_gyros(rng, n_records, periods=(20.0, 200.0), rate_over_lock_in=(1.5, 100.0))
    times = np.arange(float(N_SAMPLES))
    rate, lock_in, ripple = np.abs(gyros.input_rate), gyros.lock_in_rate, 2 * np.pi * 3 / N_SAMPLES
    means = 1 - 0.1 * np.diff(np.cos(ripple * times)) / ripple

    def ours() -> Floats:
        return rate_varying_beat(rate[:, np.newaxis] * means, 1.0, scale_factor=1.0, lock_in_rate=lock_in)

    seconds = _alternate([ours])[0] / n_records
    signal = ours()
    worst, before = 0.0, time.perf_counter()
    for row in range(FEW):
        solved = _integrated(lambda t, row=row: rate[row] * (1 + 0.1 * np.sin(ripple * t)), lock_in[row], times)
        worst = max(worst, float(np.abs(solved - signal[row]).max()))
    theirs = (time.perf_counter() - before) / FEW
    what = "solve_ivp (DOP853) / rate_varying_beat, the rate moving by a tenth"
    return Speed(what, seconds, theirs, theirs / seconds, _differ(worst))


def _integrated(rate: Callable[[float], float], lock_in: float, times: Floats) -> Floats:
    def slope(t: float, phi: Floats) -> Floats:
        return np.asarray(2 * np.pi * (rate(t) - lock_in * np.sin(phi)))

    span = (0.0, float(times[-1]))
    solved = solve_ivp(slope, span, [0.0], method="DOP853", t_eval=times, rtol=TOLERANCE, atol=TOLERANCE)
    return np.asarray(np.sin(solved.y[0]))


def _differ(worst: float) -> str:
    return f"the two beats differ by {worst:.0e} of the amplitude at most"
