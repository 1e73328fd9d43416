"""The noise model that another run found, for what the slow noise of the gyro makes of a run.

`--noise` names a run of `gyrolock fog allan`, its JSON document, or a JSON file with the numbers of a data sheet:

    {"angle_random_walk_deg_per_sqrt_h": 0.005, "bias_instability_dph": 0.05}
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import window_covariance
from instrument.small_files import read_small_file
from station.errors import UsageError
from station.fibre_gyro.allan.result import UNITS
from station.runs.database import is_database
from station.runs.store import SavedRun, open_run

Floats = NDArray[np.float64]

NOISE = "noise"
"""Fact of a run, and choice of its evaluation."""
_LARGEST = 64_000_000  # bytes
_FAST = ("angle_random_walk", "quantization")
_AXES = ("X", "Y", "Z")


@dataclass(frozen=True)
class NoiseModel:
    """Noise of one gyro."""

    coefficients: dict[str, float]  # deg and s
    source: str  # where it comes from, in words

    def fast_variance(self, duration_s: Floats) -> Floats:
        """Variance of means by white noise and quantization, (deg/s)^2."""
        white, angle = (self.coefficients.get(name, 0.0) for name in _FAST)
        return np.asarray(white**2 / duration_s + 2 * (angle / duration_s) ** 2)

    def slow_covariance(self, begin_s: Floats, end_s: Floats) -> Floats:
        """Generalised covariance of means by bias instability and rate random walk, (deg/s)^2."""
        slow = {name: value for name, value in self.coefficients.items() if name not in _FAST}
        return window_covariance(slow, begin_s, end_s)


def noise_facts(path: Path | None) -> dict[str, Any]:
    """Return a noise model as fact of the run that uses it; nothing without a path."""
    if path is None:
        return {}
    records = _of_run(path) if path.exists() and _is_run(path) else _of_json(path)
    gyros: dict[str, dict[str, float]] = {}
    for name, coefficients in records:
        first = name.split(" ")[0].upper()
        gyros.setdefault(first if first in _AXES and len(records) > 1 else "", coefficients)
    return {NOISE: {"source": str(path), "gyros": gyros}}


def noise_of(run: SavedRun, choices: Mapping[str, Any], axis: str) -> NoiseModel | None:
    """Return the noise model of the gyro of one axis: one that is chosen now, or the one that the run knows."""
    known = choices.get(NOISE) or run.facts.get(NOISE)
    if not known:
        return None
    gyros = known["gyros"]
    coefficients = gyros.get(axis.upper(), gyros.get(""))
    return None if coefficients is None else NoiseModel(dict(coefficients), known["source"])


def _is_run(path: Path) -> bool:
    return path.is_dir() or is_database(path)


def _of_run(path: Path) -> list[tuple[str, dict[str, float]]]:
    from station.fibre_gyro.allan.evaluate import PURPOSE, evaluate
    from station.fibre_gyro.settings import FIBRE_GYRO
    from station.settings.load import saved_settings

    run = open_run(path)
    if run.facts.command != PURPOSE:
        raise UsageError(
            f"{path}: is a run of {run.facts.command!r}; a noise model comes from `gyrolock fog allan`"
        )
    found = evaluate(run, saved_settings(FIBRE_GYRO, run.facts.settings, str(run.path)), {})
    return [(one.key, dict(one.fit.coefficients)) for one in found.records]


def _of_json(path: Path) -> list[tuple[str, dict[str, float]]]:
    try:
        document = json.loads(read_small_file(path, _LARGEST))
    except (UnicodeDecodeError, json.JSONDecodeError):
        document = None
    if not isinstance(document, dict):
        raise UsageError(
            f"{path}: is neither a run of `gyrolock fog allan` nor its JSON: name one of them for the noise model"
        )
    records = document.get("records") or [document]
    return [(str(one.get("name", "")), _coefficients(one, path)) for one in records if isinstance(one, dict)]


def _coefficients(record: Mapping[str, Any], path: Path) -> dict[str, float]:
    found = {}
    for term, (name, _, unit, scale) in UNITS.items():
        value = record.get(name) or 0.0
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
            raise UsageError(f"{path}: {name}: {value!r} is no number of {unit}, 0 or more")
        if value:
            found[term] = value / scale
    if not any(name != "rate_ramp" for name in found):
        names = ", ".join(name for name, *_ in UNITS.values())
        raise UsageError(f"{path}: holds no noise model; it has numbers under the names {names}")
    return found
