"""A record as it would stand on the scope's screen, as SVG for a notebook; needs no plotting library."""

from __future__ import annotations

from html import escape

import numpy as np
from numpy.typing import NDArray

from instrument.facts import DIVISIONS, VERTICAL_DIVISIONS

_WIDTH, _HEIGHT = 500, 240  # of the graticule
_LEFT, _BELOW, _MARGIN = 60, 34, 8
_STYLE = "font:11px sans-serif;background:#fff"


def waveform_svg(
    values: NDArray[np.float64],
    *,
    start: float,
    interval: float,
    screen: tuple[float, float],
    units: tuple[str, str],
) -> str:
    """The curve over the divisions of the screen, with the values at its edges.

    A column of the picture shows the lowest and the highest of its points, as the scope's own screen does.
    """
    across = np.linspace(_LEFT, _LEFT + _WIDTH, DIVISIONS + 1)
    up = np.linspace(_MARGIN, _MARGIN + _HEIGHT, VERTICAL_DIVISIONS + 1)
    grid = "".join(
        [f'<line x1="{x:g}" y1="{up[0]:g}" x2="{x:g}" y2="{up[-1]:g}"/>' for x in across]
        + [f'<line x1="{across[0]:g}" y1="{y:g}" x2="{across[-1]:g}" y2="{y:g}"/>' for y in up]
    )
    width, height = _LEFT + _WIDTH + 2 * _MARGIN, _HEIGHT + _BELOW + 2 * _MARGIN
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" style="{_STYLE}" role="img">'
        f'<g stroke="#ccc" stroke-width="1">{grid}</g>'
        f'<path d="{_path(values, screen)}" fill="none" stroke="#06c" stroke-width="1.2"/>'
        f"{_labels((start, start + interval * len(values)), screen, units)}</svg>"
    )


def _path(values: NDArray[np.float64], screen: tuple[float, float]) -> str:
    """Lines up and down through the extremes of each column; a gap where there are no data."""
    columns = np.array_split(values, min(_WIDTH, len(values)))
    step = _WIDTH / len(columns)
    parts, pen = [], "M"
    for number, column in enumerate(columns):
        found = column[np.isfinite(column)]
        if not len(found):
            pen = "M"
            continue
        x = _LEFT + (number + 0.5) * step
        ends = [found[0], found.min(), found.max(), found[-1]] if len(found) > 1 else [found[0]]
        for y in _heights(np.array(ends), screen):
            parts.append(f"{pen}{x:.1f} {y:.1f}")
            pen = "L"
    return "".join(parts)


def _heights(values: NDArray[np.float64], screen: tuple[float, float]) -> NDArray[np.float64]:
    """Heights in the picture; what lies off the screen is drawn at its edge."""
    bottom, top = screen
    above_middle = (values - (bottom + top) / 2) / ((top - bottom) or 1.0)
    return _MARGIN + _HEIGHT * (0.5 - np.clip(above_middle, -0.5, 0.5))


def _labels(ends: tuple[float, float], screen: tuple[float, float], units: tuple[str, str]) -> str:
    first, last = ends
    bottom, top = screen
    places: list[tuple[float, float, str, str]] = [
        (_LEFT - 6, _MARGIN + 10, "end", f"{top:.4g}"),
        (_LEFT - 6, _MARGIN + _HEIGHT / 2 + 4, "end", f"{(bottom + top) / 2:.4g}"),
        (_LEFT - 6, _MARGIN + _HEIGHT, "end", f"{bottom:.4g}"),
        (_LEFT - 6, _MARGIN + 24, "end", units[1]),
    ]
    for part, anchor in ((0.0, "start"), (0.5, "middle"), (1.0, "end")):
        time = first + part * (last - first)
        places.append((_LEFT + part * _WIDTH, _MARGIN + _HEIGHT + 16, anchor, f"{time:.4g} {units[0]}"))
    return "".join(
        f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(text)}</text>' for x, y, anchor, text in places
    )
