"""The study as tables of numbers, for a terminal and for files."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

from analysis.study import BiasTable, Causes, ErrorStudy, ExperimentCauses, PeakReading, WaveformStudy
from station.study.study import CAUSE_NAMES, WINDOW_NAMES, Study

_SHOWN_ROWS = 13


@dataclass(frozen=True)
class StudyTable:
    """A table of numbers."""

    name: str  # also that of its file
    title: str
    columns: tuple[str, ...]  # heads, and how to write the numbers below
    formats: tuple[str, ...]
    rows: list[Sequence[float | str]]
    shown: tuple[int, ...] = ()  # the rows that a terminal shows; empty: all

    def texts(self) -> list[list[str]]:
        """Return the rows that a terminal shows as text."""
        rows = [self.rows[place] for place in self.shown] or self.rows
        return [[_text(cell, form) for cell, form in zip(row, self.formats, strict=True)] for row in rows]

    def as_csv(self) -> str:
        """Return all rows, numbers with all their digits."""
        file = io.StringIO()
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(self.rows)
        return file.getvalue()


def study_tables(study: Study) -> list[StudyTable]:
    """Return everything that was computed as tables of numbers."""
    tables = [_waveform_table(number, found) for number, found in study.waveforms.items()]
    tables += [_error_table(number, found) for number, found in study.errors.items()]
    if study.bias is not None:
        tables.append(_bias_table(study.bias))
    if study.causes is not None:
        tables += [_causes_table(study.causes, window) for window in study.causes.together]
        tables.append(_other_causes_table(study.causes))
    if study.readings:
        tables.append(_readings_table(study.readings))
    if study.experiment is not None:
        tables.append(_experiment_table(study.experiment))
    return tables


def _waveform_table(number: int, wave: WaveformStudy) -> StudyTable:
    rows: list[Sequence[float | str]] = [
        (order, order * wave.beat_frequency, *(float(a[order - 1]) for a in (wave.exact, wave.peaks, wave.fitted)))
        for order in range(1, wave.exact.size + 1)
    ]
    title = (
        f"Fig. {number}: W = {wave.input_rate:g}, WL = {wave.lock_in_rate:g} deg/s; amplitudes of the harmonics"
    )
    columns = ("harmonic", "frequency_hz", "exact", "peak_of_the_spectrum", "least_squares")
    return StudyTable(f"figure{number}", title, columns, ("d", ".4f", ".6f", ".6f", ".6f"), rows)


def _error_table(number: int, errors: ErrorStudy) -> StudyTable:
    with_phase = number == 4
    columns = ["W, deg/s", "WL, deg/s", *(["initial phase, rad"] if with_phase else [])]
    columns += [f"{WINDOW_NAMES[window]}, %" for window in errors.by_peaks] + ["equation (13) alone, %", "ours, %"]
    rows: list[Sequence[float | str]] = []
    for place, (rate, lock_in) in enumerate(errors.curves):
        series = [*(found[place] for found in errors.by_peaks.values()), errors.formula[place], errors.ours[place]]
        for index, value in enumerate(errors.axis):
            where = [
                rate if math.isfinite(rate) else float(value),
                lock_in if math.isfinite(lock_in) else float(value),
            ]
            where += [float(value)] if with_phase else []
            rows.append([*where, *(100 * float(values[index]) for values in series)])
    step = max(1, math.ceil((errors.axis.size - 1) / (_SHOWN_ROWS - 1)))
    shown = tuple(row for row in range(len(rows)) if row % errors.axis.size % step == 0)
    what = "" if with_phase else ", the largest over the initial phase"
    title = f"Fig. {number}: error of the lock-in rate by peaks of a spectrum and equation (13){what}"
    formats = (*(["g", "g"] + [".3f"] * with_phase), *[".3f"] * (len(errors.by_peaks) + 1), ".0e")
    return StudyTable(f"figure{number}", title, tuple(columns), formats, rows, shown)


def _bias_table(bias: BiasTable) -> StudyTable:
    rows: list[Sequence[float | str]] = [
        [float(v) for v in row]
        for row in zip(
            bias.rate_ratio, bias.ratio, 100 * bias.formula_13, 100 * bias.formula_10, 100 * bias.ours, strict=True
        )
    ]
    columns = ("x = WL/W", "r = A2/A1", "equation (13), %", "equation (10), %", "ours, %")
    title = "Bias of the paper's formulas, and what the exact method leaves on exact records"
    return StudyTable("bias", title, columns, (".2f", ".8f", "+.4f", "+.4f", ".0e"), rows)


def _causes_table(causes: Causes, window: str) -> StudyTable:
    rows: list[Sequence[float | str]] = []
    for place, (rate, lock_in) in enumerate(causes.points):
        parts = (causes.formula, causes.peak[window], causes.leakage[window], causes.together[window])
        offset = float(causes.bin_offset[place])
        rows.append([rate, lock_in, rate / lock_in, offset, *(100 * float(part[place]) for part in parts)])
    columns = ("W", "WL", "W/WL", "bin offset", "formula, %", "peak reading, %", "leakage, %", "together, %")
    title = f"Causes of the paper's error, window of the spectrum: {WINDOW_NAMES[window]}"
    formats = ("g", "g", ".1f", "+.3f", "+.3f", "+.3f", "+.4f", "+.3f")
    return StudyTable(f"causes_{window}", title, columns, formats, rows)


def _other_causes_table(causes: Causes) -> StudyTable:
    parts = (causes.euler, causes.runge_kutta, causes.rounding, causes.ours)
    rows: list[Sequence[float | str]] = [
        [rate, lock_in, *(100 * float(part[place]) for part in parts)]
        for place, (rate, lock_in) in enumerate(causes.points)
    ]
    columns = (
        "W",
        "WL",
        "Euler, 20 kHz, %",
        "Runge-Kutta, 20 kHz, %",
        "ours, 2500 points of 8 bits (rms), %",
        "ours, %",
    )
    title = "What a solver with steps of 1/20 kHz leaves, and ours on the same records"
    return StudyTable("causes_other", title, columns, ("g", "g", "+.3f", "+.4f", ".3f", "+.0e"), rows)


def _experiment_table(experiment: ExperimentCauses) -> StudyTable:
    rows: list[Sequence[float | str]] = [
        [CAUSE_NAMES[cause.name], *(100 * float(v) for v in cause.rms), 100 * float(cause.largest[-1])]
        for cause in experiment.causes
    ]
    rows.append(["all, reading with Hann", *(100 * float(v) for v in experiment.together), math.nan])
    ours = experiment.ours
    rows.append([CAUSE_NAMES[ours.name], *(100 * float(v) for v in ours.rms), 100 * float(ours.largest[-1])])
    rates = [f"{over:g} WL, %" for over in experiment.over_lock_in]
    title = "The 6.8 % of the paper's experiment: each cause alone, rms, at several rates (WL = 0.01 deg/s)"
    columns = ("cause", *rates, f"largest at {experiment.over_lock_in[-1]:g} WL, %")
    return StudyTable("experiment", title, columns, ("s", *[".2f"] * (len(rates) + 1)), rows)


def _readings_table(readings: tuple[PeakReading, ...]) -> StudyTable:
    rows: list[Sequence[float | str]] = [(WINDOW_NAMES[r.window], 100 * r.largest, 100 * r.rms) for r in readings]
    title = "Reading A2/A1 from the two highest lines, the beat lying anywhere in its bin"
    return StudyTable(
        "peak_reading", title, ("window", "largest error, %", "rms error, %"), ("s", ".2f", ".2f"), rows
    )


def _text(cell: float | str, form: str) -> str:
    if isinstance(cell, str):
        return cell
    return "" if math.isnan(cell) else format(cell, form)
