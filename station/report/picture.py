"""A figure in the style of the reports, as an element of a page or as a file of its own."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.errors import UsageError
from station.report.plot_style import STYLE, embeddable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILE_KINDS = (".svg", ".png", ".pdf")


def svg_element(name: str, size: tuple[float, float], draw: Callable[[Figure], None]) -> str:
    """Draw a figure as an SVG element that can stand beside others in one page.

    Parameters
    ----------
    name : str
        Sets the ids of this figure apart.
    size : tuple of float
        Width and height, inches.
    draw : callable
        Draws on the figure that it is given.

    Returns
    -------
    str
        The same for the same data.
    """
    drawn = _drawn(name, size, draw, "svg", transparent=True, metadata={"Date": None, "Creator": None})
    return embeddable(drawn.decode(), name)


def write_picture(path: Path, name: str, size: tuple[float, float], draw: Callable[[Figure], None]) -> None:
    """Draw a figure into a file; its suffix says which kind. The file appears as a whole or not at all.

    Raises
    ------
    UsageError
        Another suffix than .svg, .png and .pdf.
    OSError
        The file cannot be written.
    """
    check_picture_name(path)
    kind = path.suffix.lower()
    metadata: dict[str, Any] = {
        ".svg": {"Date": None, "Creator": None},
        ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
        ".png": {"Software": None},
    }[kind]
    content = _drawn(name, size, draw, kind[1:], facecolor="white", dpi=130, metadata=metadata)
    partial = path.with_name(f"{path.name}.partial")
    try:
        partial.write_bytes(content)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def check_picture_name(path: Path) -> None:
    """Refuse a file name of which the kind of picture cannot be told, before any work is done.

    Raises
    ------
    UsageError
    """
    if path.suffix.lower() not in FILE_KINDS:
        raise UsageError(f"{path}: a picture's name ends with {', '.join(FILE_KINDS[:-1])} or {FILE_KINDS[-1]}")


def _drawn(name: str, size: tuple[float, float], draw: Callable[[Figure], None], kind: str, **how: Any) -> bytes:
    import matplotlib
    from matplotlib.figure import Figure

    style: Any = STYLE | {"svg.hashsalt": f"gyrolock-{name}"}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        file = io.BytesIO()
        figure.savefig(file, format=kind, **how)
    return file.getvalue()
