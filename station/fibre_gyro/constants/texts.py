"""Constants as the text of a VHDL package, of a C header, and as CSV.

A word n of w bits stands for n 2^-f. VHDL takes `signed` of IEEE numeric_std, C the integers of stdint.h. Both say
of every constant what it stands for, and how far the rounding is off.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

from station.fibre_gyro.constants.found import Column, Constants
from station.results.numbers import ppm, with_uncertainty

_LARGEST_INTEGER = 2**31 - 1  # of VHDL
_PER_LINE = 4


def vhdl_text(constants: Constants) -> str:
    """Return a VHDL package.

    Examples
    --------
    The name of a package and of its constants holds what they are of.

    >>> identifier("0.01"), identifier("-20"), identifier("Z axis")
    ('0_01', 'm20', 'Z_axis')
    """
    name = f"gyro_{constants.kind}_{identifier(constants.axis)}".lower()
    lines = [*(f"-- {line}" for line in _about(constants)), "library ieee;", "use ieee.std_logic_1164.all;"]
    lines += ["use ieee.numeric_std.all;", "", f"package {name} is"]
    for column in constants.columns:
        lines += ["", *(f"  {line}" for line in _vhdl_column(column))]
    return "\n".join([*lines, "", f"end package {name};", ""])


def _vhdl_column(column: Column) -> Iterator[str]:
    words, kind = column.words, f"{column.name.lower()}_t"
    yield f"-- {column.what}, {column.unit}; a word stands for word * 2.0**(-{column.name}_FRACTION)"
    yield f"constant {column.name}_WIDTH    : positive := {words.width};"
    yield f"constant {column.name}_FRACTION : integer  := {words.fraction};"
    yield f"subtype {kind} is signed({column.name}_WIDTH - 1 downto 0);"
    literals = [_vhdl_word(word, words.width) for word in words.words]
    if column.name == "N" or not column.at.size:
        names = [f"N_{identifier(f'{rate:.10g}')}" for rate in column.at] or [column.name]
        for place, (one, literal) in enumerate(zip(names, literals, strict=True)):
            yield f"-- {_describe(column, place)}"
            yield f"constant {one} : {kind} := {literal};"
        return
    yield f"-- {_steps(column)}; {_largest(column)}"
    yield f"constant {column.name}_FIRST_C : real := {_real(float(column.at[0]))};"
    yield f"constant {column.name}_STEP_C : real := {_real(_step(column))};"
    yield f"type {column.name.lower()}_table_t is array (0 to {len(literals) - 1}) of {kind};"
    yield f"constant {column.name}_TABLE : {column.name.lower()}_table_t := ("
    for place, literal in enumerate(literals):
        yield f"  {place} => {literal}{',' if place < len(literals) - 1 else ''}"
    yield ");"


def _vhdl_word(word: int, width: int) -> str:
    if abs(word) <= _LARGEST_INTEGER:
        return f"to_signed({word}, {width})"
    return f'"{word % (1 << width):0{width}b}"'


def c_text(constants: Constants, *, floats: bool = False) -> str:
    """Return a C header."""
    name = f"GYRO_{constants.kind}_{identifier(constants.axis)}".upper()
    lines = [
        "/*",
        *(f" * {line}" for line in _about(constants)),
        " */",
        f"#ifndef {name}_H",
        f"#define {name}_H",
        "",
    ]
    if not floats:
        lines += ["#include <stdint.h>", ""]
    for column in constants.columns:
        lines += [*_c_column(column, name, floats=floats), ""]
    return "\n".join([*lines, f"#endif /* {name}_H */", ""])


def _c_column(column: Column, before: str, *, floats: bool) -> Iterator[str]:
    words, name = column.words, f"{before}_{column.name}"
    bits = next(size for size in (8, 16, 32, 64) if words.width <= size)
    if floats:
        yield f"/* {column.what}, {column.unit} */"
        kind, literals = "double", [f"{value:.17g}" for value in column.values]
    else:
        yield f"/* {column.what}, {column.unit}; a word stands for word * 2^-{words.fraction} */"
        yield f"#define {name}_WIDTH {words.width}"
        yield f"#define {name}_FRACTION {words.fraction}"
        kind, literals = f"int{bits}_t", [_c_word(word, bits) for word in words.words]
    if column.name == "N" or not column.at.size:
        names = [f"{name}_{identifier(f'{rate:.10g}')}" for rate in column.at] or [name]
        for place, (one, literal) in enumerate(zip(names, literals, strict=True)):
            yield f"/* {_describe(column, place, rounded=not floats)} */"
            yield f"#define {one} {literal}"
        return
    yield f"/* {_steps(column)}{'' if floats else f'; {_largest(column)}'} */"
    yield f"#define {name}_FIRST_C {_real(float(column.at[0]))}"
    yield f"#define {name}_STEP_C {_real(_step(column))}"
    yield f"#define {name}_COUNT {len(literals)}"
    yield f"static const {kind} {name}_TABLE[{name}_COUNT] = {{"
    for begin in range(0, len(literals), _PER_LINE):
        yield f"    {', '.join(literals[begin : begin + _PER_LINE])},"
    yield "};"


def _c_word(word: int, bits: int) -> str:
    if word == -(1 << (bits - 1)):
        return f"(INT{bits}_C({word + 1}) - 1)"
    return f"INT{bits}_C({word})"


def csv_text(constants: Constants) -> str:
    """Return one line for each constant: what it is, value, uncertainty, word and rounding error."""
    at = "temperature_c" if constants.kind == "temperature" else "rate_dps"
    lines = [f"# {line}" for line in _about(constants)]
    lines.append(f"constant,{at},value,value_u,unit,word,width,fraction,rounded,rounding_error,rounding_error_ppm")
    for column in constants.columns:
        words = column.words
        for place, value in enumerate(column.values):
            where = f"{column.at[place]:.10g}" if column.at.size else ""
            off = words.error_ppm[place]
            cells = [column.name, where, f"{value:.17g}", f"{column.values_u[place]:.6g}", column.unit]
            cells += [
                str(words.words[place]),
                str(words.width),
                str(words.fraction),
                f"{words.values[place]:.17g}",
            ]
            cells += [f"{words.error[place]:.6g}", f"{off:.6g}" if math.isfinite(off) else ""]
            lines.append(",".join(cells))
    return "\n".join([*lines, ""])


def identifier(text: str) -> str:
    """Return a text as a part of an identifier of VHDL and C."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", text.replace("-", "m").replace("+", "")).strip("_")
    return plain or "axis"


def _about(constants: Constants) -> Iterator[str]:
    run = constants.run.parent.name
    whose = f"{constants.gyro}, axis {constants.axis}: from {run}, by gyrolock fog constants."
    # no name ends the comment: neither its line nor, in C, the whole
    yield " ".join(whose.replace("*", " ").split())
    for column in constants.columns:
        words = column.words
        yield (
            f"{column.name}: words of {words.width} bits, {words.fraction} of them behind the point; "
            f"{_largest(column)}."
        )


def _describe(column: Column, place: int, *, rounded: bool = True) -> str:
    value, u = float(column.values[place]), float(column.values_u[place])
    at = f"{column.at[place]:.10g} deg/s: " if column.at.size else ""
    said = f"{at}{with_uncertainty(value, u)} {column.unit}"
    return f"{said}, rounding {rounding(column, place)}" if rounded else said


def rounding(column: Column, place: int) -> str:
    """Write the rounding error of one constant; of what may be zero in its own unit."""
    if column.name.startswith("BIAS"):
        return f"{column.words.error[place]:+.2g} {column.unit}"
    return ppm(float(column.words.error_ppm[place]))


def _step(column: Column) -> float:
    return float(column.at[1] - column.at[0]) if column.at.size > 1 else 0.0


def _real(value: float) -> str:
    """A literal that VHDL and C take for a real number."""
    text = f"{value:.10g}"
    return text if "." in text or "e" in text else f"{text}.0"


def _steps(column: Column) -> str:
    return f"from {column.at[0]:.10g} to {column.at[-1]:.10g} deg C, {column.at.size} values; none outside"


def _largest(column: Column) -> str:
    """Largest rounding error; of what may be zero in its own unit."""
    words = column.words
    if column.name.startswith("BIAS"):
        return f"rounding at most {abs(words.error).max():.2g} {column.unit}"
    return f"rounding at most {words.largest_error_ppm:.2g} ppm"
