"""From the volts at the BNC to eight-bit codes: coupling, probe, scale, position, noise, converter.

Source: user manual 071-1064-00, pp. 151-157; programmer manual 071-1075-04, p. 2-68.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from instrument.facts import HIGHEST_CODE, LEVELS_PER_DIVISION
from instrument.simulated.front_end.smooth import (
    Between,
    CoarseLook,
    known_ahead,
    look,
    look_above,
    noise_of,
    tells_its_noise,
)
from instrument.simulated.panel.panel import ChannelSettings

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
    """The signal behind a single pole.

    The pole is an average over the past with exponential weights. It is taken at 64 delays of equal weight, so
    it costs 64 looks at the signal and needs no grid in time; the gain is right to 0.02 up to five times the
    corner. A formula of two delays (Gauss and Laguerre) is tried first. Where the signal runs straight through
    them, on both sides, it is smooth, and that formula is right to a hundredth of a level on a full screen.
    Samples that lie close together are all taken the long way if one of them is: a short pulse may fall between
    the looks.
    """
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


def shown_volts(signal: Signal, channel: ChannelSettings, times: Floats) -> Floats:
    """Volts that the screen would show without the scope's noise: band-limited, coupled, times probe, inverted."""
    return shown_smooth(signal, channel, times) + shown_noise(signal, channel, times)


def shown_smooth(signal: Signal, channel: ChannelSettings, times: Floats, more: float = 0.0) -> Floats:
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


def _look_coupled(signal: Signal, channel: ChannelSettings, start: float, stop: float) -> CoarseLook | None:
    """The signal behind the AC coupling of a channel, where it knows that itself."""
    if channel.coupling != "AC":
        return None
    return look_above(signal, AC_CORNER, start - _SETTLING, stop)


def mean_shown(signal: Signal, channel: ChannelSettings, starts: Floats, times: Floats) -> Floats | None:
    """Mean of what `shown_smooth` gives at `times` after each of the `starts`, all in s and rising.

    From one look at the coarse grids of all: polynomials through the means are the mean of the polynomials.
    None where the signal does not tell that this is right.
    """
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


def shown_noise(signal: Signal, channel: ChannelSettings, times: Floats) -> Floats:
    """The noise of the signal as `shown_volts` has it."""
    return np.zeros_like(times) if channel.coupling == "GND" else noise_of(signal, times) * gain(channel)


def gain(channel: ChannelSettings) -> float:
    """Volts at the probe tip, upside down where the channel is, over those at the BNC."""
    return -channel.probe if channel.inverted else channel.probe


def levels_per_volt(channel: ChannelSettings) -> float:
    """Levels of the converter for a volt at the probe tip."""
    return LEVELS_PER_DIVISION / channel.scale


def slow_part(signal: Signal, times: Floats) -> Floats:
    """What the AC coupling takes away: the signal through a one-pole low-pass of 10 Hz.

    It is computed on grids of its own that begin before the record, and interpolated: the low-pass moves
    slowly, so a record of microseconds needs no grid of microseconds. A signal whose frequency is that of one
    grid looks constant there; the median of three grids does not fall for it. One grid is enough for a signal that
    tells how fast it is.
    """
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
    """The recursion y[n] = y[n-1] + gain (x[n] - y[n-1]), begun at y[-1] = first.

    In a block, y[n] / (1 - gain)**n is a running sum; a block is as long as the powers stay within e**20.

    Examples
    --------
    >>> smoothed(np.array([1.0, 1.0, 0.0]), 0.5, 0.0).tolist()
    [0.5, 0.75, 0.375]
    """
    length = max(1, min(len(values), int(-20 / math.log1p(-gain))))
    powers = (1 - gain) ** np.arange(1, length + 1, dtype=np.float64)
    result = np.empty_like(values)
    for start in range(0, len(values), length):
        block = values[start : start + length]
        decay = powers[: len(block)]
        result[start : start + length] = decay * (first + gain * np.cumsum(block / decay))
        first = float(result[start + len(block) - 1])
    return result


def convert(volts: Floats, channel: ChannelSettings, noise: Floats | float = 0.0) -> Codes:
    """Codes of the converter: 25 levels a division around the centre, rounded, clipped at +-127.

    Examples
    --------
    >>> channel = ChannelSettings(0.5, 1.0, "DC", 1.0, limited=False, inverted=False)
    >>> convert(np.array([0.0, 0.5, 9.0, -9.0]), channel).tolist()
    [25, 50, 127, -127]
    """
    levels = volts * levels_per_volt(channel) + LEVELS_PER_DIVISION * channel.position
    levels += noise
    np.rint(levels, out=levels)
    return np.clip(levels, -HIGHEST_CODE, HIGHEST_CODE).astype(np.int8)
