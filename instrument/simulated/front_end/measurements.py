"""Automatic measurements of one trace, in single precision as the instrument computes them.

A TDS2024 answered 9.99999046E-2 for the difference of 4.98 and 4.88 V, both counts of levels times V/level in
single precision, and whole sample intervals for rise and fall. Source: user manual 071-1064-00, p. 95; programmer
manual 071-1075-04, pp. 2-159 to 2-170.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.facts import HIGHEST_CODE, NO_DATA
from instrument.simulated.front_end.traces import Trace
from instrument.simulated.panel.event_table import Refusal

Floats = NDArray[np.float64]
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
    """Crossings of the middle in samples, with a hysteresis of a tenth of the height.

    Examples
    --------
    >>> edges = middle_crossings(np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0]))
    >>> edges.times.tolist(), edges.rising.tolist()
    ([1.5, 3.5], [True, False])
    """
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
