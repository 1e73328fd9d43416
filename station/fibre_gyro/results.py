"""What one run gives: evaluation, JSON document, sentences and verdict, whichever of the tests it was."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from station.errors import NoUsableSignal, RunError
from station.fibre_gyro import documents, words
from station.fibre_gyro.eps import measurement as eps
from station.fibre_gyro.eps.measurement import EpsEvaluation
from station.fibre_gyro.figures import measurement as figures
from station.fibre_gyro.figures.measurement import FiguresEvaluation
from station.fibre_gyro.limits import Tested, check_limits, verdict
from station.fibre_gyro.selfcal import measurement as selfcal
from station.fibre_gyro.selfcal.measurement import SelfcalEvaluation
from station.fibre_gyro.settings import FogSettings, fog_settings_from
from station.fibre_gyro.store import FogRun
from station.fibre_gyro.table import measurement as table
from station.fibre_gyro.table.measurement import TableEvaluation
from station.fibre_gyro.witness import result as witness_words
from station.fibre_gyro.witness import take as staircase_records
from station.fibre_gyro.witness.measurement import WitnessEvaluation, evaluate_witness
from station.results.numbers import with_uncertainty
from station.runs.store import SavedRun

Evaluation = TableEvaluation | SelfcalEvaluation | EpsEvaluation | FiguresEvaluation | WitnessEvaluation
COMMANDS = (table.PURPOSE, selfcal.PURPOSE, eps.PURPOSE, figures.PURPOSE)


@dataclass(frozen=True)
class FogResult:
    """Result of a run.

    Attributes
    ----------
    command : {"table", "selfcal", "eps", "figures", "witness"}
    settings : FogSettings
    evaluation : TableEvaluation, SelfcalEvaluation, EpsEvaluation, FiguresEvaluation or WitnessEvaluation
    table : TableEvaluation or None
        Of the rate-table segments in a self-calibration's run.
    document : dict
        Plain JSON, without run, report and error.
    value : str
        The result in large letters.
    lines : tuple of str
        Below it.
    sentences : tuple of str
        What the result means.
    flags : tuple of str
        What to watch; what was left out.
    tested : tuple of Tested
    """

    command: str
    settings: FogSettings
    evaluation: Evaluation
    table: TableEvaluation | None
    document: dict[str, Any]
    value: str
    lines: tuple[str, ...]
    sentences: tuple[str, ...]
    flags: tuple[str, ...]
    tested: tuple[Tested, ...]

    @property
    def verdict(self) -> str | None:
        """``"PASS"``, ``"FAIL"`` or, without limits, ``None``."""
        return verdict(self.tested)


def evaluate_fog_run(run: FogRun, limits_of: FogSettings | None = None) -> FogResult:
    """Evaluate a run with the settings that are saved with it.

    Parameters
    ----------
    run : FogRun
    limits_of : FogSettings, optional
        Limits of these settings instead of the saved ones.

    Raises
    ------
    NoUsableSignal
        It gives no result.
    RunError
        It is not the run of one of the tests.
    """
    command = run.facts.get("command")
    if command not in COMMANDS or "settings" not in run.facts:
        raise RunError(f"{run.path}: is not a run of {', '.join(COMMANDS)}")
    settings = fog_settings_from(run.facts["settings"], str(run.path))
    if limits_of is not None:
        settings = settings.model_copy(update={"limits": limits_of.limits})
    of_table = table.evaluate_table(run, settings) if run.taken_for(table.PURPOSE) else None
    makers = {
        table.PURPOSE: _of_table,
        selfcal.PURPOSE: _of_selfcal,
        eps.PURPOSE: _of_eps,
        figures.PURPOSE: _of_figures,
    }
    made = makers[command](run, settings, of_table)
    return _with_common(made, run.facts)


def evaluate_witness_run(run: SavedRun, known: FogSettings | None = None) -> FogResult:
    """Evaluate a run of the oscilloscope on the modulator with the settings that are saved with it.

    Parameters
    ----------
    run : SavedRun
    known : FogSettings, optional
        Limits, half-wave voltage and the oscilloscope's uncertainties of these settings instead of the saved ones.

    Raises
    ------
    NoUsableSignal
        It gives no result.
    RunError
        It is not such a run.
    """
    if run.facts.get("command") != staircase_records.PURPOSE:
        raise RunError(f"{run.path}: is not a run of `gyrolock fog witness`")
    settings = fog_settings_from(run.facts["settings"], str(run.path))
    if known is not None:
        names = ("half_wave_v", "half_wave_u_v", "gain_u", "time_base_u")
        updated = settings.witness.model_copy(update={name: getattr(known.witness, name) for name in names})
        settings = settings.model_copy(update={"limits": known.limits, "witness": updated})
    return _with_common(_of_witness(run, settings), run.facts)


def _with_common(result: FogResult, facts: dict[str, Any]) -> FogResult:
    """Add what every document has."""
    common: dict[str, Any] = {"command": result.command, "gyro": result.settings.gyro.name}
    common |= {"simulated": facts["simulated"]}
    tail: dict[str, Any] = {
        "flags": list(result.flags),
        "limits": [one.as_json() for one in result.tested],
        "verdict": result.verdict,
    }
    if "truth" in facts:
        tail["truth"] = facts["truth"]
    return FogResult(**{**vars(result), "document": {**common, **result.document, **tail}})


def _of_table(run: FogRun, settings: FogSettings, of_table: TableEvaluation | None) -> FogResult:
    if of_table is None or not of_table.axes:
        reasons = "; ".join(one.sentence for one in of_table.left_out) if of_table else ""
        raise NoUsableSignal(f"no axis has runs in both senses{': ' + reasons if reasons else ''}")
    document = documents.table_document(of_table, settings)
    values: dict[str, float] = {}
    for result, axis in zip(of_table.axes, document["axes"], strict=True):
        for name in ("nominal_difference_ppm", "scale_factor_u_ppm", "scatter_ppm"):
            values[f"{name} of {result.axis}"] = _or_nan(axis[name])
    fits = [(one.axis, one.fit) for one in of_table.axes]
    value = "; ".join(
        f"K({axis}) = {with_uncertainty(fit.scale_factor, fit.scale_factor_u)}" for axis, fit in fits
    )
    lines = [f"counts per deg/s; by design {settings.nominal_scale_factor:.6f}."]
    lines.append(f"From {sum(len(one.keys) for one in of_table.axes)} runs over whole turns, by least squares.")
    sentences = [words.even_part_sentence(settings)]
    flags = words.table_sentences(of_table, settings)
    return _result(table.PURPOSE, settings, of_table, of_table, document, value, lines, sentences, flags, values)


def _of_selfcal(run: FogRun, settings: FogSettings, of_table: TableEvaluation | None) -> FogResult:
    found = selfcal.evaluate_selfcal(run, settings, of_table)
    document = documents.selfcal_document(found, settings)
    compared = found.comparison
    values = {"self_minus_numbers_ppm": compared.against_numbers_ppm}
    if found.reference is not None:
        values["self_minus_table_ppm"] = compared.difference_ppm
    value = f"K_self = {with_uncertainty(found.fit.slope, found.fit.slope_u)} counts per deg/s"
    against = "K of the table" if found.reference else "K by design"
    lines = [
        f"Against {against}: {words.ppm(compared.difference_ppm, compared.difference_u_ppm)}.",
        "Against the slope of the injected numbers: "
        f"{words.ppm(compared.against_numbers_ppm, compared.against_numbers_u_ppm)}.",
    ]
    sentences = words.selfcal_sentences(found, settings)
    flags = words.selfcal_flags(found) + (words.table_sentences(of_table, settings) if of_table else [])
    return _result(selfcal.PURPOSE, settings, found, of_table, document, value, lines, sentences, flags, values)


def _of_eps(run: FogRun, settings: FogSettings, of_table: TableEvaluation | None) -> FogResult:
    found = eps.evaluate_eps(run, settings)
    document = documents.eps_document(found)
    result = found.result
    value = f"eps = {words.ppm(1e6 * result.two_pi_error, 1e6 * result.two_pi_error_u)}"
    lines = [f"The converter's range spans 2π (1 + eps); from {len(found.keys)} injected steps in open loop."]
    values = {"two_pi_error_ppm": 1e6 * result.two_pi_error}
    sentences = words.eps_sentences(found, settings)
    flags = words.eps_flags(found)
    return _result(eps.PURPOSE, settings, found, of_table, document, value, lines, sentences, flags, values)


def _of_figures(run: FogRun, settings: FogSettings, of_table: TableEvaluation | None) -> FogResult:
    found = figures.evaluate_figures(run, settings)
    document = documents.figures_document(found)
    value = f"Nonlinearity {found.nonlinearity_ppm:.3g} ppm of full scale"
    lines = [
        f"Asymmetry {_ppm(found.asymmetry_ppm)}, repeatability {_ppm(found.repeatability_ppm)} "
        f"({len(found.runs)} runs), temperature coefficient {_ppm(found.temperature_coefficient_ppm)}/K.",
        f"K = {with_uncertainty(found.scale_factor, found.scale_factor_u)} counts per deg/s.",
    ]
    names = ("nonlinearity_ppm", "nonlinearity_of_point_ppm", "asymmetry_ppm", "repeatability_ppm")
    values = {name: _or_nan(document[name]) for name in (*names, "temperature_coefficient_ppm")}
    sentences, flags = words.figures_sentences(found), words.figures_flags(found)
    return _result(figures.PURPOSE, settings, found, of_table, document, value, lines, sentences, flags, values)


def _of_witness(run: SavedRun, settings: FogSettings) -> FogResult:
    found = evaluate_witness(run, settings)
    document = documents.witness_document(found, settings)
    values = {
        "witness_two_pi_error_ppm": 1e6 * found.two_pi_error.value,
        "witness_step_time_ppm": found.step_time_ppm.value,
    }
    value, lines = witness_words.headline(found)
    injected = run.facts.get("injected", {}).get("step_codes")
    sentences = witness_words.sentences(found, settings, injected)
    flags = witness_words.flags(found, settings)
    name = staircase_records.PURPOSE
    return _result(name, settings, found, None, document, value, lines, sentences, flags, values)


def _result(
    command: str,
    settings: FogSettings,
    evaluation: Evaluation,
    of_table: TableEvaluation | None,
    document: dict[str, Any],
    value: str,
    lines: list[str],
    sentences: list[str],
    flags: list[str],
    values: dict[str, float],
) -> FogResult:
    tested = check_limits(values, settings.limits)
    said, watched = tuple(sentences), tuple(flags)
    return FogResult(command, settings, evaluation, of_table, document, value, tuple(lines), said, watched, tested)


def _ppm(value: float) -> str:
    return f"{value:.3g} ppm" if value == value else "none"


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value
