"""From the volts at the BNC to eight-bit codes: coupling, probe, scale, position, noise, converter.

Source: user manual 071-1064-00, pp. 151-157; programmer manual 071-1075-04, p. 2-68.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeGuard

import numpy as np
from numpy.typing import NDArray

from instrument.scpi import HIGHEST_CODE, LEVELS_PER_DIVISION
from instrument.simulated.panel.panel import PanelChannel

Floats = NDArray[np.float64]
Codes = NDArray[np.int8]
Signal = Callable[[Floats], Floats]

AC_CORNER = 10.0  # Hz
_DELAYS = -np.log1p(-(np.arange(64) + 0.5) / 64)  # in time constants: quantiles of the exponential
_SPARSE = 4.0  # time constants between samples, from which on each counts for itself
_TWO_DELAYS = ((2 - math.sqrt(2), (2 + math.sqrt(2)) / 4), (2 + math.sqrt(2), (2 - math.sqrt(2)) / 4))
_FAR_DELAY = 6.0  # time constants; what happened before that does not count any more
_STRAIGHT = 0.02  # of all that was seen from peak to peak: how far a smooth signal may leave a straight line
_SETTLING = 5 / (2 * math.pi * AC_CORNER)  # s of history after which the coupling has forgotten
_AC_RATES = (51_283.7, 47_013.1, 57_942.9)  # S/s for the slow part; a frequency can beat with one of them
_AC_POINTS = 1 << 17
_MANY_LOOKS = 6000  # at the acquisitions of an average, from which on the signal is asked for their mean


def ground(times: Floats) -> Floats:
    """Signal of an open input."""
    return np.zeros_like(times)


def low_pass(signal: Signal, time_constant: float) -> Signal:
    """The signal behind a single pole."""
    # The pole is an average over the past with exponential weights. It is taken at 64 delays of equal weight, so
    # it costs 64 looks at the signal and needs no grid in time; the gain is right to 0.02 up to five times the
    # corner. A formula of two delays (Gauss and Laguerre) is tried first. Where the signal runs straight through
    # them, on both sides, it is smooth, and that formula is right to a hundredth of a level on a full screen.
    # Samples that lie close together are all taken the long way if one of them is: a short pulse may fall between
    # the looks.
    if time_constant == 0:
        return signal
    if isinstance(signal, CoarseLook) and (delayed := signal.behind_pole(time_constant)) is not None:
        return delayed

    def whole(times: Floats) -> Floats:
        total = np.zeros_like(times)
        for delay in _DELAYS:
            total += evaluate(signal, times - time_constant * delay)
        return total / len(_DELAYS)

    def filtered(times: Floats) -> Floats:
        (late, much), (early, little) = _TWO_DELAYS
        now, near, back, far = (
            evaluate(signal, times - time_constant * delay) for delay in (0.0, late, early, _FAR_DELAY)
        )
        fine = much * near + little * back
        slope = (back - near) / (early - late)
        bends = np.maximum(np.abs(now - near + late * slope), np.abs(far - back - (_FAR_DELAY - early) * slope))
        edgy = bends > _STRAIGHT * np.ptp((now, near, back, far))
        if edgy.any():
            if times[-1] - times[0] < _SPARSE * time_constant * (len(times) - 1):
                return whole(times)
            fine[edgy] = whole(times[edgy])
        return fine

    return filtered


def evaluate(signal: Signal, times: Floats) -> Floats:
    """Volts of a signal; a constant answer is spread over all times."""
    volts = np.asarray(signal(times), dtype=np.float64)
    return volts if volts.shape == times.shape else np.broadcast_to(volts, times.shape)


def shown_volts(signal: Signal, channel: PanelChannel, times: Floats) -> Floats:
    """Volts that the screen would show without the scope's noise: band-limited, coupled, times probe, inverted."""
    return shown_smooth(signal, channel, times) + shown_noise(signal, channel, times)


def shown_smooth(signal: Signal, channel: PanelChannel, times: Floats, more: float = 0.0) -> Floats:
    """What `shown_volts` gives without the noise of the signal; behind one `more` pole (time constant in s)."""
    if channel.coupling == "GND":
        return np.zeros_like(times)
    start, stop = float(times[0]), float(times[-1])
    coupled = _look_coupled(signal, channel, start, stop)
    looked = look(signal, start, stop) if coupled is None else coupled
    volts = evaluate(low_pass(low_pass(looked, channel.time_constant), more), times)
    if coupled is None and channel.coupling == "AC":
        volts = volts - slow_part(signal, times)
    return volts * gain(channel)


def _look_coupled(signal: Signal, channel: PanelChannel, start: float, stop: float) -> CoarseLook | None:
    """The signal behind the AC coupling of a channel, where it knows that itself."""
    if channel.coupling != "AC":
        return None
    return look_above(signal, AC_CORNER, start - _SETTLING, stop)


def mean_shown(signal: Signal, channel: PanelChannel, starts: Floats, times: Floats) -> Floats | None:
    """Mean of what `shown_smooth` gives at `times` after each of the `starts`, all in s and rising."""
    # From one look at the coarse grids of all: polynomials through the means are the mean of the polynomials. None
    # where the signal does not tell that this is right.
    if channel.coupling == "GND" or not tells_its_noise(signal):
        return None
    span = float(times[-1])
    start, stop = float(starts[0]), float(starts[-1]) + span
    whole = look(signal, start, stop) if channel.coupling == "DC" else _look_coupled(signal, channel, start, stop)
    looked = None if whole is None else low_pass(whole, channel.time_constant)
    if not isinstance(looked, CoarseLook):
        return None
    grid = looked.grid(0.0, span, len(times))
    if known_ahead(signal) and len(starts) * (len(times) if grid is None else len(grid)) > _MANY_LOOKS:
        corner = AC_CORNER if channel.coupling == "AC" else 0.0
        mean = signal.mean(starts - looked.delay, times, corner, _SETTLING)
        if mean is not None:
            return mean * gain(channel)
    if grid is None or starts[-1] - starts[0] < (len(starts) - 1) * span:
        return None
    values = looked.smooth((starts[:, np.newaxis] + (grid - looked.delay)).ravel())
    return Between(0.0, span, values.reshape(len(starts), -1).mean(axis=0))(times) * gain(channel)


def shown_noise(signal: Signal, channel: PanelChannel, times: Floats) -> Floats:
    """The noise of the signal as `shown_volts` has it."""
    return np.zeros_like(times) if channel.coupling == "GND" else noise_of(signal, times) * gain(channel)


def gain(channel: PanelChannel) -> float:
    """Volts at the probe tip, upside down where the channel is, over those at the BNC."""
    return -channel.probe if channel.inverted else channel.probe


def levels_per_volt(channel: PanelChannel) -> float:
    """Levels of the converter for a volt at the probe tip."""
    return LEVELS_PER_DIVISION / channel.scale


def slow_part(signal: Signal, times: Floats) -> Floats:
    """What the AC coupling takes away: the signal through a one-pole low-pass of 10 Hz."""
    # It is computed on grids of its own that begin before the record, and interpolated: the low-pass moves slowly,
    # so a record of microseconds needs no grid of microseconds. A signal whose frequency is that of one grid looks
    # constant there; the median of three grids does not fall for it. One grid is enough for a signal that tells
    # how fast it is.
    looked = look(signal, float(times[0]) - _SETTLING, float(times[-1]))
    if isinstance(looked, CoarseLook) and looked.interval > 0:
        return _slow_part_on_grid(looked, times, 1 / looked.interval)
    return np.asarray(np.median([_slow_part_on_grid(looked, times, rate) for rate in _AC_RATES], axis=0))


def _slow_part_on_grid(signal: Signal, times: Floats, rate: float) -> Floats:
    start, stop = float(times[0]) - _SETTLING, float(times[-1])
    odd = _AC_RATES[0] / rate if rate in _AC_RATES else 1.0
    step = max(1 / rate, (stop - start) / _AC_POINTS * odd)
    grid = start + step * np.arange(math.ceil((stop - start) / step) + 2, dtype=np.float64)
    volts = evaluate(signal, grid)
    if isinstance(signal, CoarseLook):
        volts[1:] = (volts[1:] + volts[:-1]) / 2  # straight lines between points that lie far apart
    gain = -math.expm1(-2 * math.pi * AC_CORNER * step)
    first = float(volts.mean()) if stop - start < 2 * _SETTLING else float(volts[: len(volts) // 8 + 1].mean())
    return np.interp(times, grid, smoothed(volts, gain, first))


def smoothed(values: Floats, gain: float, first: float) -> Floats:
    """The recursion y[n] = y[n-1] + gain (x[n] - y[n-1]), begun at y[-1] = first."""
    # In a block, y[n] / (1 - gain)**n is a running sum; a block is as long as the powers stay within e**20.
    length = max(1, min(len(values), int(-20 / math.log1p(-gain))))
    powers = (1 - gain) ** np.arange(1, length + 1, dtype=np.float64)
    result = np.empty_like(values)
    for start in range(0, len(values), length):
        block = values[start : start + length]
        decay = powers[: len(block)]
        result[start : start + length] = decay * (first + gain * np.cumsum(block / decay))
        first = float(result[start + len(block) - 1])
    return result


def convert(volts: Floats, channel: PanelChannel, noise: Floats | float = 0.0) -> Codes:
    """Codes of the converter: 25 levels a division around the centre, rounded, clipped at +-127."""
    levels = volts * levels_per_volt(channel) + LEVELS_PER_DIVISION * channel.position
    levels += noise
    np.rint(levels, out=levels)
    return np.clip(levels, -HIGHEST_CODE, HIGHEST_CODE).astype(np.int8)


# --------------------
# Signals that tell their smooth part from their noise: the smooth part needs few looks, the noise no filter.
#
# Any function of time can be a signal; it is then looked at wherever a value is wanted. A signal that has the
# attributes of `SmoothAndNoise` is looked at on a coarse grid, from which its values in between follow


SIX = 6  # values that a polynomial goes through
_TO_POLYNOMIAL = np.linalg.inv(np.vander(np.arange(-2.0, 4.0), increasing=True)).T  # six values -> coefficients
_WORTH = 2  # times fewer points on the grid than wanted, from which on it is taken
_FOLLOWS = 0.025  # of the interval: a pole so fast only delays


class SmoothAndNoise(Protocol):
    """A signal with white noise on a smooth part."""

    @property
    def noise_rms(self) -> float:
        """V in each sample, at the converter and at the trigger alike: noise passes every filter."""

    def __call__(self, times: Floats, /) -> Floats:
        """Volts at absolute times in s."""

    def smooth(self, times: Floats, /) -> Floats:
        """Volts without noise."""

    def noise(self, times: Floats, /) -> Floats:
        """Noise alone, V."""

    def interval(self, start: float, stop: float, /) -> float:
        """Distance in s of points between which quintic polynomials give the smooth part; 0: not known."""

    def bounds(self, start: float, stop: float, /) -> tuple[float, float]:
        """Volts that the smooth part does not leave between two times; inf where that is not known."""


class KnownAhead(SmoothAndNoise, Protocol):
    """One that knows what an AC coupling, and an average, make of it: far fewer looks are needed."""

    def above(self, corner_hz: float, start: float, stop: float, /) -> Callable[[Floats], Floats] | None:
        """The smooth part behind a high-pass of one pole, for times between two in s; None where not known."""

    def mean(self, starts: Floats, times: Floats, corner_hz: float, settling_s: float, /) -> Floats | None:
        """Mean over many starts of the smooth part at times behind each, behind a high-pass (0: none); or None."""


def tells_its_noise(signal: Callable[[Floats], Floats]) -> TypeGuard[SmoothAndNoise]:
    """Whether a signal has the attributes of `SmoothAndNoise` (this is asked often: not with all of them)."""
    return hasattr(signal, "noise_rms")


def known_ahead(signal: Callable[[Floats], Floats]) -> TypeGuard[KnownAhead]:
    """Whether a signal is a `KnownAhead`."""
    return hasattr(signal, "above")


def polynomials(values: Floats) -> Floats:
    """Coefficients (..., 6) of the quintic polynomials through six values (..., 6) at the places -2, -1, ... 3."""
    return np.asarray(values @ _TO_POLYNOMIAL)


class Between:
    """Quintic polynomials through values at even steps."""

    def __init__(self, first: float, last: float, values: Floats) -> None:
        self._first, self._pace, self._values = first, (len(values) - 1) / (last - first), values

    def at(self, time: float) -> float:
        """The value at one time in s: as of an array, and faster."""
        place = (time - self._first) * self._pace - 2.0
        around = min(max(int(place), 0), len(self._values) - SIX)
        inside, coefficients = place - around, polynomials(self._values[around : around + SIX]).tolist()
        total: float = coefficients[5]
        for order in (4, 3, 2, 1, 0):
            total = total * inside + coefficients[order]
        return total

    def __call__(self, times: Floats) -> Floats:
        """Values at times in s between the first and the last."""
        places = (times - self._first) * self._pace - 2.0
        around = np.minimum(np.maximum(places.astype(np.intp), 0), len(self._values) - SIX)  # clip is slow
        inside = places - around
        lowest, highest = int(around.min()), int(around.max()) + 1
        around -= lowest
        six = np.stack([self._values[lowest + place : highest + place] for place in range(SIX)])
        coefficients = _TO_POLYNOMIAL.T @ six  # (order, polynomial): rows are gathered faster than columns
        total = coefficients[5].take(around)
        for order in (4, 3, 2, 1, 0):
            total *= inside
            total += coefficients[order].take(around)
        return np.asarray(total)


@dataclass(frozen=True)
class CoarseLook:
    """The smooth part of a signal, from a coarse grid where that is worth it."""

    smooth: Callable[[Floats], Floats]  # absolute times in s -> V
    interval: float  # s, as `SmoothAndNoise.interval` gives it for the times that will be asked for
    delay: float = 0.0  # s by which it comes late

    def __call__(self, times: Floats) -> Floats:
        """Volts at rising absolute times in s."""
        if self.interval <= 0 or times.size == 0:
            return self.smooth(times - self.delay)
        first, last = float(times[0]), float(times[-1])
        grid = self.grid(first, last, times.size)
        if grid is None:
            return self.smooth(times - self.delay)
        return Between(first, last, self.smooth(grid - self.delay))(times)

    def grid(self, first: float, last: float, wanted: int) -> Floats | None:
        """The times in s to look at instead of `wanted` ones; None where that is not worth it."""
        # They do not leave the times asked for: nobody knows yet what comes after them.
        if self.interval <= 0 or last <= first:
            return None
        cells = max(5, math.ceil((last - first) / self.interval))
        return None if _WORTH * (cells + 1) > wanted else np.linspace(first, last, cells + 1)

    def behind_pole(self, time_constant: float) -> CoarseLook | None:
        """The same behind a pole that is so fast that it only delays; None if it is not."""
        if time_constant > _FOLLOWS * self.interval:
            return None
        return replace(self, delay=self.delay + time_constant)


def look_above(
    signal: Callable[[Floats], Floats], corner_hz: float, start: float, stop: float
) -> CoarseLook | None:
    """What `look` gives, behind a high-pass of one pole that has settled before the start; None: not known."""
    if not known_ahead(signal):
        return None
    above = signal.above(corner_hz, start, stop)
    return None if above is None else CoarseLook(above, signal.interval(start, stop))


def look(signal: Callable[[Floats], Floats], start: float, stop: float) -> Callable[[Floats], Floats]:
    """The signal without its noise, to be asked for absolute times between two."""
    if tells_its_noise(signal):
        return CoarseLook(signal.smooth, signal.interval(start, stop))
    return signal


def noise_of(signal: Callable[[Floats], Floats], times: Floats) -> Floats:
    """The noise that `look` leaves out, V."""
    return signal.noise(times) if tells_its_noise(signal) else np.zeros_like(times)
