"""The CSV file of one waveform as these instruments write it: key rows beside the first points.

Taken from files of real units. A point at the time zero of a record that begins before its trigger is written with
a minus sign, as they do.
"""

from __future__ import annotations

import math

import numpy as np

from instrument.facts import DIVISIONS, LEVELS_PER_DIVISION, POINTS_PER_DIVISION
from instrument.simulated.front_end.traces import Trace

_UNITS = {"Volts": "V"}


def csv_file(trace: Trace, source: str, probe: float, keys: dict[str, str]) -> bytes:
    """Content of the file."""
    spectrum = trace.xunit == "Hz"
    width = trace.points / DIVISIONS if spectrum else POINTS_PER_DIVISION
    values = (trace.codes.astype(np.float64) - trace.yoff) * trace.ymult + trace.yzero
    rows = [
        ("Record Length", f"{trace.points:e}"),
        ("Sample Interval", f"{trace.xincr:e}"),
        ("Trigger Point", f"{0.0 if spectrum else -trace.xzero / trace.xincr:.12e}"),
        *[("", "")] * 3,
        ("Source", f"REF{'ABCD'.index(source[-1]) + 1}" if source.startswith("REF") else source),
        ("Vertical Units", _UNITS.get(trace.yunit, trace.yunit)),
        ("Vertical Scale", f"{trace.ymult * LEVELS_PER_DIVISION:e}"),
        ("Vertical Offset", f"{trace.yoff * trace.ymult:e}"),
        ("Horizontal Units", trace.xunit),
        ("Horizontal Scale", f"{trace.xincr * width:e}"),
        ("Pt Fmt", trace.pt_fmt),
        ("Yzero", f"{trace.yzero:e}"),
        ("Probe Atten", f"{probe:e}"),
        *keys.items(),
    ]
    digits = 5 if spectrum else 12
    times = trace.xzero + trace.xincr * np.arange(trace.points)
    first = f"{times[0]:.{digits}f}"
    lines = []
    for number, (time, value) in enumerate(zip(times.tolist(), values.tolist(), strict=True)):
        key, text = rows[number] if number < len(rows) else ("", "")
        when = f"{time:17.{digits}f}" if number < len(rows) else _narrow(time, digits, first)
        lines.append(f"{key},{text},,{when},{value + 0.0:10.5f},\n")
    return "".join(lines).encode("ascii")


def _narrow(time: float, digits: int, first: str) -> str:
    """A time below the key rows: zeros up to the width of the first one, behind the sign."""
    size = f"{abs(time):.{digits}f}".rjust(len(first), "0")
    is_zero = not float(size)
    negative = first.startswith("-") if is_zero else math.copysign(1.0, time) < 0
    return f"-{size}" if negative else size
