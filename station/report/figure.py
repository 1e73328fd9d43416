"""Figures in the style of the reports: colours and type, an element of a page, a file of its own."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from station.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FILE_KINDS = (".svg", ".png", ".pdf")
INK, SOFT, LINE, ACCENT, SECOND, THIRD = "#1d2733", "#5b6875", "#dfe4ea", "#1f5f99", "#b4541e", "#2c7a4b"
THEME = {INK: "ink", SOFT: "soft", LINE: "line", ACCENT: "accent", SECOND: "second", THIRD: "third"}
"""Colours of figures, and the names under which a page holds them."""
WIDE, HALF, TALL = (10.0, 3.1), (5.0, 3.1), (10.0, 4.6)
STYLE: dict[str, Any] = {
    "svg.fonttype": "none",  # text stays text: small, searchable, in the font of the page
    "font.size": 9.5,
    "text.color": INK,
    "axes.edgecolor": SOFT,
    "axes.labelcolor": SOFT,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": LINE,
    "grid.linewidth": 0.6,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "lines.linewidth": 1.2,
}


def svg_element(name: str, size: tuple[float, float], draw: Callable[[Figure], None]) -> str:
    """Draw a figure as an SVG element that can stand beside others in one page."""
    drawn = _drawn(name, size, draw, "svg", "none", {"Date": None, "Creator": None})
    return _embeddable(drawn.decode(), name)


def write_picture(path: Path, name: str, size: tuple[float, float], draw: Callable[[Figure], None]) -> None:
    """Draw a figure into a file; its suffix says which kind. The file appears as a whole or not at all."""
    check_picture_name(path)
    kind = path.suffix.lower()
    metadata: dict[str, Any] = {
        ".svg": {"Date": None, "Creator": None},
        ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
        ".png": {"Software": None},
    }[kind]
    content = _drawn(name, size, draw, kind[1:], "white", metadata)
    partial = path.with_name(f"{path.name}.partial")
    try:
        partial.write_bytes(content)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def check_picture_name(path: Path) -> None:
    """Refuse a file name of which the kind of picture cannot be told, before any work is done."""
    if path.suffix.lower() not in FILE_KINDS:
        raise UsageError(f"{path}: a picture's name ends with {', '.join(FILE_KINDS[:-1])} or {FILE_KINDS[-1]}")


def legend_above(axes: Axes, columns: int = 3) -> None:
    """Put the legend above the axes, where it hides nothing."""
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=columns, borderaxespad=0.2, handlelength=1.6)


def renamed(svg: str, name: str) -> str:
    """Return an SVG element under another name: two of one name may then stand in one page."""
    svg = re.sub(r'\bid="', f'id="{name}-', svg)
    return re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", svg)


def _drawn(
    name: str,
    size: tuple[float, float],
    draw: Callable[[Figure], None],
    kind: str,
    face: str,
    metadata: dict[str, Any],
) -> bytes:
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    style: Any = STYLE | {"svg.hashsalt": f"gyrolock-{name}", "figure.facecolor": face, "axes.facecolor": face}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=size, dpi=72)
        canvas = FigureCanvasSVG(figure)
        draw(figure)
        if figure.legends or figure.texts:  # which stand beside the axes of all
            ConstrainedLayoutEngine().execute(figure)
        else:
            make_room(figure)
        file = io.BytesIO()
        if kind == "svg":
            # `savefig` goes through everything once before
            canvas.print_svg(file, metadata=metadata)  # type: ignore[no-untyped-call]
        else:
            figure.savefig(file, format=kind, dpi=130, metadata=metadata)
    return file.getvalue()


def make_room(figure: Figure) -> None:
    """Place the axes so that what stands about them has room: once, where matplotlib's layout measures twice."""
    drawn: list[Any] = figure.axes  # all of one grid
    grid = drawn[0].get_gridspec()
    counts, around, gaps = np.array([grid.ncols, grid.nrows]), np.zeros((2, 2)), np.zeros((2, 2))
    for axes in drawn:
        spec, box, own = axes.get_subplotspec(), axes.get_tightbbox(for_layout_only=True), axes.get_window_extent()
        outside = (own.x0 - box.x0, box.x1 - own.x1), (own.y0 - box.y0, box.y1 - own.y1)  # pixels
        columns, rows = spec.colspan, spec.rowspan
        ends = (columns.start == 0, columns.stop == grid.ncols), (rows.stop == grid.nrows, rows.start == 0)
        room = np.maximum(outside, 0.0)
        around, gaps = np.maximum(around, np.where(ends, room, 0)), np.maximum(gaps, np.where(ends, 0, room))
    around, between = around + _PAD, gaps.sum(axis=1) + 2 * _PAD
    size = np.array([figure.bbox.width, figure.bbox.height])
    free = (size - around.sum(axis=1) - (counts - 1) * between) / counts
    if np.any(free < _LEAST * size):  # a name as long as the figure: nothing gives it room
        return
    (left, bottom), (right, top) = around[:, 0] / size, 1 - around[:, 1] / size
    figure.subplots_adjust(left, bottom, right, top, *(between / free))


_PAD, _LEAST = 6.0, 0.05  # pixels, for other ticks too, where there is other room; of the figure that axes need


def _embeddable(svg: str, name: str) -> str:
    """Cut off the XML prologue and make every id of the figure its own."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    svg = renamed(svg, name)
    for colour, name in THEME.items():  # the page says which colour that is, by day and by night
        svg = svg.replace(colour, f"var(--{name}, {colour})")
    # the page's font; matplotlib has laid the text out in a wider one
    return re.sub(r"font-family: 'DejaVu Sans'[^;\"]*", "font-family: inherit", svg)
