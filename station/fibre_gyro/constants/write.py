"""The last step: constants of a run for the gyro's own logic, written into files and told."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from station.errors import CannotWrite, UsageError
from station.fibre_gyro.constants.found import Column, Constants
from station.fibre_gyro.constants.texts import c_text, csv_text, rounding, vhdl_text
from station.results.as_json import plain
from station.results.numbers import with_uncertainty
from station.results.parts import TextTable

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
                "constants": [_column(one, at) for one in constants.columns],
                "files": dict(files),
            }
        )
    )


def _column(one: Column, at: str) -> dict[str, Any]:
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
