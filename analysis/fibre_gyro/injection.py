"""Scale factor from an injected staircase: plan of the numbers, static output, slope, what it can show.

The method of the patent CN104634364A: with the gyro at rest, the number that stands for a rate is added to the
phase staircase; the mean output at each number, less the static output, gives K as a slope. In a closed loop
whose feedback goes through the same adder, converter and electrode, the loop makes the sum of both staircases
zero: the output is the number that was injected, whatever the coil, the wavelength, V_2pi or the converter do.
The predictions here say so with numbers.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Bools, Floats
from analysis.fibre_gyro.rate_table import RateDifferences
from analysis.fibre_gyro.scatter import find_run_scatter

Path = Literal["shared", "separate"]

_PPM = 1e6


@dataclass(frozen=True)
class InjectionPlan:
    """Which step stands for which rate."""

    rate_dps: Floats  # (n,)
    # (n,): step of the staircase each transit time, in counts of the output (codes times the output gain)
    number: Floats
    number_u: Floats  # (n,): standard uncertainty: how well the number stands for the rate
    multiples: Floats  # (n, k): how often each difference is in each number; shape (n, 0) for numbers by scaling


def superposed_numbers(rates_dps: ArrayLike, differences: RateDifferences) -> InjectionPlan:
    """Build the numbers of rates from the differences of a rate-table run: whole multiples, the largest first.

    What is left over after whole multiples of the smallest difference is scaled from it. The odd part at the base
    rate is in every difference, which the uncertainty allows for.

    Parameters
    ----------
    rates_dps : array_like, shape (n,)

    Examples
    --------
    >>> differences = RateDifferences(np.array([0.01, 0.1, 1.0]), np.array([2.5, 24.6, 246.1]),
    ...                               np.zeros(3), np.zeros(3), 20.0, 0.0)
    >>> plan = superposed_numbers([-1.23], differences)
    >>> plan.multiples.tolist(), plan.number.round(6).tolist()
    ([[-3.0, -2.0, -1.0]], [-302.8])
    """
    rates = np.atleast_1d(np.asarray(rates_dps, dtype=np.float64))
    order = np.argsort(-np.abs(differences.delta_dps))
    left, multiples = rates.copy(), np.zeros((rates.size, order.size))
    for place in order:
        times = left / differences.delta_dps[place]
        whole = np.round(times, 9) if place == order[-1] else np.trunc(np.round(times, 4))
        multiples[:, place] = whole
        left = left - whole * differences.delta_dps[place]
    own = np.sqrt(np.maximum(differences.noise_u**2 - differences.base_u**2, 0.0))
    # an irreproducible difference holds its two rates in nearly equal parts
    scatter = differences.irreproducibility_u / np.sqrt(2.0)
    of_own = (multiples**2) @ (own**2 + scatter**2)
    base = differences.base_u**2 + (float(scatter.mean()) ** 2 if scatter.size else 0.0)
    return InjectionPlan(
        rates,
        multiples @ differences.number,
        np.asarray(np.sqrt(of_own + multiples.sum(axis=1) ** 2 * base), dtype=np.float64),
        multiples,
    )


def scaled_numbers(rates_dps: ArrayLike, scale_factor: float, scale_factor_u: float = 0.0) -> InjectionPlan:
    """Numbers of rates as a scale factor times the rate."""
    rates = np.atleast_1d(np.asarray(rates_dps, dtype=np.float64))
    return InjectionPlan(rates, scale_factor * rates, np.abs(scale_factor_u * rates), np.zeros((rates.size, 0)))


def largest_step(dac_bits: int) -> float:
    """Largest step, codes, that a converter of so many bits can hold: half of its range, a phase of pi.

    Examples
    --------
    >>> largest_step(16)
    32767.0
    """
    return float(2 ** (dac_bits - 1) - 1)


def steps_beyond_dac(codes: ArrayLike, dac_bits: int) -> Bools:
    """Tell which injected steps, in codes, the converter cannot make."""
    steps = np.abs(np.asarray(codes, dtype=np.float64))
    return np.asarray(steps > largest_step(dac_bits), dtype=np.bool_)


@dataclass(frozen=True)
class NetOutputs:
    """Outputs with injection, less the static output."""

    output: Floats  # (n,): N_j = N_j0 - N_0, counts; the uncertainty is that of N_j0 alone, N_0 is common to all
    output_u: Floats
    static: float  # N_0: mean of the static outputs before and after; with its uncertainty
    static_u: float
    drift: float  # static output after less that before; with its uncertainty
    drift_u: float


@dataclass(frozen=True)
class SlopeFit:
    """Straight line through outputs against rates."""

    slope: float  # K, counts per deg/s; with its uncertainty
    slope_u: float
    intercept: float  # F_0, counts: the line at rate zero. Not the static mean.; with its uncertainty
    intercept_u: float
    residual: Floats  # (n,): output less line, counts
    chi_square: float  # with the given uncertainties; nan without them
    degrees_of_freedom: int


def fit_slope(rates_dps: ArrayLike, outputs: ArrayLike, outputs_u: ArrayLike | None = None) -> SlopeFit:
    """Fit K and F_0 by least squares."""
    # With equal weights these are the sums of the patent: with M points, K = [sum w F - (1/M) sum w sum F] / [sum
    # w^2 - (1/M) (sum w)^2] and F_0 = mean F - K mean w. Given uncertainties make weights 1/u^2; the standard
    # errors then grow by sqrt(chi^2/degrees of freedom) where the residuals exceed them. Without them the
    # residuals give the standard errors.
    rate, output = (np.asarray(v, dtype=np.float64) for v in (rates_dps, outputs))
    if rate.size < 3 or float(np.ptp(rate)) == 0:
        raise ValueError("a slope with its standard error needs three points at two or more rates")
    weight = np.ones_like(rate) if outputs_u is None else np.asarray(outputs_u, dtype=np.float64) ** -2.0
    total = float(weight.sum())
    centre, level = float(weight @ rate) / total, float(weight @ output) / total
    spread = float(weight @ (rate - centre) ** 2)
    slope = float(weight @ ((rate - centre) * (output - level))) / spread
    intercept = level - slope * centre
    residual = output - intercept - slope * rate
    freedom = rate.size - 2
    chi_square = float(weight @ residual**2)
    variance = chi_square / freedom if outputs_u is None else max(1.0, chi_square / freedom)
    return SlopeFit(
        slope,
        float(np.sqrt(variance / spread)),
        intercept,
        float(np.sqrt(variance * (1 / total + centre**2 / spread))),
        residual,
        chi_square if outputs_u is not None else float("nan"),
        freedom,
    )


@dataclass(frozen=True)
class ScaleComparison:
    """Self-calibration against the rate table."""

    difference_ppm: float  # K_self/K_table - 1
    difference_u_ppm: float
    # K_self over the slope of the injected numbers themselves, less 1: what the method really tests
    against_numbers_ppm: float
    against_numbers_u_ppm: float


def compare_scale(
    self_fit: SlopeFit, excess: SlopeFit, table: tuple[float, float], *, numbers_u: float = 0.0
) -> ScaleComparison:
    """Compare the slope of the outputs with the table's scale factor and with the slope of the numbers."""
    ratio, relative_u = self_fit.slope / table[0], self_fit.slope_u / abs(self_fit.slope)
    numbers = self_fit.slope - excess.slope
    return ScaleComparison(
        _PPM * (ratio - 1),
        _PPM * float(np.linalg.norm([relative_u, table[1] / table[0], numbers_u / numbers])),
        _PPM * excess.slope / numbers,
        _PPM * excess.slope_u / abs(numbers),
    )


def predicted_table_scale(scale_change: float = 0.0, two_pi_error: float = 0.0, *, gated: bool) -> float:
    """K of the rate table over the nominal K0.

    Parameters
    ----------
    scale_change : float, optional
        Relative change d of L D/lambda.
    two_pi_error : float, optional
        eps = V_FS/(2 V_pi) - 1: the full range of the converter spans 2 pi (1 + eps).
    gated : bool
        Whether the sample pairs that hold a reset are left out of the integrator. Then the converter sets the
        scale, 1/(1 + eps). Else the bounded phase makes 2 pi itself the scale, to the cubic term of the sine.

    Examples
    --------
    >>> [round(1e6 * (predicted_table_scale(0.0, 0.01, gated=gated) - 1), 2) for gated in (True, False)]
    [-9900.99, -6.58]
    """
    if gated:
        return (1 + scale_change) / (1 + two_pi_error)
    return (1 + scale_change) * (1 - two_pi_error * (2 * np.pi * two_pi_error) ** 2 / 6)


def predicted_self_scale(
    path: Path, two_pi_error: float = 0.0, injection_error: float = 0.0, *, gated: bool
) -> float:
    """K of the self-calibration over the slope of the injected numbers.

    Parameters
    ----------
    path : {"shared", "separate"}
        Through the feedback's own converter and electrode, or through another of its own gain.
    two_pi_error : float, optional
        eps of the feedback path.
    injection_error : float, optional
        The same of the injection path, for the second electrode.
    gated : bool
        As in :func:`predicted_table_scale`.

    Examples
    --------
    >>> predicted_self_scale("shared", 0.01, gated=True)
    1.0
    >>> round(1e6 * (predicted_self_scale("separate", 0.003, gated=True) - 1), 1)
    -2991.0
    """
    if path == "shared":
        return 1.0
    return (1 + injection_error) * predicted_table_scale(0.0, two_pi_error, gated=gated)


def predicted_difference_ppm(numbers_over_nominal: float, self_scale: float, table_scale: float) -> float:
    """Predicted K_self/K_table - 1 in ppm.

    Parameters
    ----------
    numbers_over_nominal : float
        Slope of the injected numbers over K0: 1 for numbers by design, K_table/K0 at the time they were made for
        numbers from a rate-table run.
    self_scale : float
        Of :func:`predicted_self_scale`.
    table_scale : float
        Of :func:`predicted_table_scale`, now.

    Examples
    --------
    The optical scale changed by 100 ppm: the injection still returns the old numbers.

    >>> round(predicted_difference_ppm(1.0, 1.0, predicted_table_scale(1e-4, gated=True)), 2)
    -99.99
    """
    return _PPM * (numbers_over_nominal * self_scale / table_scale - 1)


# --------------------
# The output without rotation or injection, taken off from the outputs with them: its level, and its drift.
#
# GJB style takes the mean of the static outputs before and after. Where they differ by more than their noise, or
# where there are more than two, the level is interpolated in time between them


_SIGNIFICANT = 3.0


@dataclass(frozen=True)
class StaticLevel:
    """Static output at the time of each point."""

    level: Floats  # (n,): counts; with its uncertainty
    level_u: Floats
    mean: float  # of the static outputs before and after; with its uncertainty
    mean_u: float
    drift: float  # last static output less the first, counts; nan with one alone; with its uncertainty
    drift_u: float
    modelled: bool  # whether the level follows the static outputs in time
    # standard uncertainty of a drift that is not modelled, counts per unit of the times; 0 where it is
    unseen_slope_u: float
    weights: Floats  # (n, m): factors of the static outputs in the level of each point


def static_level(times: ArrayLike, static_times: ArrayLike, static: ArrayLike, static_u: ArrayLike) -> StaticLevel:
    """Level of the static output at some times.

    Parameters
    ----------
    times : (n,)
        Of the points, in any unit.
    static_times, static, static_u : (m,)
        Of the static outputs, in the order in which they were taken; counts.

    Raises
    ------
    ValueError
        There is none.

    Examples
    --------
    >>> static_level([1.0, 2.0, 3.0], [0.0, 4.0], [10.0, 14.0], [0.1, 0.1]).level.tolist()
    [11.0, 12.0, 13.0]
    """
    at, when, level, u = (np.asarray(v, dtype=np.float64) for v in (times, static_times, static, static_u))
    if level.size == 0:
        raise ValueError("there is no static output")
    first, last = level[0], level[-1]
    mean, mean_u = float(first + last) / 2, float(np.hypot(u[0], u[-1])) / 2
    if level.size == 1:
        nan = float("nan")
        alone = np.ones((at.size, 1))
        return StaticLevel(alone @ level, alone @ u, mean, float(u[0]), nan, nan, False, 0.0, alone)
    drift, drift_u = float(last - first), float(np.hypot(u[0], u[-1]))
    span = float(when[-1] - when[0]) or 1.0
    modelled = level.size > 2 or abs(drift) > _SIGNIFICANT * drift_u
    if modelled:
        place = np.clip(np.searchsorted(when, at) - 1, 0, when.size - 2)
        part = np.clip((at - when[place]) / (when[place + 1] - when[place]), 0.0, 1.0)
        weights = np.zeros((at.size, when.size))
        weights[np.arange(at.size), place] = 1 - part
        weights[np.arange(at.size), place + 1] += part
        return StaticLevel(
            weights @ level, np.sqrt(weights**2 @ u**2), mean, mean_u, drift, drift_u, True, 0.0, weights
        )
    halves = np.full((at.size, 2), 0.5)
    left = float(np.hypot(drift, drift_u)) / span
    return StaticLevel(halves @ level, np.full(at.size, mean_u), mean, mean_u, drift, drift_u, False, left, halves)


def drift_in_slope(rates: ArrayLike, weights: ArrayLike, times: ArrayLike) -> float:
    """How much of a drift, counts per unit of the times, a weighted line through outputs takes for its slope.

    Examples
    --------
    Rates in rising order take all of it, alternating ones nearly nothing.

    >>> drift_in_slope([-1.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0, 1.0, 2.0])
    1.0
    """
    rate, weight, at = (np.asarray(v, dtype=np.float64) for v in (rates, weights, times))
    total = float(weight.sum())
    centred = rate - float(weight @ rate) / total
    return float(weight @ (centred * (at - float(weight @ at) / total))) / float(weight @ centred**2)


# --------------------
# Numbers as words of a gate array or a processor: whole multiples of 2^-f, and what the rounding makes of them.
#
# A word of w bits, two's complement, of which f are behind the point, holds n 2^-f with -2^(w-1) <= n < 2^(w-1).
# The rounding error is computed from the word itself, as it stands in the text that is written.


LONGEST_WORD = 64
_MOST_FRACTION = 256


@dataclass(frozen=True)
class FixedPoint:
    """Words of one width for several numbers."""

    width: int  # bits of a word, and how many of them are behind the point
    fraction: int
    words: tuple[int, ...]
    values: Floats  # (n,): what the words stand for: words 2^-fraction
    error: Floats  # (n,): rounded less exact number, in its unit and of the number itself; nan of zero
    error_ppm: Floats

    @property
    def largest_error_ppm(self) -> float:
        """Largest of all in size; 0 where every number is zero."""
        known = self.error_ppm[np.isfinite(self.error_ppm)]
        return float(np.abs(known).max()) if known.size else 0.0


def round_to_words(
    numbers: ArrayLike, *, width: int | None = None, fraction: int | None = None, error_ppm: float = 1.0
) -> FixedPoint:
    """Round numbers to words.

    Parameters
    ----------
    numbers : (n,)
    width : int, optional
        Bits of a word, the sign among them; without it as many as are needed.
    fraction : int, optional
        Bits behind the point; without it as many as a given width leaves, or as few as keep every rounding error
        below `error_ppm`.
    error_ppm : float, optional
        Largest rounding error, ppm of each number.

    Raises
    ------
    ValueError
        A number is not finite, or does not fit into the width.

    Examples
    --------
    >>> found = round_to_words([2.4615, 24.615], error_ppm=10.0)
    >>> found.width, found.fraction, found.words, found.error_ppm.round(1).tolist()
    (20, 14, (40329, 403292), [-5.4, -0.4])
    >>> round_to_words([100.0], width=8, fraction=2)
    Traceback (most recent call last):
    ValueError: 100 with 2 bits behind the point takes 10 bits, not 8
    """
    exact = np.atleast_1d(np.asarray(numbers, dtype=np.float64))
    if exact.size == 0 or not np.all(np.isfinite(exact)):
        raise ValueError("there is no number to round, or one that is not finite")
    if fraction is None:
        fraction = _fraction_for(exact, width, error_ppm)
    words = tuple(round(float(one) * 2.0**fraction) for one in exact)
    needed = max(_bits(word) for word in words)
    if width is not None and needed > width:
        largest = float(exact[np.argmax([_bits(word) for word in words])])
        raise ValueError(f"{largest:.6g} with {fraction} bits behind the point takes {needed} bits, not {width}")
    if needed > LONGEST_WORD:
        raise ValueError(
            f"the numbers take {needed} bits; words have {LONGEST_WORD} at most: allow a larger error"
        )
    values = np.array([math.ldexp(word, -fraction) for word in words], dtype=np.float64)
    error = values - exact
    relative = np.full(exact.size, np.nan)
    np.divide(_PPM * error, np.abs(exact), out=relative, where=exact != 0)
    return FixedPoint(needed if width is None else width, fraction, words, values, error, relative)


def _bits(word: int) -> int:
    """Bits of two's complement that hold a word."""
    return (word if word >= 0 else -word - 1).bit_length() + 1


def _fraction_for(exact: Floats, width: int | None, error_ppm: float) -> int:
    if width is not None:
        largest = float(np.abs(exact).max())
        fraction = width - 1 - (math.frexp(largest)[1] if largest else 0)
        # a number next to a power of two may round up to it
        while max(_bits(round(float(one) * 2.0**fraction)) for one in exact) > width:
            fraction -= 1
        return fraction
    smallest = float(np.abs(exact[exact != 0]).min()) if np.any(exact) else 1.0
    # half a unit in the last place is within the error at the latest here
    last = min(max(0, math.ceil(-math.log2(2 * error_ppm / _PPM * smallest))), _MOST_FRACTION)
    for fraction in range(last + 1):
        rounded = np.round(exact * 2.0**fraction) * 2.0**-fraction
        if np.all(np.abs(rounded - exact) <= error_ppm / _PPM * np.abs(exact)):
            return fraction
    return last


# --------------------
# The 2 pi error from an open-loop injection: what the self-calibration in closed loop cannot see.
#
# The feedback is held, and steps large enough to make the staircase fall are injected. With the phase of a step
# phi = 2 pi s (1 + eps)/2^N + phi_0, phi_0 the phase at rest, the mean errors of the demodulated sample pairs are
#
#     without a fall    e_n = -2 A sin(phi)                                                                  (18)
#     with one          e_r = -A [ sin(phi) + sin(phi -+ 2 pi eps) ]      - for s > 0, + for s < 0           (19)
#
# Their ratio does not hold A, so that the light level need not be known; both senses separate phi_0. A, eps and
# phi_0 are fitted to all segments by weighted least squares. What the segments scatter beyond their noise counts
# in the uncertainties, as for the runs of a rate table (`rate_table/scatter.py`).


_ITERATIONS = 20
_CONVERGED = 1e-9  # of the standard uncertainty


@dataclass(frozen=True)
class TwoPiError:
    """Result of the fit."""

    two_pi_error: float  # eps: the converter's range spans 2 pi (1 + eps); with its uncertainty
    two_pi_error_u: float
    amplitude: float  # A, in the unit of the errors; with its uncertainty
    amplitude_u: float
    rest_phase_rad: float  # phi_0: rotation, and the feedback step that was held
    rest_phase_u_rad: float
    chi_square: float
    degrees_of_freedom: int  # two errors a segment less the three parameters
    # to the uncertainty of eps: "normal" and "reset" noise of either kind of pairs, "scatter" beyond both
    contributions: Mapping[str, float]


def estimate_two_pi_error(
    steps: ArrayLike,
    normal_error: ArrayLike,
    reset_error: ArrayLike,
    normal_u: ArrayLike,
    reset_u: ArrayLike,
    *,
    dac_bits: int,
) -> TwoPiError:
    """Fit eps to open-loop segments.

    Choose steps of an odd number of codes, below an eighth of the range: falls then meet both halves of the bias
    equally often, and the sensitivity, cos(phi), is high. At a step of a quarter of the range it is zero.

    Parameters
    ----------
    steps : array_like, shape (n,)
        Injected steps, codes, of both senses.
    normal_error, reset_error : array_like, shape (n,)
        Mean errors of the sample pairs without and with a fall of the staircase, in any one unit.
    normal_u, reset_u : array_like, shape (n,)
        Their standard uncertainties; the scatter that the segments show beyond them counts too. 1.96 of what is
        given are half a 95 % interval.
    dac_bits : int
        N.

    Raises
    ------
    ValueError
        Only one sense, a step beyond half of the range, a segment without falls, or errors that are not those of
        an open loop.

    Examples
    --------
    A step of an eighth of a turn, eps = 0.001, A = 1, no phase at rest. Two segments hardly show what scatter
    there is, so u is wider than by the noise alone (1.6e-06):

    >>> phi = 2 * np.pi * 1.001 / 8 * np.array([1, -1])
    >>> normal, reset = -2 * np.sin(phi), -np.sin(phi) - np.sin(phi - 0.002 * np.pi * np.array([1, -1]))
    >>> result = estimate_two_pi_error([8192, -8192], normal, reset, 1e-6, 1e-5, dac_bits=16)
    >>> round(result.two_pi_error, 9), round(result.amplitude, 9), f"{result.two_pi_error_u:.1e}"
    (0.001, 1.0, '2.9e-06')
    """
    step = np.atleast_1d(np.asarray(steps, dtype=np.float64))
    error = np.stack([np.broadcast_to(np.asarray(v, np.float64), step.shape) for v in (normal_error, reset_error)])
    error_u = np.stack([np.broadcast_to(np.asarray(v, np.float64), step.shape) for v in (normal_u, reset_u)])
    turns = step / 2.0**dac_bits
    _check(step, turns, error, error_u)
    # start without a phase at rest: the ratio of the errors gives eps, then A
    base = 2.0 * np.pi * turns
    ratio = float(np.median((1.0 - error[1] / error[0]) * np.tan(np.abs(base))))
    parameters = np.array([float(np.median(-error[0] / (2.0 * np.sin(base)))), ratio / np.pi, 0.0])
    weight = 1.0 / error_u
    for _ in range(_ITERATIONS):
        model, slopes = _model(parameters, turns)
        matrix = (slopes * weight[..., None]).reshape(-1, 3)
        change, *_rest = np.linalg.lstsq(matrix, ((error - model) * weight).ravel(), rcond=None)
        parameters = parameters + change
        covariance = np.linalg.inv(matrix.T @ matrix)
        if np.all(np.abs(change) <= _CONVERGED * np.sqrt(np.diag(covariance))):
            break
    else:
        raise ValueError("the errors do not fit an open loop: no 2 pi error agrees with them")
    model, slopes = _model(parameters, turns)
    design, left = slopes.reshape(-1, 3), (error - model).ravel()
    scatter = find_run_scatter(design, left + design @ parameters, error_u.ravel(), 0.0)
    factors = scatter.estimator(design, by_known=True)
    u = [scatter.standard_u(row) for row in factors]
    normal_part, reset_part = np.linalg.norm(factors[1].reshape(error.shape) * error_u, axis=1)
    values = [float(v) for pair in zip(parameters, u, strict=True) for v in pair]
    amplitude, amplitude_u, eps, eps_u, rest, rest_u = values
    return TwoPiError(
        two_pi_error=eps,
        two_pi_error_u=eps_u,
        amplitude=amplitude,
        amplitude_u=amplitude_u,
        rest_phase_rad=rest,
        rest_phase_u_rad=rest_u,
        chi_square=float(np.sum((left * weight.ravel()) ** 2)),
        degrees_of_freedom=error.size - 3,
        contributions={
            "normal": float(normal_part),
            "reset": float(reset_part),
            "scatter": scatter.parts(factors[1])["scatter"],
        },
    )


def _check(step: Floats, turns: Floats, error: Floats, error_u: Floats) -> None:
    if step.size < 2 or not (np.any(step > 0) and np.any(step < 0)):
        raise ValueError("the 2 pi error needs injected steps of both senses: at least one of each")
    if np.any(np.abs(turns) >= 0.5) or np.any(step == 0):
        raise ValueError("every injected step must be less than half of the converter's range, and not zero")
    without = step[~np.isfinite(error[1])]
    if without.size:
        raise ValueError(
            f"no sample pair with a fall of the staircase at a step of {without[0]:g} codes: "
            f"use a larger step or a longer record"
        )
    if not (np.all(np.isfinite(error)) and np.all(error_u > 0)):
        raise ValueError("every mean error must be finite, with a positive standard uncertainty")
    if np.any(error[0] * step >= 0):
        raise ValueError(
            "the errors without a fall do not have the sign of the steps reversed: the injection does not "
            "reach the modulator, or the loop is closed"
        )


def _model(parameters: Floats, turns: Floats) -> tuple[Floats, Floats]:
    """Equations (18) and (19), shape (2, n), and their derivatives to A, eps, phi_0, shape (2, n, 3)."""
    amplitude, eps, rest = parameters
    two_pi, sense = 2.0 * np.pi, np.sign(turns)
    phase = two_pi * turns * (1.0 + eps) + rest
    fallen = phase - sense * two_pi * eps
    shape = np.stack([2.0 * np.sin(phase), np.sin(phase) + np.sin(fallen)])
    by_phase = np.stack([2.0 * np.cos(phase), np.cos(phase) + np.cos(fallen)])
    by_eps = two_pi * turns * by_phase
    by_eps[1] -= two_pi * sense * np.cos(fallen)
    slopes = -np.stack([shape, amplitude * by_eps, amplitude * by_phase], axis=-1)
    return np.asarray(-amplitude * shape), slopes
