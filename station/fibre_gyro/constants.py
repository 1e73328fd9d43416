"""Constants for a gyro's own logic out of a run: VHDL, C and CSV, and what their rounding costs."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import FixedPoint, InjectionPlan, round_to_words, scaled_numbers
from station.errors import CannotWrite, UsageError
from station.fibre_gyro.selfcal import numbers_of
from station.fibre_gyro.settings import FIBRE_GYRO, FogSettings
from station.fibre_gyro.table_result import AxisResult, find_axes
from station.fibre_gyro.temperature import compensation_of, evaluate as evaluate_temperature
from station.results.result import TextTable, plain, ppm, with_uncertainty
from station.runs.store import SavedRun, open_run
from station.settings import saved_settings

Floats = NDArray[np.float64]

_GIVE = ("table", "selfcal", "temperature")
_SHARE_OF_U = 0.1
_LEAST_ERROR_PPM, _MOST_ERROR_PPM = 0.01, 10.0


@dataclass(frozen=True)
class WordFormat:
    """How words are made."""

    axis: str = ""  # empty: that of the settings, or the only one
    # {"differences", "fit"}: Of a rate-table run: from differences of two rates, or the scale factor by least
    # squares times the rate
    numbers: str = "differences"
    unit: str = "codes"  # {"codes", "counts"}: Codes of the staircase's step, or counts of the output
    width: int | None = None  # bits of a word, and behind the point
    fraction: int | None = None
    error_ppm: float | None = None  # largest rounding error; a tenth of the standard uncertainty if not given


@dataclass(frozen=True)
class Column:
    """Constants of one kind, with their words."""

    name: str  # part of an identifier: ``"N"``, ``"K"``, ``"BIAS"``
    what: str  # in words
    unit: str
    at: Floats  # (n,): Rates, deg/s, or temperatures, deg C, that they belong to; empty for a single constant
    values: Floats  # (n,)
    values_u: Floats
    words: FixedPoint


@dataclass(frozen=True)
class Constants:
    """All constants of a run."""

    kind: str  # {"numbers", "temperature"}: Whether `at` are rates or temperatures
    axis: str
    gyro: str
    run: Path
    columns: tuple[Column, ...]


def constants_of(path: Path, wanted: WordFormat) -> Constants:
    """Evaluate a saved run and round what it gives."""
    run = open_run(path)
    command = run.facts.command
    if command not in _GIVE:
        raise UsageError(
            f"{path}: a run of {command!r} gives no constants; those of `gyrolock fog` {', '.join(_GIVE)} do"
        )
    settings = saved_settings(FIBRE_GYRO, run.facts.settings, str(run.path))
    try:
        if command == "temperature":
            axis, columns = _over_temperature(run, settings, wanted)
        else:
            axis, columns = _of_small_rates(run, settings, wanted, command)
    except ValueError as error:
        raise UsageError(f"{path}: {error}") from None
    kind = "temperature" if command == "temperature" else "numbers"
    return Constants(kind, axis, settings.gyro.name, run.path, columns)


def _of_small_rates(
    run: SavedRun, settings: FogSettings, wanted: WordFormat, command: str
) -> tuple[str, tuple[Column, ...]]:
    if command == "selfcal":
        axis, plan = settings.selfcal.axis, numbers_of(run, settings)
        if wanted.axis not in ("", axis):
            raise UsageError(f"{run.path}: is a self-calibration of axis {axis}, not of {wanted.axis}")
    else:
        found = find_axes(run, settings)
        axis = wanted.axis or (
            settings.selfcal.axis if len(found.axes) > 1 else found.axes[0].axis if found.axes else ""
        )
        result = found.of(axis)
        if result is None:
            there = ", ".join(one.axis for one in found.axes) or "none"
            raise UsageError(f"{run.path}: gives no scale factor of axis {axis or 'Z'} (--axis); it has: {there}")
        plan = _plan_of(result, run, wanted.numbers)
    positive = plan.rate_dps > 0
    order = np.argsort(plan.rate_dps[positive])
    rate, number, u = (values[positive][order] for values in (plan.rate_dps, plan.number, plan.number_u))
    scale = settings.gyro.counts_per_code if wanted.unit == "codes" else 1.0
    values, values_u = number / scale, u / scale
    words = round_to_words(
        values, width=wanted.width, fraction=wanted.fraction, error_ppm=_error_for(values, values_u, wanted)
    )
    what = "number of a rate, added to the staircase each transit time"
    return axis, (Column("N", what, wanted.unit, rate, values, values_u, words),)


def _plan_of(result: AxisResult, run: SavedRun, numbers: str) -> InjectionPlan:
    made = result.differences
    if made is None:
        raise UsageError(f"{run.path}: has one rate only, and no differences: take several rates")
    if numbers == "fit":
        return scaled_numbers(made.delta_dps, result.fit.scale_factor, result.fit.scale_factor_u)
    return InjectionPlan(made.delta_dps.round(9), made.number, made.number_u, np.eye(made.number.size))


def _over_temperature(run: SavedRun, settings: FogSettings, wanted: WordFormat) -> tuple[str, tuple[Column, ...]]:
    found = evaluate_temperature(run, settings, {})
    meant = [one for one in found.axes if wanted.axis in (one.axis, "")]
    if len(meant) != 1:
        names = ", ".join(one.axis for one in found.axes)
        raise UsageError(f"{run.path}: name one of its axes with --axis: {names}")
    one = meant[0]
    table = compensation_of(one, settings)
    columns = []
    for name, what, unit, values, values_u in (
        ("K", "scale factor", "counts per deg/s", table.scale_factor, table.scale_factor_u),
        ("BIAS", "bias without dT/dt", "deg/h", table.bias, table.bias_u),
    ):
        known = np.isfinite(values)
        if known.any():
            columns.append(
                _column(name, what, unit, table.temperature[known], values[known], values_u[known], wanted)
            )
    if table.bias_rate:
        rate, rate_u = np.array([table.bias_rate]), np.array([table.bias_rate_u])
        unit = "deg/h per kelvin a minute"
        columns.append(_column("BIAS_RATE", "bias by dT/dt", unit, np.empty(0), rate, rate_u, wanted))
    if not columns:
        raise ValueError("the measured temperatures hold no whole multiple of temperature.table_step_c")
    return one.axis, tuple(columns)


def _column(
    name: str, what: str, unit: str, at: Floats, values: Floats, values_u: Floats, wanted: WordFormat
) -> Column:
    """Words of a column; a bias goes through zero, so its rounding is measured by its uncertainty."""
    if wanted.width is not None or wanted.fraction is not None:
        return Column(
            name,
            what,
            unit,
            at,
            values,
            values_u,
            round_to_words(values, width=wanted.width, fraction=wanted.fraction),
        )
    size = float(np.abs(values).max()) or 1.0
    allowed = wanted.error_ppm * 1e-6 * size if wanted.error_ppm else _SHARE_OF_U * float(values_u.min())
    # half of the last place at most
    fraction = max(0, math.ceil(-math.log2(2 * max(allowed, 1e-9 * size))))
    return Column(name, what, unit, at, values, values_u, round_to_words(values, fraction=fraction))


def _error_for(values: Floats, values_u: Floats, wanted: WordFormat) -> float:
    """Largest rounding error, ppm, that is hardly seen beside the uncertainty."""
    if wanted.error_ppm is not None:
        return wanted.error_ppm
    relative = 1e6 * values_u[values != 0] / np.abs(values[values != 0])
    return (
        float(np.clip(_SHARE_OF_U * relative.min(), _LEAST_ERROR_PPM, _MOST_ERROR_PPM)) if relative.size else 1.0
    )


# --------------------
# The last step: constants of a run for the gyro's own logic, written into files and told


_SCHEMA = {"name": "gyrolock fog constants", "version": 1}


def write_constants(constants: Constants, files: Mapping[str, Path], *, floats: bool, replace: bool) -> None:
    """Write the files."""
    for path in files.values():
        if path.exists() and not replace:
            raise UsageError(f"{path}: is there already; --replace writes over it")
    texts = {"vhdl": vhdl_text, "c": lambda one: c_text(one, floats=floats), "csv": csv_text}
    for kind, path in files.items():
        try:
            path.write_text(texts[kind](constants), encoding="utf-8")
        except OSError as error:
            raise CannotWrite(f"{path}: cannot be written ({error.strerror})") from None


def constants_document(constants: Constants, files: Mapping[str, Path]) -> dict[str, Any]:
    """Return everything as one JSON document."""
    at = "temperature_c" if constants.kind == "temperature" else "rate_dps"
    return dict(
        plain(
            {
                "schema": _SCHEMA,
                "kind": constants.kind,
                "gyro": constants.gyro,
                "axis": constants.axis,
                "run": constants.run,
                "constants": [_csv_column(one, at) for one in constants.columns],
                "files": dict(files),
            }
        )
    )


def _csv_column(one: Column, at: str) -> dict[str, Any]:
    words = one.words
    return {
        "name": one.name,
        "what": one.what,
        "unit": one.unit,
        "width": words.width,
        "fraction": words.fraction,
        "largest_rounding_error_ppm": words.largest_error_ppm,
        at: one.at,
        "values": one.values,
        "values_u": one.values_u,
        "words": words.words,
        "rounded": words.values,
        "rounding_error": words.error,
        "rounding_error_ppm": words.error_ppm,
    }


def constants_table(constants: Constants) -> TextTable:
    """Return the constants for the terminal."""
    rows = []
    for one in constants.columns:
        for place, word in enumerate(one.words.words):
            at = f"{one.at[place]:g}" if one.at.size else ""
            known = with_uncertainty(float(one.values[place]), float(one.values_u[place]))
            form = f"{one.words.width}.{one.words.fraction}"
            rows.append((f"{one.name} {at}".strip(), known, str(word), form, rounding(one, place)))
    unit = constants.columns[0].unit
    return TextTable(
        ("constant", unit if len(constants.columns) == 1 else "value", "word", "bits", "rounding"), tuple(rows)
    )


# --------------------
# Constants as the text of a VHDL package, of a C header, and as CSV.
#
# A word n of w bits stands for n 2^-f. VHDL takes `signed` of IEEE numeric_std, C the integers of stdint.h. Both
# say of every constant what it stands for, and how far the rounding is off


_LARGEST_INTEGER = 2**31 - 1  # of VHDL
_PER_LINE = 4


def vhdl_text(constants: Constants) -> str:
    """Return a VHDL package."""
    # The name of a package and of its constants holds what they are of.
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
    literals = [
        f"to_signed({word}, {words.width})"
        if abs(word) <= _LARGEST_INTEGER
        else f'"{word % (1 << words.width):0{words.width}b}"'
        for word in words.words
    ]
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
        kind, least = f"int{bits}_t", -(1 << (bits - 1))  # which C has no literal of
        one = f"(INT{bits}_C({least + 1}) - 1)"
        literals = [one if word == least else f"INT{bits}_C({word})" for word in words.words]
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
