"""The picture of the screen that HARDCopy sends: 320 x 240 colour numbers."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from instrument.facts import LEVELS_PER_DIVISION, NO_DATA
from instrument.simulated.front_end.traces import Trace

WIDTH, HEIGHT = 320, 240
_LEFT, _TOP, _DIVISION = 20, 16, 25  # pixels; ten by eight divisions
_BLACK, _GREY, _FRAME = 0, 1, 2
COLOURS = (
    (255, 255, 255), (176, 176, 176), (0, 0, 0), (200, 160, 0), (0, 120, 200), (200, 0, 160), (0, 150, 60),
    (200, 40, 0), (90, 90, 90),
)  # fmt: skip

Pixels = NDArray[np.uint8]


def draw(traces: Mapping[str, Trace]) -> Pixels:
    """Graticule and traces as colour numbers, shape (240, 320), first row on top."""
    pixels = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    right, bottom = _LEFT + 10 * _DIVISION, _TOP + 8 * _DIVISION
    pixels[_TOP : bottom + 1 : 5, _LEFT : right + 1 : _DIVISION] = _GREY
    pixels[_TOP : bottom + 1 : _DIVISION, _LEFT : right + 1 : 5] = _GREY
    pixels[[_TOP, bottom], _LEFT : right + 1] = _FRAME
    pixels[_TOP : bottom + 1, [_LEFT, right]] = _FRAME
    for colour, trace in enumerate(traces.values(), start=3):
        _draw_trace(pixels, trace, 3 + (colour - 3) % (len(COLOURS) - 3))
    return pixels


def _draw_trace(pixels: Pixels, trace: Trace, colour: int) -> None:
    """A vertical bar per column from its lowest to its highest code."""
    edges = np.arange(10 * _DIVISION + 1) * len(trace.codes) // (10 * _DIVISION)
    columns = [trace.codes[start : max(stop, start + 1)] for start, stop in itertools.pairwise(edges)]
    middle = _TOP + 4 * _DIVISION
    for x, codes in enumerate(columns, start=_LEFT):
        valid = codes[codes != NO_DATA]
        if len(valid):
            rows = middle - np.array([valid.max(), valid.min()], dtype=int) * _DIVISION // LEVELS_PER_DIVISION
            high, low = np.clip(rows, _TOP, _TOP + 8 * _DIVISION)
            pixels[high : low + 1, x] = colour
