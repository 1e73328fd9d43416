"""The CSV file of a record as the scopes of this family write it, byte for byte.

The layout was found in files of real units. A point at the time zero of a record that begins before its trigger is
written with a minus sign, as they do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from instrument.errors import FileFormatError
from instrument.facts import LEVELS_PER_DIVISION, POINTS_PER_DIVISION
from instrument.waveform import Preamble, Waveform

_UNITS = {"Volts": "V"}
_DECIMALS = 12


def csv_text(waveform: Waveform, keys: Mapping[str, str] | None = None) -> str:
    """Return the text of the CSV file; `read_waveform` of it gives the same codes."""
    preamble = waveform.preamble
    if waveform.codes.dtype != np.int8 or preamble.xunit != "s":
        raise FileFormatError("a CSV of this family holds records over time of eight bits: take another kind")
    if not np.isfinite(waveform.volts).all():
        raise FileFormatError("a CSV of this family has no sign for missing samples: take another kind")
    rows = [
        ("Record Length", f"{preamble.nr_pt:e}"),
        ("Sample Interval", f"{preamble.xincr:e}"),
        ("Trigger Point", f"{-preamble.xzero / preamble.xincr + 0.0:.12e}"),
        *[("", "")] * 3,
        ("Source", preamble.wfid.split(",")[0].upper()),
        ("Vertical Units", _UNITS.get(preamble.yunit, preamble.yunit)),
        ("Vertical Scale", f"{preamble.ymult * LEVELS_PER_DIVISION:e}"),
        ("Vertical Offset", f"{preamble.yoff * preamble.ymult + 0.0:e}"),
        ("Horizontal Units", preamble.xunit),
        ("Horizontal Scale", f"{_per_division(preamble):e}"),
        ("Pt Fmt", preamble.pt_fmt),
        ("Yzero", f"{preamble.yzero:e}"),
        *(keys or {}).items(),
    ]
    times = preamble.xzero + preamble.xincr * np.arange(preamble.nr_pt)
    first = f"{times[0]:.{_DECIMALS}f}"
    # a record that begins before its trigger has its time zero with a minus sign
    last_negative = 0.5 * preamble.xincr if preamble.xzero < 0 else -0.5 * preamble.xincr
    lines = []
    for number, (time, value) in enumerate(zip(times.tolist(), waveform.volts.tolist(), strict=True)):
        key, text = rows[number] if number < len(rows) else ("", "")
        digits, sign = f"{abs(time):.{_DECIMALS}f}", "-" if time < last_negative else ""
        # below the key rows zeros after the sign, up to the width of the first value, instead of blanks
        when = f"{sign + digits:>17}" if number < len(rows) else sign + digits.zfill(len(first))
        lines.append(f"{key},{text},,{when},{value + 0.0:10.5f},\n")
    return "".join(lines)


def _per_division(preamble: Preamble) -> float:
    """s/div, from the interval; 2.5 ns/div and its like are rounded to what the knob has."""
    wanted = preamble.xincr * POINTS_PER_DIVISION
    exponent = math.floor(math.log10(wanted))
    steps = [float(f"{digit}e{exponent}") for digit in ("1", "2.5", "5", "10")]
    nearest = min(steps, key=lambda one: abs(one / wanted - 1))
    return nearest if abs(nearest / wanted - 1) < 1e-6 else wanted
