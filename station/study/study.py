"""The paper's simulations beside the exact method: computed, and as JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from analysis.study import (
    BiasTable,
    Causes,
    ErrorStudy,
    ExperimentCauses,
    PeakReading,
    WaveformStudy,
    bias_table,
    find_causes,
    find_experiment_causes,
    lock_in_study,
    peak_readings,
    phase_study,
    rate_study,
    waveform_study,
)
from station.runs.progress import Progress

FIGURES = (2, 3, 4, 5, 6)
WINDOW_NAMES = {
    "boxcar": "no window",
    "hann": "Hann",
    "blackmanharris": "Blackman-Harris",
    "flattop": "flat top",
}
CAUSE_NAMES = {
    "formula": "equation (13)",
    "reading, no window": "reading peaks, no window",
    "reading, Hann": "reading peaks, Hann",
    "reading, flat top": "reading peaks, flat top",
    "noise": "noise 1 % and 8 bits",
    "earth": "earth rate, azimuth unknown",
    "tilt": "tilt ± 0.01° at 88.7°",
    "distortion": "distortion -50 dBc",
    "ours": "ours, both senses",
}
_RATES = np.linspace(0.2, 2.0, 37)
_LOCK_IN_RATES = np.linspace(0.01, 0.5, 50)


@dataclass(frozen=True)
class Study:
    """What was computed."""

    # figs. 2 and 3.
    waveforms: dict[int, WaveformStudy] = field(default_factory=dict)
    # figs. 4, 5 and 6; both halves of Fig. 4 in one.
    errors: dict[int, ErrorStudy] = field(default_factory=dict)
    bias: BiasTable | None = None
    causes: Causes | None = None
    readings: tuple[PeakReading, ...] = ()
    experiment: ExperimentCauses | None = None


def run_study(figures: Sequence[int], progress: Progress) -> Study:
    """Compute some figures of the paper; all of them bring the bias table and the causes too."""
    wanted = sorted(set(figures)) or list(FIGURES)
    parts: dict[int, Callable[[], WaveformStudy | ErrorStudy]] = {
        2: lambda: waveform_study(0.5),
        3: lambda: waveform_study(0.1),
        4: lambda: phase_study(((0.5, 0.01), (0.5, 0.03), (0.2, 0.01))),
        5: lambda: rate_study((0.01, 0.05, 0.1, 0.15), _RATES),
        6: lambda: lock_in_study(_LOCK_IN_RATES),
    }
    study = Study()
    progress.start("study", len(wanted) + (0 if figures else 3))
    for number in wanted:
        found = parts[number]()
        if isinstance(found, WaveformStudy):
            study.waveforms[number] = found
        else:
            study.errors[number] = found
        progress.advance()
    if not figures:
        bias = bias_table()
        progress.advance()
        causes, readings = find_causes(), tuple(peak_readings())
        progress.advance()
        experiment = find_experiment_causes()
        progress.advance()
        study = Study(study.waveforms, study.errors, bias, causes, readings, experiment)
    return study


def study_document(study: Study, sentences: list[str], files: list[str]) -> dict[str, Any]:
    """Return the study as plain JSON."""
    document: dict[str, Any] = {
        "scale_factor_pulses_per_deg": 2000.0,
        "sampling_hz": 20_000.0,
        "duration_s": 3.0,
        "figures": {},
        "conclusions": sentences,
        "files": files,
    }
    for number, wave in study.waveforms.items():
        document["figures"][str(number)] = _waveform_document(wave)
    for number, errors in study.errors.items():
        document["figures"][str(number)] = _error_document(number, errors)
    if study.bias is not None:
        bias = study.bias
        document["bias"] = {
            "rate_ratio": bias.rate_ratio,
            "ratio": bias.ratio,
            "formula_13_percent": 100 * bias.formula_13,
            "formula_10_percent": 100 * bias.formula_10,
            "ours_percent": 100 * bias.ours,
        }
    if study.causes is not None:
        document["causes"] = _causes_document(study.causes)
        document["peak_reading"] = [
            {"window": r.window, "largest_percent": 100 * r.largest, "rms_percent": 100 * r.rms}
            for r in study.readings
        ]
    if study.experiment is not None:
        document["experiment"] = _experiment_document(study.experiment)
    return document


def _experiment_document(experiment: ExperimentCauses) -> dict[str, Any]:
    return {
        "rate_over_lock_in": experiment.over_lock_in,
        "causes": [
            {"cause": cause.name, "rms_percent": 100 * cause.rms, "largest_percent": 100 * cause.largest}
            for cause in (*experiment.causes, experiment.ours)
        ],
        "together_rms_percent": 100 * experiment.together,
    }


def curve_name(curve: tuple[float, float]) -> str:
    """Name a curve by what is the same all along it."""
    rate, lock_in = curve
    parts = [f"W = {rate:g} deg/s"] if math.isfinite(rate) else []
    parts += [f"WL = {lock_in:g} deg/s"] if math.isfinite(lock_in) else []
    return ", ".join(parts)


def axis_name(number: int) -> str:
    """Name the axis of Figs. 4 to 6."""
    return {4: "initial phase, rad", 5: "input rate, deg/s", 6: "lock-in rate, deg/s"}[number]


def _waveform_document(wave: WaveformStudy) -> dict[str, Any]:
    by_peaks, by_fit = wave.lock_in_by(wave.peaks)[0], wave.lock_in_by(wave.fitted)[1]
    return {
        "input_rate_dps": wave.input_rate,
        "lock_in_rate_dps": wave.lock_in_rate,
        "beat_frequency_hz": wave.beat_frequency,
        "amplitudes": {
            "exact": wave.exact,
            "peaks": wave.peaks,
            "least_squares": wave.fitted,
        },
        "lock_in_rate_by_peaks_dps": by_peaks,
        "lock_in_rate_by_least_squares_dps": by_fit,
    }


def _error_document(number: int, errors: ErrorStudy) -> dict[str, Any]:
    return {
        "axis": axis_name(number),
        "values": errors.axis,
        "curves": [
            {
                "input_rate_dps": rate,
                "lock_in_rate_dps": lock_in,
                "by_peaks_percent": {name: 100 * found[place] for name, found in errors.by_peaks.items()},
                "formula_13_percent": 100 * errors.formula[place],
                "ours_percent": 100 * errors.ours[place],
            }
            for place, (rate, lock_in) in enumerate(errors.curves)
        ],
    }


def _causes_document(causes: Causes) -> list[dict[str, Any]]:
    single = ("formula", "euler", "runge_kutta", "rounding", "ours")
    windowed = ("together", "peak", "leakage")
    return [
        {
            "input_rate_dps": rate,
            "lock_in_rate_dps": lock_in,
            "bin_offset": causes.bin_offset[place],
            **{f"{name}_percent": 100 * getattr(causes, name)[place] for name in single},
            **{
                f"{name}_percent": {w: 100 * v[place] for w, v in getattr(causes, name).items()}
                for name in windowed
            },
        }
        for place, (rate, lock_in) in enumerate(causes.points)
    ]
