"""A waveform as it would stand on the scope's screen, as SVG for a notebook; needs no plotting library."""

from __future__ import annotations

from html import escape

import numpy as np
from numpy.typing import NDArray

from instrument.waveform import Waveform

_WIDTH, _HEIGHT = 500, 240  # of the graticule, ten by eight divisions
_LEFT, _BELOW, _MARGIN = 60, 34, 8
_DIVISIONS_ACROSS, _DIVISIONS_UP = 10, 8
_LEVELS_UP = 200  # the screen's eight divisions
_STYLE = "font:11px sans-serif;background:#fff"


def waveform_svg(waveform: Waveform) -> str:
    """The record over its ten by eight divisions, with the values at the edges of the screen.

    A column of the picture shows the lowest and the highest of its points, as the scope's own screen does.
    """
    across = np.linspace(_LEFT, _LEFT + _WIDTH, _DIVISIONS_ACROSS + 1)
    up = np.linspace(_MARGIN, _MARGIN + _HEIGHT, _DIVISIONS_UP + 1)
    grid = "".join(
        [f'<line x1="{x:g}" y1="{up[0]:g}" x2="{x:g}" y2="{up[-1]:g}"/>' for x in across]
        + [f'<line x1="{across[0]:g}" y1="{y:g}" x2="{across[-1]:g}" y2="{y:g}"/>' for y in up]
    )
    width, height = _LEFT + _WIDTH + 2 * _MARGIN, _HEIGHT + _BELOW + 2 * _MARGIN
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" style="{_STYLE}" role="img">'
        f'<g stroke="#ccc" stroke-width="1">{grid}</g>'
        f'<path d="{_path(waveform)}" fill="none" stroke="#06c" stroke-width="1.2"/>'
        f"{_labels(waveform)}</svg>"
    )


def _path(waveform: Waveform) -> str:
    """Lines up and down through the extremes of each column; a gap where there are no data."""
    codes = np.asarray(waveform.codes, dtype=np.float64)
    if waveform.codes.dtype == np.int8:
        codes[waveform.codes == -128] = np.nan
    else:
        codes /= 256  # a file of a newer scope
    columns = np.array_split(codes, min(_WIDTH, len(codes)))
    step = _WIDTH / len(columns)
    parts, pen = [], "M"
    for number, column in enumerate(columns):
        found = column[np.isfinite(column)]
        if not len(found):
            pen = "M"
            continue
        x = _LEFT + (number + 0.5) * step
        ends = [found[0], found.min(), found.max(), found[-1]] if len(found) > 1 else [found[0]]
        for y in _rows(np.array(ends)):
            parts.append(f"{pen}{x:.1f} {y:.1f}")
            pen = "L"
    return "".join(parts)


def _rows(codes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights in the picture; what lies off the screen is drawn at its edge."""
    inside = np.clip(codes, -_LEVELS_UP / 2, _LEVELS_UP / 2)
    return _MARGIN + _HEIGHT * (0.5 - inside / _LEVELS_UP)


def _labels(waveform: Waveform) -> str:
    scale = waveform.preamble
    places: list[tuple[float, float, str, str]] = []
    per_code = 1 if waveform.codes.dtype == np.int8 else 256
    for code, y in (
        (_LEVELS_UP / 2, _MARGIN + 10),
        (0, _MARGIN + _HEIGHT / 2 + 4),
        (-_LEVELS_UP / 2, _MARGIN + _HEIGHT),
    ):
        value = (code * per_code - scale.yoff) * scale.ymult + scale.yzero
        places.append((_LEFT - 6, y, "end", f"{value:.4g}"))
    places.append((_LEFT - 6, _MARGIN + 24, "end", scale.yunit))
    span = scale.xincr * scale.nr_pt
    for part, anchor in ((0.0, "start"), (0.5, "middle"), (1.0, "end")):
        time = scale.xzero + part * span
        places.append((_LEFT + part * _WIDTH, _MARGIN + _HEIGHT + 16, anchor, f"{time:.4g} {scale.xunit}"))
    return "".join(
        f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(text)}</text>' for x, y, anchor, text in places
    )
