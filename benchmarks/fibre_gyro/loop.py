"""`python -m benchmarks.fibre_gyro`: speed of the simulated fibre gyro, and whether it has the laws of a real one.

One gyro of 1000 m of fibre on 100 mm at 1.55 um, 16-bit converter, angle random walk 0.005 deg/sqrt(h), at every
transit time unless a line says otherwise. Every number stands beside its prediction, with the standard deviation
that white noise gives it; the benchmark fails if one is further off than four of these. Takes one to three
minutes with Numba; `--seconds 5` is a quick look, `--table loop` makes the 540 s runs by transit times, too.
"""

from __future__ import annotations

import argparse
import importlib
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.fibre_gyro import (
    ClosedLoop,
    FibreCoil,
    Kernel,
    LoopDesign,
    OutputModel,
    estimate_two_pi_error,
    fit_slope,
    odd_even_parts,
    predicted_self_scale,
    predicted_table_scale,
    rate_differences,
    table_runs,
    turn_time,
    vertical_earth_rate_dph,
)

COIL = FibreCoil(length_m=1000.0, diameter_m=0.1, wavelength_m=1.55e-6, group_index=1.468)
PROTOTYPE = LoopDesign(adc_bits=14, angle_random_walk_deg_per_sqrt_h=0.005)
K0 = COIL.nominal_scale(16)
LATITUDE_DEG, BIAS_DPH = 45.78, 0.02
RATES = (0.1, 1.0, 10.0, 20.0)
PPM, FAR = 1e6, 4.0


@dataclass(frozen=True)
class Line:
    """One number: measured, predicted, and the standard deviation of the difference (0: exact to the digits)."""

    name: str
    measured: float
    predicted: float
    sigma: float

    @property
    def holds(self) -> bool:
        """Whether the difference is within `FAR` standard deviations."""
        return abs(self.measured - self.predicted) <= FAR * self.sigma


def print_lines(title: str, unit: str, lines: Iterator[Line]) -> bool:
    """Print a table as its lines come; returns whether all of them hold."""
    out = sys.stdout.write
    out(f"\n{title}, {unit}\n\n| | measured | predicted | sigma | off, sigmas | |\n|---|---|---|---|---|---|\n")
    kept = True
    for line in lines:
        off = (line.measured - line.predicted) / line.sigma
        out(f"| {line.name} | {line.measured:.6g} | {line.predicted:.6g} | {line.sigma:.2g} | {off:+.1f} ")
        out(f"| {'' if line.holds else 'FAILS'} |\n")
        sys.stdout.flush()
        kept = kept and line.holds
    return kept


# ------------------------------------------------------------------ speed


def steps_per_second(kernel: Kernel, runs: int, seconds: float) -> float:
    """Transit times of all gyros together, per second of computing."""
    gyro = ClosedLoop(COIL, PROTOTYPE, runs=runs, kernel=kernel)
    gyro.run(1, output_period_s=1e-3, rate_dps=20.0)
    outputs, began = 0, time.perf_counter()
    while (spent := time.perf_counter() - began) < seconds:
        gyro.run(10, rate_dps=20.0)
        outputs += 10
    return runs * outputs * 0.01 / COIL.transit_time / spent


def print_speed(seconds: float) -> None:
    """The kernels; plain Python in a process of its own, where Numba is hidden."""
    out = sys.stdout.write
    out("Steps (transit times of one gyro) per second of computing\n\n")
    out("| kernel | gyros | steps/s |\n|---|---|---|\n")
    if importlib.import_module("analysis.fibre_gyro.loop.compiled_kernel").COMPILED:
        out(f"| compiled by Numba | 1 | {steps_per_second('numba', 1, seconds):.3g} |\n")
    hidden = (
        "import sys; sys.modules['numba'] = None; from benchmarks.fibre_gyro.loop import steps_per_second; "
        f"print(steps_per_second('auto', 1, {seconds}))"
    )
    plain = subprocess.run([sys.executable, "-c", hidden], check=True, capture_output=True, text=True)
    out(f"| plain Python | 1 | {float(plain.stdout):.3g} |\n")
    for runs in (1, 24, 96):
        out(f"| NumPy | {runs} | {steps_per_second('numpy', runs, seconds):.3g} |\n")
        sys.stdout.flush()


# ------------------------------------------------------------------ scale factor


def mean_output(
    design: LoopDesign, rate: float, seconds: float, *, step: float = 0.0, seed: int = 1, coil: FibreCoil = COIL
) -> float:
    """Mean output of a settled gyro, counts."""
    gyro = ClosedLoop(coil, design, seed)
    gyro.run(1, rate_dps=rate, injected_step=step)
    return float(gyro.run(1, output_period_s=seconds, rate_dps=rate, injected_step=step).counts[0])


def both_senses(rates: Sequence[float]) -> list[float]:
    """Each rate and its opposite."""
    return [sense * rate for rate in rates for sense in (1, -1)]


def slope(outputs: Callable[[float, int], float], rates: Sequence[float], first_seed: int) -> float:
    """Slope over the nominal scale of `outputs` (of rate and seed) by least squares."""
    signed = both_senses(rates)
    return fit_slope(signed, [outputs(rate, seed) for seed, rate in enumerate(signed, first_seed)]).slope / K0


def slope_sigma(seconds: float, rates: Sequence[float], design: LoopDesign = PROTOTYPE) -> float:
    """Standard deviation of such a slope from white noise; pairs that hold a fall do not measure in mode G."""
    walk = design.angle_random_walk_deg_per_sqrt_h / 60.0 / math.sqrt(seconds)
    lost = [2 * rate * K0 / design.codes if design.gated else 0.0 for rate in rates]
    weighted = sum(2 * rate**2 / (1 - part) for rate, part in zip(rates, lost, strict=True))
    return walk * math.sqrt(weighted) / sum(2 * rate**2 for rate in rates)


def table_slope(
    design: LoopDesign, seconds: float, first_seed: int, rates: Sequence[float] = RATES, coil: FibreCoil = COIL
) -> float:
    """K of the rate table over K0."""
    return slope(lambda rate, seed: mean_output(design, rate, seconds, seed=seed, coil=coil), rates, first_seed)


def injected_slope(
    design: LoopDesign, seconds: float, first_seed: int, rates: Sequence[float] = RATES, coil: FibreCoil = COIL
) -> float:
    """K of the injection of K0 times the rate, at rest with the earth's rate, over K0."""
    earth = (vertical_earth_rate_dph(LATITUDE_DEG) + BIAS_DPH) / 3600.0
    static = mean_output(design, earth, seconds, seed=first_seed, coil=coil)

    def net(rate: float, seed: int) -> float:
        return mean_output(design, earth, seconds, step=K0 * rate, seed=seed, coil=coil) - static

    return slope(net, rates, first_seed + 1)


def table_prediction(change: float, eps: float, rates: Sequence[float], *, gated: bool) -> float:
    """K of the rate table over K0, for the fit to these rates.

    With all samples used, the change in the third order comes from the height of the pulse at a fall in the sine.
    At high rates the loop has not yet followed all of the pulse before: what is left of it lowers the next one.
    """
    scale = predicted_table_scale(change, eps, gated=gated)
    if gated:
        return scale
    kept = 1.0 - PROTOTYPE.loop_gain
    lowered, weight = 0.0, sum(rate**2 for rate in rates)
    for rate in rates:
        pairs = 65536 / (2 * K0 * rate)
        left = PROTOTYPE.loop_gain / 2 * kept ** (pairs - 1) / (1 - kept**pairs)
        lowered += rate**2 / weight * (1 - left) ** 3
    return 1 + change + (scale - 1 - change) * lowered


def scale_against_error(seconds: float) -> Iterator[Line]:
    """Slope of the rate table against the 2 pi error, in both modes; 10 and 20 deg/s in both senses."""
    for place, gated in enumerate((True, False)):
        for which, eps in enumerate((0.0, 1e-4, 1e-3, 5e-3, 1e-2, -5e-3)):
            design = replace(PROTOTYPE, two_pi_error=eps, gated=gated)
            measured = PPM * (table_slope(design, seconds, 1000 + 100 * place + 10 * which, RATES[2:]) - 1)
            predicted = PPM * (table_prediction(0.0, eps, RATES[2:], gated=gated) - 1)
            sigma = PPM * slope_sigma(seconds, RATES[2:], design)
            yield Line(f"{'G' if gated else 'U'}, eps = {eps:+g}", measured, predicted, sigma)


def self_calibration(seconds: float) -> Iterator[Line]:
    """K of injection and of the rate table over K0, and of one over the other, for each build."""
    second = replace(PROTOTYPE, two_pi_error=0.003, injection_path="separate")
    cases = (
        ("eps = 0", PROTOTYPE, COIL, RATES),
        ("eps = +0.1 %, gated", replace(PROTOTYPE, two_pi_error=1e-3), COIL, RATES),
        ("eps = +1 %, gated", replace(PROTOTYPE, two_pi_error=1e-2), COIL, RATES),
        ("eps = +1 %, all samples", replace(PROTOTYPE, two_pi_error=1e-2, gated=False), COIL, RATES),
        ("L D/lambda +100 ppm", PROTOTYPE, COIL.scaled(1 + 1e-4), RATES),
        ("second electrode, eps = +0.3 %, gated, to 1 deg/s", second, COIL, RATES[:2]),
    )
    for case, (name, design, coil, rates) in enumerate(cases):
        eps, gated = design.two_pi_error, design.gated
        path = "shared" if design.injection_path == "shared" else "second electrode"
        predicted_self = predicted_self_scale(path, eps, gated=gated)
        change = coil.nominal_scale(16) / K0 - 1
        predicted_table = table_prediction(change, eps, rates, gated=gated)
        found_self = injected_slope(design, seconds, 2000 + 100 * case, rates, coil)
        found_table = table_slope(design, seconds, 2050 + 100 * case, rates, coil)
        sigma = PPM * slope_sigma(seconds, rates, design)
        yield Line(f"{name}: K_self/K0 - 1", PPM * (found_self - 1), PPM * (predicted_self - 1), sigma)
        yield Line(f"{name}: K_table/K0 - 1", PPM * (found_table - 1), PPM * (predicted_table - 1), sigma)
        ratio, predicted = found_self / found_table, predicted_self / predicted_table
        yield Line(f"{name}: K_self/K_table - 1", PPM * (ratio - 1), PPM * (predicted - 1), sigma * math.sqrt(2))


# ------------------------------------------------------------------ rate-table run


def rate_table_part(kind: type[ClosedLoop] | type[OutputModel]) -> Iterator[Line]:
    """Three axes, four rates in both senses, 30 whole turns each: K, the differences, the even part."""
    design = replace(PROTOTYPE, bias_dph=BIAS_DPH)
    walk, earth = design.angle_random_walk_deg_per_sqrt_h / 60.0, vertical_earth_rate_dph(LATITUDE_DEG)
    for axis, name in enumerate("XYZ"):
        rates = np.array(both_senses((20.0, 20.01, 20.1, 21.0)))
        windows = np.array([30 * turn_time(rate) for rate in rates])
        # of the pairs at 20 deg/s 15 % hold a fall, and do not measure
        mean_u = K0 * walk / np.sqrt(windows * (1 - 2 * np.abs(rates) * K0 / 65536))
        means = []
        for place, (rate, window) in enumerate(zip(rates, windows, strict=True)):
            gyro = kind(COIL, design, 1000 * axis + place)
            gyro.run(1, rate_dps=rate)
            block = gyro.run(1, output_period_s=float(window), rate_dps=float(rate + earth / 3600.0))
            means.append(float(block.counts[0]))
        parts = odd_even_parts(table_runs(rates, means, mean_u))
        differences = rate_differences(parts, irreproducibility_ppm=0.0)
        base = parts.odd[0] / (20.0 * K0)
        yield Line(f"{name}: K from D(20), ppm of K0", PPM * (base - 1), 0.0, PPM * parts.odd_u[0] / (20.0 * K0))
        for delta, number, u in zip(differences.delta_dps, differences.number, differences.noise_u, strict=True):
            error = PPM * (number / (K0 * delta) - 1)
            yield Line(f"{name}: N({delta:g}), ppm of it", error, 0.0, PPM * u / (K0 * delta))
        even = 3600.0 / K0 * parts.even.mean()
        even_u = 3600.0 / K0 * float(np.sqrt(np.sum(parts.even_u**2))) / parts.even.size
        yield Line(f"{name}: even part, deg/h", even, earth + BIAS_DPH, even_u)


def noise_of_differences() -> Iterator[Line]:
    """Scatter of the mean of 540 s at 0.005 deg/sqrt(h) over many runs, by output words: 3.59e-6 deg/s."""
    gyro = OutputModel(COIL, PROTOTYPE, runs=1000)
    gyro.run(1)
    scatter = float(gyro.run(1, output_period_s=540.0).counts.std(ddof=1)) / K0
    predicted = 0.005 / 60.0 / math.sqrt(540.0)
    yield Line("of 1000 runs", 1e6 * scatter, 1e6 * predicted, 1e6 * predicted / math.sqrt(2000))


# ------------------------------------------------------------------ errors of the electronics


def open_loop(seconds: float) -> Iterator[Line]:
    """eps from an open-loop injection of both senses, two steps."""
    steps = np.array([4095.0, -4095.0, 2501.0, -2501.0])
    for eps in (1e-3, 3e-3, -2e-3, 1e-2):
        gyro = ClosedLoop(COIL, replace(PROTOTYPE, two_pi_error=eps), runs=4)
        block = gyro.run(
            100, output_period_s=seconds / 400, rate_dps=0.003, injected_step=steps[:, None], closed=False
        )
        errors = (block.normal_error, block.reset_error)
        means, us = [e.mean(axis=1) for e in errors], [e.std(axis=1, ddof=1) / 10 for e in errors]
        result = estimate_two_pi_error(steps, *means, *us, dac_bits=16)
        yield Line(f"eps = {eps:+g}", 1e6 * result.two_pi_error, 1e6 * eps, 1e6 * result.two_pi_error_u)


def ripple() -> Iterator[Line]:
    """Standard deviation of 10 ms words at 0.01 deg/s with all samples used: white noise and falls."""
    quiet = replace(PROTOTYPE, gated=False, angle_random_walk_deg_per_sqrt_h=0.0005)
    # rounding of the detector's converter is white as well
    noise = quiet.detector_noise(COIL)
    white = 0.0005 * 60 / math.sqrt(0.01) * math.sqrt(1 + 1 / 12 / noise**2)
    for eps in (0.0, 1e-3, 1e-2):
        gyro = ClosedLoop(COIL, replace(quiet, two_pi_error=eps))
        gyro.run(1, rate_dps=0.01)
        found = 3600.0 / K0 * float(gyro.run(2000, rate_dps=0.01).counts.std(ddof=1))
        share = 0.01 * K0 / 65536 * 0.01 / COIL.transit_time
        jump = 65536 * eps * COIL.transit_time / 0.01 / K0 * 3600.0
        predicted = math.hypot(white, jump * math.sqrt(share * (1 - share)))
        # falls are regular, not random, and are spread over 50 us: 3 % beside the statistics
        yield Line(f"eps = {eps:g}", found, predicted, predicted * math.hypot(1 / math.sqrt(4000), 0.01))


def bow(seconds: float) -> Iterator[Line]:
    """Change of the rate table's slope by a bow of the converter, same noise with and without."""
    for name, change, predicted in (
        ("quadratic 1e-3, gated", {"inl_quadratic": 1e-3}, 0.0),
        ("cubic 4e-3, gated", {"inl_cubic": 4e-3}, 226.0),
        ("quadratic 1e-3, all samples", {"inl_quadratic": 1e-3, "gated": False}, 0.0),
        ("cubic 4e-3, all samples", {"inl_cubic": 4e-3, "gated": False}, 0.0),
    ):
        design = replace(PROTOTYPE, **change)
        plain = replace(design, inl_quadratic=0.0, inl_cubic=0.0)
        found, without = (table_slope(build, seconds, 1) for build in (design, plain))
        yield Line(name, PPM * (found - without), predicted, PPM * slope_sigma(seconds, RATES, design))


def print_dead_zone(seconds: float) -> None:
    """Error of small rates with and without noise, and where the light level lies in a step of the converter."""
    out = sys.stdout.write
    out("\nDead zone: error of the mean output, % of the rate\n\n")
    out("| detector bits | walk, deg/sqrt(h) | light level | 0.1 deg/s | 0.01 | 0.001 | sigma at 0.01 |\n")
    out("|---|---|---|---|---|---|---|\n")
    for bits in (12, 14):
        for walk, offset in ((0.0, 0.0), (0.0, 0.5), (0.0005, 0.0), (0.0005, 0.5), (0.002, 0.0), (0.002, 0.5)):
            level = "in mid-step" if offset else "at a threshold"
            design = replace(PROTOTYPE, adc_bits=bits, adc_offset=offset, angle_random_walk_deg_per_sqrt_h=walk)
            errors = [100 * (mean_output(design, r, seconds) / (r * K0) - 1) for r in (0.1, 0.01, 0.001)]
            out(f"| {bits} | {walk:g} | {level} | " + " | ".join(f"{e:.2f}" for e in errors))
            out(f" | {100 * walk / 60 / math.sqrt(seconds) / 0.01:.2f} |\n")
            sys.stdout.flush()


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, and return 0 if every number holds."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.fibre_gyro", description="Speed and laws of the simulated fibre gyro."
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="gyro time of each run (default 60)")
    parser.add_argument("--table", choices=("words", "loop"), default="words", help="how to make the 540 s runs")
    options = parser.parse_args(arguments)
    seconds = options.seconds
    print_speed(2.0)
    factor = COIL.sagnac_factor
    sys.stdout.write(
        f"\ntransit time {1e6 * COIL.transit_time:.4f} us, Sagnac factor {factor:.5f} s, K0 {K0:.6f}\n"
    )
    table = ClosedLoop if options.table == "loop" else OutputModel
    how = "by transit times" if options.table == "loop" else "by output words"
    kept = [
        print_lines("Slope of the rate table, less 1", "ppm of K0", scale_against_error(seconds)),
        print_lines(f"Self-calibration, {seconds:g} s a rate", "ppm", self_calibration(seconds)),
        print_lines(f"Rate-table run of 30 whole turns, {how}", "see lines", rate_table_part(table)),
        print_lines("Scatter of means of 540 s", "1e-6 deg/s", noise_of_differences()),
        print_lines("2 pi error in open loop, 5 s", "1e-6", open_loop(5.0)),
        print_lines("Ripple of 10 ms words at 0.01 deg/s", "deg/h", ripple()),
        print_lines("Bow of the converter: change of the slope", "ppm", bow(seconds / 3)),
    ]
    print_dead_zone(min(seconds, 5.0))
    return 0 if all(kept) else 1


if __name__ == "__main__":
    sys.exit(main())
