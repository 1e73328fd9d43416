"""Files that an oscilloscope wrote, analysed without a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from analysis import Flag, fit_harmonics
from analysis.lock_in_run import Method
from instrument import Waveform
from station.errors import UsageError
from station.lock_in.found import LockInFound
from station.lock_in.knowledge import stated_of_files
from station.lock_in.presentation.documents import record_documents
from station.lock_in.read import evaluate_waveforms
from station.lock_in.records.pieces import about
from station.lock_in.result import result
from station.lock_in.settings import ask_scale_factor, load_settings
from station.results.as_json import plain
from station.results.limits import Tested, check_limits, verdict
from station.results.numbers import with_prefix
from station.results.parts import TextTable
from station.results.result import Result
from station.ring_laser.records import saved_waveform
from station.settings.toml_files import read_toml
from station.shell.evaluated import SCHEMA_VERSION, standing_document
from station.sources.batches import LeftOut
from station.sources.find import open_source
from station.sources.over_time import check_over_time
from station.sources.source import Source

_HARMONICS = 5

SIDE_FILE = "gyrolock.toml"
"""Settings beside the files of a memory card."""


@dataclass(frozen=True)
class AnalyzedFiles:
    """One file, or several as records at one rate, and what they say."""

    paths: tuple[Path, ...]
    found: LockInFound
    harmonics: list[dict[str, float]] | None
    result: Result
    left_out: tuple[LeftOut, ...] = ()
    about: tuple[dict[str, str | None], ...] = ()
    tested: tuple[Tested, ...] = ()

    @property
    def verdict(self) -> str | None:
        """``"PASS"``, ``"FAIL"`` or, without limits, ``None``."""
        return verdict(self.tested)

    def document(self) -> dict[str, Any]:
        """Return the result as plain JSON; of one file with its harmonics."""
        schema = {"name": "gyrolock files", "version": SCHEMA_VERSION}
        document = {"schema": schema, **self.result.document, "flags": self.result.flags, "run": None}
        document |= standing_document(self.result)
        document |= {"limits": [one.as_json() for one in self.tested], "verdict": self.verdict}
        if len(self.paths) > 1:
            missing = [{"source": o.source, "record": o.record, "reason": o.reason} for o in self.left_out]
            scopes = [dict(one) for one in dict.fromkeys(tuple(about.items()) for about in self.about)]
            return dict(plain(document | {"files": self.paths, "left_out": missing, "taken_with": scopes}))
        document |= {"file": self.paths[0], "harmonics": self.harmonics}
        if self.harmonics and not np.isfinite(document["beat_frequency_hz"]):
            document["beat_frequency_hz"] = self.harmonics[0]["frequency_hz"]
        return dict(plain(document))

    def taken_with(self) -> list[str]:
        """Say what the files say of the oscilloscopes that wrote them, one line each."""
        told = ([f"{name} {value}" for name, value in about.items() if value] for about in self.about)
        return [f"oscilloscope   {', '.join(one)}" for one in dict.fromkeys(map(tuple, told)) if one]

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield one plain JSON object for each record."""
        return (dict(plain(row)) for row in record_documents(self.found, "file"))


def analyze_file(source: Path | Source, config: Path | None, choices: Mapping[str, Any]) -> AnalyzedFiles:
    """Analyse a file of an oscilloscope."""
    opened = open_source(source)
    (record,) = opened.records()
    waveform = saved_waveform(record, opened.path)
    chosen = {name: value for name, value in choices.items() if value is not None}
    if "scale_factor" not in chosen:
        chosen["scale_factor"] = scale_factor_of_files(config, [source])
    analyzed = analyze_waveforms([waveform], [Path(opened.name)], Method(**chosen), config)
    return replace(analyzed, about=(about(opened),))


def tested_by(config: Path | None, said: Result) -> tuple[Tested, ...]:
    """Test a result of files against the limits that a settings file states."""
    settings = stated_of_files(config)
    return () if settings is None else check_limits(said.measured, settings.limits.model_dump())


def scale_factor_of_files(config: Path | None, files: Sequence[Path | Source] = ()) -> float:
    """Return the scale factor of the gyro whose records are files.

    From a settings file, from ``gyrolock.toml`` beside the files or in the folder above, or asked for once. What
    the shipped settings say of their simulated gyro is not true of another one.
    """
    if config is not None and (stated := _stated(config)) is not None:
        return stated
    folders = dict.fromkeys(file.parent for file in files if isinstance(file, Path))
    beside = {folder: _beside(folder) for folder in folders}
    if len(set(beside.values())) > 1:
        first, second = [f"{folder} has {one or 'none'}" for folder, one in beside.items()][:2]
        raise UsageError(f"mixed scale factors: {first}, {second}: give --scale-factor")
    found = next(iter(beside.values()), None)
    return _asked_scale_factor() if found is None else found


def _stated(config: Path) -> float | None:
    """The scale factor that a settings file states itself."""
    settings = load_settings(config)
    if "scale_factor_pulses_per_deg" in read_toml(config).get("gyro", {}):
        return settings.gyro.scale_factor_pulses_per_deg
    return None


def _beside(folder: Path) -> float | None:
    for place in (folder, folder.parent):
        if (place / SIDE_FILE).is_file():
            return _stated(place / SIDE_FILE)
    return None


@cache
def _asked_scale_factor() -> float:
    return ask_scale_factor()


def analyze_waveforms(
    waveforms: Sequence[Waveform], paths: Sequence[Path], method: Method, config: Path | None = None
) -> AnalyzedFiles:
    """Analyse what was read from files; NoUsableSignal if one holds no signal over time."""
    for waveform, path in zip(waveforms, paths, strict=True):
        check_over_time(waveform, str(path))
    found = evaluate_waveforms(waveforms, [str(path) for path in paths], method, config)
    said, harmonics = result(found), None
    if len(waveforms) == 1 and not int(found.combined.flags) & int(Flag.NO_BEAT | Flag.CONSTANT):
        harmonics = harmonics_of(waveforms[0])
    tables = (*said.tables, _harmonics_table(harmonics)) if harmonics else said.tables
    shown = Result(**{**vars(said), "tables": tables})
    return AnalyzedFiles(tuple(paths), found, harmonics, shown, tested=tested_by(config, said))


def harmonics_of(waveform: Waveform) -> list[dict[str, float]] | None:
    """Return the harmonics of a record, also where they are none of a gyro; ``None`` if it has none."""
    if np.nanmax(waveform.volts) == np.nanmin(waveform.volts):
        return None
    fit = fit_harmonics(waveform.volts, waveform.sample_interval, harmonics=_HARMONICS, nan_policy="omit")
    if not np.isfinite(fit.frequency):
        return None
    return [
        {
            "order": order,
            "frequency_hz": order * float(fit.frequency),
            "amplitude_v": float(np.abs(amplitude)),
            "phase_rad": float(np.angle(amplitude)),
        }
        for order, amplitude in enumerate(fit.amplitudes, start=1)
    ]


def _harmonics_table(harmonics: list[dict[str, float]]) -> TextTable:
    first = harmonics[0]["amplitude_v"]
    rows = tuple(
        (
            f"{one['order']}",
            with_prefix(one["frequency_hz"], "Hz"),
            with_prefix(one["amplitude_v"], "V"),
            f"{one['amplitude_v'] / first:.4f}" if first > 0 else "",
        )
        for one in harmonics
    )
    return TextTable(("harmonic", "frequency", "amplitude", "of the first"), rows)
