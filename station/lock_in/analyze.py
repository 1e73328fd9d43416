"""Analyse again what was saved: runs of our store, and files that a Tektronix scope wrote."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis import Flag
from analysis.lock_in_run import Method
from analysis.lockin_equation import Relation
from instrument import read_waveform
from station.lock_in.evaluation import Evaluation
from station.lock_in.harmonics import harmonics_of
from station.lock_in.read import check_over_time, evaluate_run, evaluate_waveforms, saved_settings
from station.lock_in.result import record_documents, result_document
from station.runs.database import is_database
from station.runs.store import SavedRun, open_run
from station.settings.load import Settings


@dataclass(frozen=True)
class Choices:
    """What the user chose for the analysis; ``None``: as the run was taken, or as the settings say.

    Attributes
    ----------
    scale_factor : float or None
        Pulses per degree.
    input_rate : float or None
        Rate on the gyro's axis, deg/s.
    relation : {"exact", "paper-13", "paper-10"}
    known : Settings or None
        What is known of channel and bench now (``front_end``, ``budget``); ``None``: what a run was taken with.
    """

    scale_factor: float | None = None
    input_rate: float | None = None
    relation: Relation = "exact"
    known: Settings | None = None


@dataclass(frozen=True)
class Analyzed:
    """One path and what its records say.

    Attributes
    ----------
    path : Path
    run : SavedRun or None
        ``None`` for a file of the scope.
    evaluation : Evaluation
    """

    path: Path
    run: SavedRun | None
    evaluation: Evaluation

    def document(self) -> dict[str, Any]:
        """Return the combined result as plain JSON, with the harmonics of a single file."""
        document = result_document(self.evaluation, self.run)
        if self.run is None:
            harmonics = self.harmonics()
            document |= {"file": str(self.path), "harmonics": harmonics}
            if harmonics and document["beat_frequency_hz"] is None:
                document["beat_frequency_hz"] = harmonics[0]["frequency_hz"]
        return document

    def harmonics(self) -> list[dict[str, float]] | None:
        """Return the harmonics of a single file, also where they are none of a gyro; ``None`` without any."""
        if self.run is not None or int(self.evaluation.combined.flags) & int(Flag.NO_BEAT | Flag.CONSTANT):
            return None
        return harmonics_of(self.evaluation.waveforms[0])

    def record_documents(self) -> list[dict[str, Any]]:
        """Return one plain JSON object for each record."""
        return record_documents(self.evaluation, str(self.path) if self.run is not None else None)


def analyze_path(path: Path, choices: Choices, settings: Settings) -> Analyzed:
    """Analyse a saved run, a Tektronix CSV file or an ISF file.

    Parameters
    ----------
    path : Path
        File, or directory of a run.
    choices : Choices
    settings : Settings
        Gives the scale factor for a file that does not know it.

    Returns
    -------
    Analyzed

    Raises
    ------
    RunError, FileFormatError, OSError
        If it cannot be read.
    NoUsableSignal
        If the file holds no signal over time.
    """
    if is_database(path):
        run = open_run(path)
        scale_factor = choices.scale_factor or saved_settings(run).gyro.scale_factor_pulses_per_deg
        return Analyzed(path, run, evaluate_run(run, _method(choices, scale_factor), choices.known))
    waveform = read_waveform(path)
    check_over_time(waveform, str(path))
    scale_factor = choices.scale_factor or settings.gyro.scale_factor_pulses_per_deg
    evaluation = evaluate_waveforms([waveform], [str(path)], _method(choices, scale_factor))
    return Analyzed(path, None, evaluation)


def _method(choices: Choices, scale_factor: float) -> Method:
    return Method(scale_factor, choices.relation, choices.input_rate)
