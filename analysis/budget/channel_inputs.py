"""What receiver, channel and laser do to the second harmonic: distortion, corners, a measured response."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from analysis.arrays import Complexes, Floats
from analysis.budget.bounded import Bounded
from analysis.budget.combination import BudgetInput
from analysis.budget.knowledge import Corner, OperatingPoint
from analysis.budget.unstated import THIRD_ORDER_LEAK, THIRD_ORDER_ON_RATIO
from analysis.channel import gain_on_ratio, high_pass_on_ratio, low_pass_on_ratio
from analysis.errors import NoBudget

_RECTANGLE = math.sqrt(3.0)
_PHASES = 12
_PHASE_LOST = 0.5
"""rad: with a larger uncertainty the phase of the ratio is as good as unknown."""

Factor = Callable[[float | Floats, float | Floats], Complexes]
"""On rho, of beat frequencies and a corner in Hz."""

CORNERS: tuple[tuple[str, str, str, Factor], ...] = (
    ("bandwidth", "bandwidth", "bandwidth of the channel", low_pass_on_ratio),
    ("high_pass", "high_pass", "AC coupling of the channel", high_pass_on_ratio),
    ("gain_corner", "gain", "gain saturation of the laser", gain_on_ratio),
)
"""Name of the line, field of the knowledge, in words, and what such a corner does to rho."""


def channel_inputs(point: OperatingPoint, known: Bounded, slope: float) -> Iterator[BudgetInput]:
    """Lines of everything between the mirrors and the samples."""
    yield distortion_input(point, known, slope)
    yield third_order_input(point, known, slope)
    for name, field, quantity, response in CORNERS:
        if name in known.knowledge.separated:
            yield separated_input(name, quantity)
        else:
            yield _corner(name, quantity, getattr(known.knowledge, field), response, point, slope, known)
    if math.isfinite(known.knowledge.response_u):
        yield response_input(known.knowledge.response_u, -slope * point.ratio)


def separated_input(name: str, quantity: str) -> BudgetInput:
    """The line of something that the records were freed of: its cost is in the noise."""
    note = "does not enter: the records themselves were freed of it"
    return BudgetInput(name, quantity, "1", 0.0, 0.0, "rectangular", 0.0, note=note, common=True)


def response_input(response_u: float, sensitivity: float) -> BudgetInput:
    """The line of a measured response at 2f over that at f, whose relative uncertainty is given."""
    quantity = "response of the channel at 2f over f, measured"
    return BudgetInput("response", quantity, "1", 1.0, response_u, "normal", sensitivity, note="corrected")


def distortion_input(point: OperatingPoint, known: Bounded, slope: float) -> BudgetInput:
    """Second-order distortion d, a real number within its limit.

    A square law adds d to rho = -r exp(-i phase); what it makes of the higher harmonics takes r^2 of it away.
    Where d is not small against r the effect is no straight line: the deviation is taken over the distribution.
    """
    name, quantity, limit = "distortion", "second-order distortion d", known.knowledge.distortion_limit
    if name in known.knowledge.separated:
        return separated_input(name, quantity)
    u, weight = limit / _RECTANGLE, _weight_of_distortion(point, limit)
    phase = "phase unknown" if _phase_lost(point) else "at the phase measured"
    note = known.note(name, f"{level(limit)}, {phase}", f"within ±{limit:.2g} ({level(limit)}), {phase}")
    by_d = slope * (1 - point.ratio**2) * weight
    stated = name not in known.assumed
    return BudgetInput(name, quantity, "1", 0.0, u, "rectangular", by_d, note=note, common=True, stated=stated)


def third_order_input(point: OperatingPoint, known: Bounded, slope: float) -> BudgetInput:
    """Third-order distortion: a share of r, the same at every rate, whose sign the readout phase decides."""
    name, quantity, limit = "third_order", "third-order distortion", known.knowledge.third_order_limit
    if name in known.knowledge.separated:
        return separated_input(name, quantity)
    by_level = slope * (point.ratio * THIRD_ORDER_ON_RATIO + THIRD_ORDER_LEAK / point.periods)
    note = known.note(name, level(limit), f"within ±{limit:.2g} ({level(limit)}), stated or seen in the records")
    stated = name not in known.assumed
    return BudgetInput(
        name,
        quantity,
        "1",
        0.0,
        limit / _RECTANGLE,
        "rectangular",
        by_level,
        note=note,
        common=True,
        stated=stated,
    )


def level(amplitude: float) -> str:
    """A level of a harmonic in words.

    Examples
    --------
    >>> level(0.01), level(0.0)
    ('-40 dBc', 'none')
    """
    return f"{20 * math.log10(amplitude):.0f} dBc" if amplitude > 0 else "none"


def _phase_lost(point: OperatingPoint) -> bool:
    return not (math.isfinite(point.phase) and point.ratio_u < _PHASE_LOST * point.ratio)


def _weight_of_distortion(point: OperatingPoint, limit: float) -> float:
    """Root mean square of what d within its limit makes of r, over that of d itself; signed as its slope.

    At a right angle between the phases d turns rho and makes it longer: the slope is zero, the effect is not.
    """
    if _phase_lost(point):
        phases: Floats = np.arange(_PHASES, dtype=np.float64) * (2 * np.pi / _PHASES)
        weights: Floats = np.full(_PHASES, 1 / _PHASES)
    else:
        spread, shares = np.polynomial.hermite_e.hermegauss(5)
        phases = point.phase + point.ratio_u / point.ratio * np.asarray(spread, dtype=np.float64)
        weights = np.asarray(shares / shares.sum(), dtype=np.float64)
    along = -math.copysign(1.0, point.input_rate) * np.cos(phases)
    sign = math.copysign(1.0, float(along[weights.argmax()]))
    if limit == 0:
        return sign * float(np.sqrt(weights @ along**2))
    places, lengths = np.polynomial.legendre.leggauss(8)
    d = limit * places[:, np.newaxis]
    true = np.sqrt(np.maximum(point.ratio**2 - 2 * point.ratio * d * along + d * d, 0.0))
    mean_square = float(lengths / 2 @ (true - point.ratio) ** 2 @ weights)
    return sign * math.sqrt(mean_square) * _RECTANGLE / limit


def _corner(
    name: str,
    quantity: str,
    corner: Corner,
    response: Factor,
    point: OperatingPoint,
    slope: float,
    known: Bounded,
) -> BudgetInput:
    """A first-order corner, whose `response` is the factor that it puts on rho."""
    frequency, ratio = point.beat_frequency, point.ratio
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = float(abs(response(frequency, corner.hz)))
    if not (corner.hz >= 0 and math.isfinite(factor)):
        raise NoBudget(f"{quantity}: a corner of {corner.hz!r} Hz lets no beat through")
    corrected = corner.corrected and 0 < corner.hz < math.inf
    if corrected and math.sqrt(3) * corner.u_hz < corner.hz:
        by_hz = -slope * ratio * _relative_slope(response, frequency, corner)
        note = f"corrected for, by {1 / factor - 1:+.2%} of r"
        return BudgetInput(name, quantity, "Hz", corner.hz, corner.u_hz, "normal", by_hz, note=note)
    lost = 1 / factor - 1 if corrected else 1 - factor
    if abs(lost) < 1e-12:
        note = "none"
    elif corrected:
        note = f"corrected for a corner that is hardly known: the whole correction, {lost:+.2%} of r, is a limit"
    else:
        note = f"corner {corner.hz:.4g} Hz, not corrected for: the whole effect is a limit"
    return BudgetInput(
        name,
        f"{quantity}: share of r lost",
        "1",
        lost,
        abs(lost) / _RECTANGLE,
        "rectangular",
        slope * ratio,
        note=known.note(name, f"{corner.hz:.4g} Hz", note),
        stated=name not in known.assumed,
    )


def _relative_slope(response: Factor, frequency: float, corner: Corner) -> float:
    """Relative change of the response by the corner, per Hz, such that this times u is the standard deviation.

    The effect goes with the square of the corner: over an uncertainty of a tenth its slope is not constant, so the
    deviation is taken over the distribution (three-point Gauss-Hermite rule; JCGM 100, 5.1.3 allows it).
    """
    reach = math.sqrt(3) * corner.u_hz if corner.u_hz > 0 else 1e-4 * corner.hz
    low, middle, high = (float(abs(response(frequency, corner.hz + side * reach))) for side in (-1, 0, 1))
    mean = (low + 4 * middle + high) / 6
    variance = ((low - mean) ** 2 + 4 * (middle - mean) ** 2 + (high - mean) ** 2) / 6
    return math.copysign(math.sqrt(3 * variance) / (reach * middle), high - low)
