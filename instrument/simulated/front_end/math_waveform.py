"""The MATH waveform: sum, difference and product of two channels, and the spectrum of one.

Source: programmer manual 071-1075-04, pp. 2-148 and 2-252; user manual 071-1064-00, pp. 109-119.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from instrument.facts import HIGHEST_CODE, LEVELS_PER_DIVISION, NO_DATA
from instrument.simulated.front_end.frontend import Floats
from instrument.simulated.front_end.traces import Trace
from instrument.simulated.panel.formats import nr3

FFT_SAMPLES = 2048
FFT_POINTS = 1024
_FFT_STRETCH = 0.99  # Hz a point = sample rate / 2048 / 0.99, as real files have it
_FFT_FLOOR = -100  # code of the lower screen edge
_DECIBELS_PER_DIVISION = 10.0


def combine(expression: str, first: Trace, second: Trace) -> Trace:
    """Sum or difference; of channels with unequal volts per division the scale is unknown."""
    equal = math.isclose(first.ymult, second.ymult)
    sign = 1 if "+" in expression else -1
    codes = first.codes - first.yoff + sign * (second.codes - second.yoff)
    codes = np.clip(np.rint(codes), -HIGHEST_CODE, HIGHEST_CODE).astype(np.int8)
    codes[(first.codes == NO_DATA) | (second.codes == NO_DATA)] = NO_DATA
    parts = first.wfid.split(", ")
    scale = nr3(first.ymult * LEVELS_PER_DIVISION)
    return Trace(
        codes=codes,
        wfid=", ".join(["Math", "DC coupling", f"{scale} V/div", *parts[3:]]),
        pt_fmt=first.pt_fmt,
        xincr=first.xincr,
        xzero=first.xzero,
        xunit="s",
        ymult=first.ymult if equal else 0.0,
        yzero=0.0,
        yoff=0.0,
        yunit=first.yunit if equal else "U",
    )


def multiply(first: Trace, second: Trace, scale: float, position: float) -> Trace:
    """Product of two channels in its own scale (units a division) and position (divisions)."""
    volts = [(trace.codes.astype(np.float64) - trace.yoff) * trace.ymult for trace in (first, second)]
    yoff = LEVELS_PER_DIVISION * position
    codes = np.rint(volts[0] * volts[1] / scale * LEVELS_PER_DIVISION + yoff)
    codes = np.clip(codes, -HIGHEST_CODE, HIGHEST_CODE).astype(np.int8)
    codes[(first.codes == NO_DATA) | (second.codes == NO_DATA)] = NO_DATA
    unit = "".join(sorted("A" if trace.yunit == "A" else "V" for trace in (first, second))[::-1])
    parts = first.wfid.split(", ")
    return replace(
        first,
        codes=codes,
        wfid=", ".join(["Math", "DC coupling", f"{nr3(scale)} {unit}/div", *parts[3:]]),
        ymult=scale / LEVELS_PER_DIVISION,
        yoff=yoff,
        yunit=unit,
    )


def visible_part(horizontal_zoom: float, position: float) -> slice:
    """The points of a spectrum that the screen shows: zoomed about a position in percent of the whole.

    Examples
    --------
    >>> visible_part(1, 50), visible_part(2, 50), visible_part(10, 0)
    (slice(0, 1024, None), slice(256, 768, None), slice(0, 102, None))
    """
    width = int(FFT_POINTS / horizontal_zoom)
    first = round(FFT_POINTS * position / 100 - width / 2)
    first = min(max(first, 0), FFT_POINTS - width)
    return slice(first, first + width)


def spectrum(expression: str, source: Trace, zoom: float, position: float, horizontal_zoom: float = 1.0) -> Trace:
    """Levels in dB (0 dB = 1 V rms) at 1024 frequencies, from the centre 2048 points of the record.

    The horizontal zoom changes what the screen shows and the Hz/div of the description; the data stay the whole
    spectrum (a guess: the manual calls it a display zoom, p. 2-150).
    """
    volts = (source.codes.astype(np.float64) - source.yoff) * source.ymult
    start = (len(volts) - FFT_SAMPLES) // 2
    window = fft_window(expression)
    lines = stretched_spectrum(volts[start : start + FFT_SAMPLES] * window)
    rms = np.abs(lines) * math.sqrt(2) / float(window.sum())
    rms[0] /= 2
    decibels = 20 * np.log10(np.maximum(rms, 1e-12))
    ymult = _DECIBELS_PER_DIVISION / zoom / LEVELS_PER_DIVISION
    scale = source.ymult * LEVELS_PER_DIVISION
    yzero = 20 * math.log10(4 * scale / math.sqrt(2)) - 30
    yoff = LEVELS_PER_DIVISION * position
    codes = np.clip(np.rint((decibels - yzero) / ymult + yoff), _FFT_FLOOR, HIGHEST_CODE)
    xincr = 1 / source.xincr / FFT_SAMPLES / _FFT_STRETCH
    mode = source.wfid.rsplit(", ", 1)[1]
    wfid = (
        f"Math, DC coupling, {nr3(_DECIBELS_PER_DIVISION / zoom)} dB/div, "
        f"{nr3(xincr * FFT_POINTS / 10 / horizontal_zoom, 9)} Hz/div, {FFT_POINTS} points, {mode}"
    )
    return Trace(
        codes=codes.astype(np.int8),
        wfid=wfid,
        pt_fmt="Y",
        xincr=xincr,
        xzero=0.0,
        xunit="Hz",
        ymult=ymult,
        yzero=yzero,
        yoff=yoff,
        yunit="dB",
    )


# Cosine series of the windows. The flat top is the one of five terms that instruments use.
_WINDOWS = {
    "HANNING": (0.5, 0.5),
    "FLATTOP": (0.21557895, 0.41663158, 0.277263158, 0.083578947, 0.006947368),
    "RECTANGULAR": (1.0,),
}


def fft_window(expression: str) -> Floats:
    """The window that an FFT expression names, shape (2048,), periodic."""
    terms = _WINDOWS[expression.rstrip(")").split(",")[1]]
    angles = 2 * math.pi * np.arange(FFT_SAMPLES) / FFT_SAMPLES
    waves = [(-1) ** n * term * np.cos(n * angles) for n, term in enumerate(terms)]
    return np.asarray(sum(waves), dtype=np.float64)


def stretched_spectrum(samples: Floats) -> NDArray[np.complex128]:
    """Sums of samples times exp(-2 pi i k n / 2048 / 0.99) for k = 0 to 1023.

    The frequencies do not fall on those of an FFT, so the sum is written as a convolution with a chirp
    (Bluestein), n k = (n**2 + k**2 - (k - n)**2) / 2.
    """
    step = 2 * math.pi / FFT_SAMPLES / _FFT_STRETCH
    n = np.arange(FFT_SAMPLES, dtype=np.float64)
    chirp = np.exp(-0.5j * step * n**2)
    size = 4 * FFT_POINTS
    kernel = np.zeros(size, dtype=np.complex128)
    kernel[:FFT_POINTS] = chirp[:FFT_POINTS].conj()
    kernel[-FFT_SAMPLES + 1 :] = chirp[:0:-1].conj()
    product = np.fft.fft(samples * chirp, size) * np.fft.fft(kernel)
    return np.asarray(np.fft.ifft(product)[:FFT_POINTS] * chirp[:FFT_POINTS])
