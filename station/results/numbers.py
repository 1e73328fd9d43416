"""Numbers as a person reads them."""

from __future__ import annotations

import math


def with_uncertainty(value: float, u: float, unit: str = "") -> str:
    """Write a value with its standard uncertainty in the last digits.

    Examples
    --------
    >>> with_uncertainty(0.0100023, 0.0000121, "deg/s")
    '0.010002(12) deg/s'
    >>> with_uncertainty(159.9912, 0.25, "Hz")
    '159.99(25) Hz'
    >>> with_uncertainty(36.1, 12.0)
    '36(12)'
    """
    tail = f" {unit}" if unit else ""
    if not math.isfinite(value):
        return "none"
    if not math.isfinite(u) or u <= 0:
        return f"{value:.6g}{tail}"
    digits = 1 - math.floor(math.log10(u))
    if round(u * 10.0**digits) >= 100:  # 0.0996 is written with the digits of 0.10
        digits -= 1
    if digits <= 0:
        return f"{value:.0f}({u:.0f}){tail}"
    return f"{value:.{digits}f}({round(u * 10.0**digits)}){tail}"


def with_prefix(value: float, unit: str) -> str:
    """Write a value with the unit prefix that fits.

    Examples
    --------
    >>> with_prefix(0.025, "s/div")
    '25 ms/div'
    >>> with_prefix(0.000004, "s")
    '4 µs'
    """
    if value == 0 or not math.isfinite(value):
        return f"{value:g} {unit}"
    for factor, prefix in (
        (1e9, "G"),
        (1e6, "M"),
        (1e3, "k"),
        (1.0, ""),
        (1e-3, "m"),
        (1e-6, "µ"),
        (1e-9, "n"),
    ):
        if abs(value) >= factor * 0.9999995:
            return f"{value / factor:.4g} {prefix}{unit}"
    return f"{value:.4g} {unit}"


def ppm(value: float, u: float = math.nan) -> str:
    """Write a signed value in ppm with its uncertainty.

    Examples
    --------
    >>> ppm(999.9213, 0.43), ppm(float("nan"))
    ('+999.92(43) ppm', 'none')
    """
    if not math.isfinite(value):
        return "none"
    text = with_uncertainty(value, u) if math.isfinite(u) and u > 0 else f"{value:.4g}"
    return f"{'' if text.startswith('-') else '+'}{text} ppm"
