"""The voltage on a modulator by counter arithmetic, nothing of the program in it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CODES = 2**16


def counter_voltage(
    step: int, *, span_v: float, step_s: float, bias: bool = False, offset_v: float = 0.0
) -> Callable[[Floats], Floats]:
    """A modulo counter behind a converter that spans `span_v`; the bias is a quarter of it."""

    def volts(times: Floats) -> Floats:
        number = np.floor(np.asarray(times) / step_s).astype(np.int64)
        code = (number * step) % CODES + (CODES // 4 * (number % 2) if bias else 0)
        return np.asarray(code * span_v / CODES + offset_v)

    return volts


def write_csv(
    file: Path, volts: Floats, *, interval_s: float, volts_per_division: float, point_format: str = "Y"
) -> None:
    """A record rounded to eight bits, as the scope saves it on its card; the screen's centre is at mid-span."""
    level = volts_per_division / 25
    middle = round(float(volts.min() + volts.max()) / 2 / level)
    codes = np.clip(np.rint(volts / level) - middle, -127, 127)
    header = {
        "Record Length": f"{volts.size:e}",
        "Sample Interval": f"{interval_s:e}",
        "Trigger Point": "0.000000000000e+00",
        "Source": "CH2",
        "Vertical Units": "V",
        "Vertical Scale": f"{volts_per_division:e}",
        "Vertical Offset": f"{-middle * level:e}",
        "Horizontal Units": "s",
        "Horizontal Scale": f"{250 * interval_s:e}",
        "Pt Fmt": point_format,
        "Yzero": "0.000000e+00",
    }
    names = [*header, *[""] * (volts.size - len(header))]
    rows = [
        f"{name},{header.get(name, '')},,{n * interval_s:.12f},{(code + middle) * level:.5f},\n"
        for n, (name, code) in enumerate(zip(names, codes, strict=True))
    ]
    file.write_text("".join(rows))
