"""A record as the scope sent it: raw codes and their preamble, and how both become volts and seconds.

The preamble is the answer to ``WFMPre?`` (programmer manual 071-1075-04, p. 2-243 to 2-260). Volts and times
are computed when they are asked for; the codes stay what the analogue-digital converter gave.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.errors import TransferError
from instrument.scpi import (
    DIVISIONS,
    HIGHEST_CODE,
    LEVELS_PER_DIVISION,
    NO_DATA,
    VERTICAL_DIVISIONS,
    integer,
    nr3,
    number,
    split_header,
    split_parts,
    unquote,
)

_PLOT_UNITS = {"Volts": "V"}
_LARGEST_NUMBER = 1e18


@dataclass(frozen=True)
class Preamble:
    """The 16 fields of ``WFMPre?`` in the order in which the scope sends them.

    Attributes
    ----------
    byt_nr, bit_nr : int
        Bytes and bits per point, 1 and 8 or 2 and 16.
    encdg, bn_fmt, byt_or : str
        ``BIN`` or ``ASC``; ``RI`` signed or ``RP`` positive; ``MSB`` or ``LSB`` first.
    nr_pt : int
        Number of points.
    wfid : str
        Sentence with source, coupling, V/div, s/div and mode.
    pt_fmt : str
        ``Y`` one value a point, ``ENV`` pairs of minimum and maximum (Peak Detect).
    xincr, xzero : float
        Interval between points and time of the first one from the trigger, in `xunit`.
    pt_off : int
        Always 0 on this family.
    xunit, yunit : str
        ``s`` or ``Hz``; ``Volts``, ``V``, ``dB``, ``U`` (unknown)...
    ymult, yzero, yoff : float
        value = (code - yoff) * ymult + yzero, in `yunit`.
    """

    byt_nr: int
    bit_nr: int
    encdg: str
    bn_fmt: str
    byt_or: str
    nr_pt: int
    wfid: str
    pt_fmt: str
    xincr: float
    pt_off: int
    xzero: float
    xunit: str
    ymult: float
    yzero: float
    yoff: float
    yunit: str

    @staticmethod
    def parse(text: str) -> Preamble:
        """Read a preamble with or without headers, in long or short spelling.

        With headers the fields may come in any order and among others that are not known here (newer scopes
        add some); without headers there must be exactly 16.

        Raises
        ------
        TransferError
            If a field is missing, is not what it should be, or contradicts another.
        """
        return _parsed(text)

    @property
    def implausible(self) -> bool:
        """Whether a number is beyond all that scopes have: arithmetic with it would fail."""
        numbers = (
            self.xincr,
            1 / self.xincr if self.xincr else 0.0,
            self.pt_off,
            self.xzero,
            self.ymult,
            self.yzero,
            self.yoff,
        )
        return max(map(abs, numbers)) > _LARGEST_NUMBER

    def to_text(self) -> str:
        """The 16 fields without headers, as the scope writes them; `parse` of it gives an equal preamble."""
        words = []
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in ("wfid", "xunit", "yunit"):
                words.append('"' + value.replace('"', '""') + '"')
            else:
                words.append(nr3(value) if isinstance(value, float) else str(value))
        return ";".join(words)


@lru_cache(maxsize=4096)
def _parsed(text: str) -> Preamble:
    """See `Preamble.parse`: most records of a run have the same text."""
    parts = [split_header(part) for part in split_parts(text.strip().rstrip(";"))]
    names = [field.name for field in fields(Preamble)]
    if any(header for header, _ in parts):
        named = ((_MNEMONICS.get(header.rsplit(":", 1)[-1].upper()), value) for header, value in parts)
        values = {name: value for name, value in named if name is not None}
        missing = [name for name in names if name not in values]
        if missing:
            raise TransferError(f"the preamble has no {missing[0].upper()} ({text[:60]!r}); ask again")
    elif len(parts) == len(names):
        values = dict(zip(names, (value for _, value in parts), strict=True))
    else:
        raise TransferError(
            f"the preamble has {len(parts)} fields instead of {len(names)} ({text[:60]!r}); ask again"
        )
    read: dict[str, Any] = {name: _READERS[name](values[name]) for name in names}
    return _checked(Preamble(**read))


@dataclass(frozen=True, eq=False, repr=False)
class Waveform:
    """One record: raw codes and the preamble that belongs to them. NumPy takes it as the array of its volts.

    Attributes
    ----------
    codes : int8 array, shape (n,)
        What the converter gave; -128 means "no data". Only a file from a newer scope with more than eight
        bits gives int16.
    preamble : Preamble
        Describes `codes` (one signed byte a point, whatever the transfer format was).
    """

    codes: NDArray[np.int8] | NDArray[np.int16]
    preamble: Preamble

    def __post_init__(self) -> None:
        if self.codes.shape != (self.preamble.nr_pt,):
            raise TransferError(
                f"{self.codes.shape} codes came with a preamble for {self.preamble.nr_pt} points; ask again"
            )
        self.codes.flags.writeable = False

    def __eq__(self, other: object) -> bool:
        """Equal when preamble and every code are equal."""
        if not isinstance(other, Waveform):
            return NotImplemented
        return self.preamble == other.preamble and np.array_equal(self.codes, other.codes)

    @property
    def volts(self) -> NDArray[np.float64]:
        """Values in the preamble's `yunit`, shape (n,); nan where the scope had no data."""
        preamble = self.preamble
        values = (self.codes.astype(np.float64) - preamble.yoff) * preamble.ymult + preamble.yzero
        if self.codes.dtype == np.int8:
            values[self.codes == NO_DATA] = np.nan
        return values

    @property
    def times(self) -> NDArray[np.float64]:
        """Times from the trigger in s, shape (n,); for an FFT frequencies in Hz, see the preamble's `xunit`.

        In Peak Detect points 2k and 2k + 1 are the minimum and maximum of one interval that starts at 2k.
        """
        preamble = self.preamble
        points = np.arange(preamble.nr_pt, dtype=np.float64) - preamble.pt_off
        return preamble.xzero + preamble.xincr * points

    @property
    def sample_interval(self) -> float:
        """Time between two points in s."""
        return self.preamble.xincr

    @property
    def clipped_samples(self) -> NDArray[np.bool_]:
        """Which points lie at the end of the converter's range (codes +127 or -127), shape (n,)."""
        codes = self.codes.astype(np.int32)
        if self.codes.dtype == np.int8:
            return np.asarray((np.abs(codes) >= HIGHEST_CODE) & (codes != NO_DATA))
        return np.asarray(np.abs(codes) >= HIGHEST_CODE * 256)

    @property
    def clipped(self) -> bool:
        """Whether any point is clipped."""
        return bool(self.clipped_samples.any())

    def plot(self, axes: Any = None) -> Any:
        """Draw the record with Matplotlib, into `axes` or a new figure; returns the axes.

        Raises
        ------
        ImportError
            If Matplotlib is not installed.
        """
        if axes is None:
            import matplotlib.pyplot as plt

            _, axes = plt.subplots()
        source = self.preamble.wfid.split(",")[0]
        spectrum = self.preamble.xunit == "Hz"
        axes.plot(self.times, self.volts, linewidth=1.0, label=source)
        axes.set_xlabel(f"{'frequency' if spectrum else 'time from trigger'} / {self.preamble.xunit}")
        axes.set_ylabel(f"{source} / {_PLOT_UNITS.get(self.preamble.yunit, self.preamble.yunit)}")
        axes.grid(True, alpha=0.3)
        return axes

    def __len__(self) -> int:
        return len(self.codes)

    def __array__(self, dtype: np.dtype[Any] | type | None = None, copy: bool | None = None) -> NDArray[Any]:
        """The volts, so that ``np.asarray(waveform)`` and every function of NumPy take them."""
        if copy is False:
            raise ValueError(
                "the volts of a waveform are computed from its codes and cannot be had without a copy"
            )
        return self.volts if dtype is None else self.volts.astype(dtype, copy=False)

    def __repr__(self) -> str:
        preamble = self.preamble
        source = preamble.wfid.split(",")[0]
        points = f"{len(self)} points every {self.sample_interval:.4g} {preamble.xunit}"
        return f"<Waveform of {source}: {points}, {self._span()}>"

    def _span(self) -> str:
        """The lowest and the highest value, in words."""
        valid = self.volts[np.isfinite(self.volts)]
        if not valid.size:
            return "no data"
        span = f"{valid.min():.4g} to {valid.max():.4g} {self.preamble.yunit}"
        return f"{span}, clipped" if self.clipped else span

    def _repr_html_(self) -> str:
        """Small table and picture for a notebook."""
        preamble = self.preamble
        rows = (
            ("record", preamble.wfid),
            ("points", f"{preamble.nr_pt}, every {self.sample_interval:.4g} {preamble.xunit}"),
            ("values", self._span()),
        )
        cells = "".join(f"<tr><th>{name}</th><td>{escape(text)}</td></tr>" for name, text in rows)
        levels = VERTICAL_DIVISIONS * LEVELS_PER_DIVISION * (1 if self.codes.dtype == np.int8 else 256)
        bottom, top = (
            (code - preamble.yoff) * preamble.ymult + preamble.yzero for code in (-levels / 2, levels / 2)
        )
        picture = waveform_svg(
            self.volts,
            start=preamble.xzero,
            interval=preamble.xincr,
            screen=(bottom, top),
            units=(preamble.xunit, preamble.yunit),
        )
        return f"<table>{cells}</table>{picture}"


def decode_curve(data: bytes, preamble: Preamble) -> Waveform:
    """Turn the data of ``CURVe?`` into a waveform, whatever the transfer format."""
    # Codes and preamble come out as one signed byte a point: positive integers are shifted to signed ones and the
    # empty low byte of two-byte points is dropped, with `yoff` and `ymult` changed to fit, so that the volts are
    # the same.
    values = _ascii_codes(data, preamble) if preamble.encdg == "ASC" else _binary_codes(data, preamble)
    if len(values) != preamble.nr_pt:
        raise TransferError(f"{len(values)} points came where the preamble announces {preamble.nr_pt}; ask again")
    half_range = 128 if preamble.byt_nr == 1 else 32768
    yoff, ymult = preamble.yoff, preamble.ymult
    if preamble.encdg != "ASC" and preamble.bn_fmt == "RP":
        # An ASCII curve is signed even though its preamble says RP, so only binary data are shifted.
        values, yoff = values - half_range, yoff - half_range
    signed = replace(preamble, encdg="BIN", bn_fmt="RI")
    if preamble.byt_nr == 2 and not np.any(values % 256):
        values, yoff, ymult = values // 256, yoff / 256, ymult * 256
        signed = replace(signed, byt_nr=1, bit_nr=8)
    limit = 128 if signed.byt_nr == 1 else 32768
    if values.min() < -limit or values.max() >= limit:
        raise TransferError("the curve holds values outside the range of its preamble; ask again")
    codes = values.astype(np.int8) if signed.byt_nr == 1 else values.astype(np.int16)
    return Waveform(codes, replace(signed, yoff=yoff, ymult=ymult))


def _binary_codes(data: bytes, preamble: Preamble) -> NDArray[np.int64]:
    if len(data) != preamble.nr_pt * preamble.byt_nr:
        raise TransferError(
            f"the block holds {len(data)} bytes where the preamble announces {preamble.nr_pt} points "
            f"of {preamble.byt_nr} byte(s); ask again"
        )
    order = ">" if preamble.byt_or == "MSB" else "<"
    kind = "i" if preamble.bn_fmt == "RI" else "u"
    return np.frombuffer(data, dtype=f"{order}{kind}{preamble.byt_nr}").astype(np.int64)


def _ascii_codes(data: bytes, preamble: Preamble) -> NDArray[np.int64]:
    words = data.decode("ascii", errors="replace").split(",")
    values = [integer(word) for word in words]
    if max(map(abs, values)) >= 1 << 32:
        raise TransferError("the curve holds values outside the range of its preamble; ask again")
    return np.array(values, dtype=np.int64)


def _checked(preamble: Preamble) -> Preamble:
    """Refuse a preamble whose fields contradict each other: then a byte was lost in it."""
    problems = (
        (preamble.byt_nr in (1, 2), "BYT_NR is neither 1 nor 2"),
        (preamble.bit_nr == 8 * preamble.byt_nr, "BIT_NR does not fit BYT_NR"),
        (preamble.encdg in ("ASC", "BIN"), "ENCDG is neither ASC nor BIN"),
        (preamble.bn_fmt in ("RI", "RP"), "BN_FMT is neither RI nor RP"),
        (preamble.byt_or in ("MSB", "LSB"), "BYT_OR is neither MSB nor LSB"),
        (preamble.nr_pt >= 1, "NR_PT is not positive"),
        (preamble.pt_fmt in ("Y", "ENV"), "PT_FMT is neither Y nor ENV"),
        (preamble.xincr > 0, "XINCR is not positive"),
        (preamble.ymult >= 0, "YMULT is negative"),
        (not preamble.implausible, "a number in it is larger or smaller than any scope has"),
    )
    for is_right, problem in problems:
        if not is_right:
            raise TransferError(f"the preamble contradicts itself, {problem}; ask again")
    return preamble


def _word(text: str) -> str:
    word = text.strip().upper()
    # A long spelling may come from other software that wrote the file.
    return {"ASCII": "ASC", "BINARY": "BIN"}.get(word, word)


_READERS = {
    "byt_nr": integer,
    "bit_nr": integer,
    "encdg": _word,
    "bn_fmt": _word,
    "byt_or": _word,
    "nr_pt": integer,
    "wfid": unquote,
    "pt_fmt": _word,
    "xincr": number,
    "pt_off": integer,
    "xzero": number,
    "xunit": unquote,
    "ymult": number,
    "yzero": number,
    "yoff": number,
    "yunit": unquote,
}

# Long and short spellings of the header mnemonics (capital letters of the manual's spelling, p. 2-243).
_SHORT = (
    *("BYT_N", "BIT_N", "ENC", "BN_F", "BYT_O", "NR_P", "WFI", "PT_F"),
    *("XIN", "PT_O", "XZE", "XUN", "YMU", "YZE", "YOF", "YUN"),
)
_MNEMONICS = {name.upper(): name for name in _READERS} | dict(zip(_SHORT, _READERS, strict=True))


# --------------------
# A record as it would stand on the scope's screen, as SVG for a notebook; needs no plotting library


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
    """The curve over the divisions of the screen, with the values at its edges."""
    # A column of the picture shows the lowest and the highest of its points, as the scope's own screen does.
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
    for place, column in enumerate(columns):
        found = column[np.isfinite(column)]
        if not len(found):
            pen = "M"
            continue
        x = _LEFT + (place + 0.5) * step
        ends = [found[0], found.min(), found.max(), found[-1]] if len(found) > 1 else [found[0]]
        bottom, top = screen
        above_middle = (np.array(ends) - (bottom + top) / 2) / ((top - bottom) or 1.0)
        for y in _MARGIN + _HEIGHT * (0.5 - np.clip(above_middle, -0.5, 0.5)):
            parts.append(f"{pen}{x:.1f} {y:.1f}")
            pen = "L"
    return "".join(parts)


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
