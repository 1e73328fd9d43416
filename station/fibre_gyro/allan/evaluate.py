"""What the output at rest says: the noise model, and the Allan deviation beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.fibre_gyro import AllanCurve, NoiseFit, allan_curve, fit_noise
from station.errors import NoUsableSignal
from station.fibre_gyro.common import reasons_of
from station.fibre_gyro.recordings import Segment, segments_of
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.windows import checked, words_of
from station.results.result import LeftOut
from station.runs.store import SavedRun

PURPOSE = "allan"


@dataclass(frozen=True)
class NoiseOf:
    """Noise of one record at rest; `curve` in deg/s, of the words with the missing ones put in."""

    key: str
    duration_s: float
    fit: NoiseFit
    curve: AllanCurve
    by_design: bool  # whether the output came in counts, which only the scale factor by design turns into deg/s


@dataclass(frozen=True)
class AllanFound:
    """Noise of each record that could be used."""

    records: tuple[NoiseOf, ...]
    left_out: tuple[LeftOut, ...]


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> AllanFound:
    """Fit the noise model to each record."""
    found, left_out = [], []
    for segment in segments_of(run, PURPOSE):
        try:
            found.append(_noise_of(segment, settings))
        except ValueError as error:
            left_out.append(LeftOut(segment.key, str(error)))
    if not found:
        raise NoUsableSignal(f"there is no output at rest to make a noise model of{reasons_of(left_out)}")
    return AllanFound(tuple(found), tuple(left_out))


def _noise_of(segment: Segment, settings: FogSettings) -> NoiseOf:
    recording = checked(segment)
    words = words_of(recording) / settings.nominal_scale_factor
    temperature = None
    if settings.allan.temperature:
        if recording.temperature is None or not np.ptp(recording.temperature) > 0:
            raise ValueError("its temperature is not there or does not change: take allan.temperature away")
        temperature = np.interp(
            np.arange(words.size) * recording.interval_s,
            recording.times - recording.times[0],
            recording.temperature,
        )
    fit = fit_noise(words, recording.interval_s, temperature=temperature)
    shown = words if temperature is None else words - fit.temperature_slope * (temperature - temperature.mean())
    curve = allan_curve(shown, recording.interval_s, fit.coefficients)
    by_design = segment.conditions.get("output_unit", "counts") == "counts"
    return NoiseOf(segment.key, words.size * recording.interval_s, fit, curve, by_design)
