"""What stands on the screen as data: traces as 8-bit codes with their scales, math, and measurements of them.

Source: programmer manual 071-1075-04, pp. 2-84 to 2-91 and 2-240 to 2-260.
"""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from instrument.scpi import HIGHEST_CODE, LEVELS_PER_DIVISION, NO_DATA, POINTS
from instrument.simulated.front_end.acquisition import DigitizedRecord
from instrument.simulated.front_end.frontend import Codes, Floats
from instrument.simulated.panel.events import Refusal
from instrument.simulated.panel.panel import Panel, PanelChannel
from instrument.simulated.panel.parsing import block, nr3, quoted

MODE_WORDS = {"SAMPLE": "Sample", "AVERAGE": "Average", "PEAKDETECT": "Pk Detect"}
PREAMBLE_FIELDS = (
    "BYT_Nr", "BIT_Nr", "ENCdg", "BN_Fmt", "BYT_Or", "NR_Pt", "WFId", "PT_Fmt", "XINcr", "PT_Off", "XZEro",
    "XUNit", "YMUlt", "YZEro", "YOFf", "YUNit",
)  # fmt: skip
TRANSMISSION_FIELDS = PREAMBLE_FIELDS[:5]


@dataclass(frozen=True)
class Trace:
    """One waveform as it can be transferred; scales are those of one-byte codes."""

    codes: Codes
    wfid: str
    pt_fmt: str
    xincr: float
    xzero: float
    xunit: str
    ymult: float
    yzero: float
    yoff: float
    yunit: str

    @property
    def points(self) -> int:
        """Number of codes: 2500, or 1024 of a spectrum."""
        return len(self.codes)


@dataclass(frozen=True)
class Transfer:
    """The DATa settings: how codes travel, and which of them."""

    encoding: str
    width: int
    start: int
    stop: int

    @classmethod
    def of(cls, panel: Panel) -> Self:
        """Read the DATa settings from the panel."""
        return cls(
            encoding=panel.text("DATA:ENCDG"),
            width=int(panel.number("DATA:WIDTH")),
            start=int(panel.number("DATA:START")),
            stop=int(panel.number("DATA:STOP")),
        )

    @property
    def positive(self) -> bool:
        """True for the unsigned formats."""
        return self.encoding in ("RPBINARY", "SRPBINARY")

    @property
    def swapped(self) -> bool:
        """True if START lies behind STOP; CURVe? takes them the other way round."""
        return self.start > self.stop

    def window(self, points: int) -> slice:
        """The points from START to STOP, at least one."""
        low, high = sorted((self.start, self.stop))
        return slice(min(low, points) - 1, min(high, points))

    @property
    def fields(self) -> dict[str, str]:
        """The five fields of the preamble that a waveform is not needed for."""
        ascii_ = self.encoding == "ASCII"
        return {
            "BYT_Nr": str(self.width),
            "BIT_Nr": str(8 * self.width),
            "ENCdg": "ASC" if ascii_ else "BIN",
            "BN_Fmt": "RP" if self.positive or ascii_ else "RI",
            "BYT_Or": "LSB" if self.encoding.startswith("SR") else "MSB",
        }


def empty_reference(name: str) -> Trace:
    """A reference memory that was never written."""
    letter = name[-1]
    wfid = f"Ref{letter}, DC coupling, 1.0E0 V/div, 5.0E-4 s/div, {POINTS} points, Sample mode"
    codes = np.full(POINTS, NO_DATA, dtype=np.int8)
    return Trace(codes, wfid, "Y", 2e-6, -2.5e-3, "s", 0.04, 0.0, 0.0, "Volts")


def channel_trace(record: DigitizedRecord, name: str, codes: Codes, channel: PanelChannel, yunit: str) -> Trace:
    """Trace of a channel with the settings of its acquisition."""
    wfid = (
        f"Ch{name[2:]}, {channel.coupling} coupling, {nr3(channel.scale)} V/div, "
        f"{nr3(record.seconds_per_division)} s/div, {POINTS} points, {MODE_WORDS[record.mode]} mode"
    )
    return Trace(
        codes=codes,
        wfid=wfid,
        pt_fmt="ENV" if record.mode == "PEAKDETECT" else "Y",
        xincr=record.xincr,
        xzero=record.xzero,
        xunit="s",
        ymult=channel.scale / LEVELS_PER_DIVISION,
        yzero=0.0,
        yoff=LEVELS_PER_DIVISION * channel.position,
        yunit=yunit,
    )


def preamble(trace: Trace | None, transfer: Transfer) -> dict[str, str]:
    """Values of the 16 fields of WFMPre?, or of the first five without a trace."""
    fields = transfer.fields
    if trace is None:
        return fields
    window = transfer.window(trace.points)
    scale = 256 if transfer.width == 2 else 1
    centre = 128 if transfer.positive else 0
    return {
        **fields,
        "NR_Pt": str(window.stop - window.start),
        "WFId": quoted(trace.wfid),
        "PT_Fmt": trace.pt_fmt,
        "XINcr": nr3(trace.xincr, 9),
        "PT_Off": "0",
        "XZEro": nr3(trace.xzero, 9),
        "XUNit": quoted(trace.xunit),
        "YMUlt": nr3(trace.ymult / scale, 9),
        "YZEro": nr3(trace.yzero, 9),
        "YOFf": nr3(scale * (trace.yoff + centre), 9),
        "YUNit": quoted(trace.yunit),
    }


def encode(trace: Trace, transfer: Transfer) -> bytes:
    """The codes as CURVe? sends them: a block, or a list of numbers."""
    codes = trace.codes[transfer.window(trace.points)]
    if transfer.encoding == "ASCII":
        scale = 256 if transfer.width == 2 else 1
        return ",".join(map(str, (codes.astype(np.int32) * scale).tolist())).encode()
    if transfer.positive:
        codes = (codes.view(np.uint8) ^ 0x80).view(np.int8)
    if transfer.width == 1:
        return block(codes.tobytes())
    wide = np.zeros((len(codes), 2), dtype=np.int8)
    wide[:, 1 if transfer.encoding.startswith("SR") else 0] = codes
    return block(wide.tobytes())


def decode(data: bytes, transfer: Transfer) -> Codes:
    """Codes of a block that CURVe sends to the instrument; the low byte of two is dropped."""
    raw = np.frombuffer(data[: len(data) // transfer.width * transfer.width], dtype=np.int8)
    if transfer.width == 2:
        raw = raw[1::2] if transfer.encoding.startswith("SR") else raw[::2]
    return (raw.view(np.uint8) ^ 0x80).view(np.int8) if transfer.positive else raw.copy()


# --------------------
# The MATH waveform: sum, difference and product of two channels, and the spectrum of one.
#
# Source: programmer manual 071-1075-04, pp. 2-148 and 2-252; user manual 071-1064-00, pp. 109-119


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
    """The points of a spectrum that the screen shows: zoomed about a position in percent of the whole."""
    width = int(FFT_POINTS / horizontal_zoom)
    first = round(FFT_POINTS * position / 100 - width / 2)
    first = min(max(first, 0), FFT_POINTS - width)
    return slice(first, first + width)


def spectrum(expression: str, source: Trace, zoom: float, position: float, horizontal_zoom: float = 1.0) -> Trace:
    """Levels in dB (0 dB = 1 V rms) at 1024 frequencies, from the centre 2048 points of the record."""
    # The horizontal zoom changes what the screen shows and the Hz/div of the description; the data stay the whole
    # spectrum (a guess: the manual calls it a display zoom, p. 2-150).
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
    """Sums of samples times exp(-2 pi i k n / 2048 / 0.99) for k = 0 to 1023."""
    # The frequencies do not fall on those of an FFT, so the sum is written as a convolution with a chirp
    # (Bluestein), n k = (n**2 + k**2 - (k - n)**2) / 2.
    step = 2 * math.pi / FFT_SAMPLES / _FFT_STRETCH
    n = np.arange(FFT_SAMPLES, dtype=np.float64)
    chirp = np.exp(-0.5j * step * n**2)
    size = 4 * FFT_POINTS
    kernel = np.zeros(size, dtype=np.complex128)
    kernel[:FFT_POINTS] = chirp[:FFT_POINTS].conj()
    kernel[-FFT_SAMPLES + 1 :] = chirp[:0:-1].conj()
    product = np.fft.fft(samples * chirp, size) * np.fft.fft(kernel)
    return np.asarray(np.fft.ifft(product)[:FFT_POINTS] * chirp[:FFT_POINTS])


# --------------------
# Automatic measurements of one trace, in single precision as the instrument computes them.
#
# A TDS2024 answered 9.99999046E-2 for the difference of 4.98 and 4.88 V, both counts of levels times V/level in
# single precision, and whole sample intervals for rise and fall. Source: user manual 071-1064-00, p. 95;
# programmer manual 071-1075-04, pp. 2-159 to 2-170


Singles = NDArray[np.float32]

UNITS = {"FREQUENCY": "Hz", "PERIOD": "s", "RISE": "s", "FALL": "s", "PWIDTH": "s", "NWIDTH": "s",
         "PHASE": "deg"}  # fmt: skip
_FEWEST_LEVELS = 3  # peak to peak, below which no edge counts (a guess; a TDS2024 measured 5 levels)


@dataclass(frozen=True)
class Edges:
    """Times in s at which a trace crosses its middle, and which of them rise."""

    times: Floats
    rising: NDArray[np.bool_]


def unit(kind: str) -> str:
    """Unit of a measurement's value."""
    return UNITS.get(kind, "V")


def clipping_event(trace: Trace) -> int:
    """Warning 547, 548 or 549 for clipped codes, else 0."""
    high, low = bool((trace.codes == HIGHEST_CODE).any()), bool((trace.codes == -HIGHEST_CODE).any())
    return {(True, True): 547, (True, False): 548, (False, True): 549}.get((high, low), 0)


def measure(kind: str, trace: Trace) -> float:
    """Value of a measurement."""
    codes = trace.codes[trace.codes != NO_DATA].astype(np.float64)
    if not len(codes):
        raise Refusal(2225)
    counts = codes - trace.yoff
    volts = counts.astype(np.float32) * np.float32(trace.ymult) + np.float32(trace.yzero)
    if kind == "RMS":
        return _rms(volts)
    if kind in ("MEAN", "MINIMUM", "MAXIMUM", "PK2PK"):
        low, high, mean = volts.min(), volts.max(), volts.mean()
        return float({"MEAN": mean, "MINIMUM": low, "MAXIMUM": high, "PK2PK": high - low}[kind])
    if np.ptp(codes) < _FEWEST_LEVELS:
        raise Refusal(2204)
    if kind in ("RISE", "FALL"):
        return _seconds(_edge_samples(codes, rising=kind == "RISE"), trace)
    edges = middle_crossings(codes)
    if kind in ("PWIDTH", "NWIDTH"):
        return _seconds(_width(edges, positive=kind == "PWIDTH"), trace)
    if len(edges.times) < 3:
        raise Refusal(2202)
    first, last = float(edges.times[0]), float(edges.times[2])
    if kind == "CRMS":
        return _rms(volts[round(first) : max(round(last), round(first) + 1)])
    period = _seconds(last - first, trace)
    return float(np.float32(1 / period)) if kind == "FREQUENCY" else period


def _rms(volts: Singles) -> float:
    return float(np.sqrt(np.mean(volts * volts)))


def _seconds(samples: float, trace: Trace) -> float:
    return float(np.float32(samples) * np.float32(trace.xincr))


def phase(first: Trace, second: Trace) -> float:
    """Degrees by which the first trace leads the second, by their first rising crossings of the middle."""
    edges = []
    for trace, no_period in ((first, 2202), (second, 2203)):
        codes = trace.codes[trace.codes != NO_DATA].astype(np.float64)
        if not len(codes) or np.ptp(codes) < _FEWEST_LEVELS:
            raise Refusal(2204 if no_period == 2202 else 2205)
        found = middle_crossings(codes)
        rising = found.times[found.rising]
        if len(rising) < 2:
            raise Refusal(no_period)
        edges.append(rising)
    period = float(edges[0][1] - edges[0][0])
    turns = float(edges[1][0] - edges[0][0]) / period
    return float(np.float32(360.0 * (turns - round(turns))))


def middle_crossings(volts: Floats) -> Edges:
    """Crossings of the middle in samples, with a hysteresis of a tenth of the height."""
    low, high = float(volts.min()), float(volts.max())
    middle, margin = (low + high) / 2, (high - low) / 10
    side = np.where(volts > middle + margin, 1, np.where(volts < middle - margin, -1, 0))
    known = np.flatnonzero(side)
    changes = np.flatnonzero(np.diff(side[known]))
    times = []
    for before, after in zip(known[changes], known[changes + 1], strict=True):
        part = volts[before : after + 1] - middle
        step = int(np.flatnonzero(part[:-1] * part[-1] <= 0)[-1])
        times.append(before + step + part[step] / (part[step] - part[step + 1]))
    return Edges(np.array(times, dtype=np.float64), side[known[changes + 1]] > 0)


def _width(edges: Edges, *, positive: bool) -> float:
    """Samples from the first wanted edge to the next."""
    starts = np.flatnonzero(edges.rising == positive)
    if not len(starts):
        raise Refusal(2213 if positive else 2212)
    first = int(starts[0])
    if first + 1 >= len(edges.times):
        raise Refusal(2209)
    return float(edges.times[first + 1] - edges.times[first])


def _edge_samples(codes: Floats, *, rising: bool) -> int:
    """Samples from the one that reaches 10 % to the one that reaches 90 % of the first edge of that direction."""
    turned = codes if rising else -codes
    low, high = float(turned.min()), float(turned.max())
    tenth = low + (high - low) / 10
    ninety = high - (high - low) / 10
    below = np.flatnonzero(turned < tenth)
    if not len(below) or not (turned[below[0] :] > ninety).any():
        raise Refusal(2213 if rising else 2212)
    end = int(below[0] + np.argmax(turned[below[0] :] > ninety))
    return end - int(below[below < end][-1]) - 1
