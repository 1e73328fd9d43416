"""The result as a JSON document, with the names that programs rely on."""

from __future__ import annotations

import math
from typing import Any

from analysis import flag_names
from analysis.budget import Budget
from analysis.lock_in_run import QuadratureResult
from station.lock_in.evaluation import Evaluation, describe_method
from station.lock_in.rates_document import several_rates_document
from station.runs.store import SavedRun

# name in JSON: field of the estimate
_FIELDS = {
    "lock_in_rate_dps": "lock_in_rate",
    "lock_in_rate_u_dps": "lock_in_rate_u",
    "lock_in_rate_low_95_dps": "lock_in_rate_low_95",
    "lock_in_rate_high_95_dps": "lock_in_rate_high_95",
    "input_rate_dps": "input_rate",
    "beat_frequency_hz": "beat_frequency",
    "beat_frequency_u_hz": "beat_frequency_u",
    "ratio": "ratio",
    "ratio_u": "ratio_u",
    "backscatter_phase_rad": "backscatter_phase",
    "amplitude_v": "amplitude",
    "noise_rms_v": "noise_rms",
}


def result_document(evaluation: Evaluation, run: SavedRun | None = None) -> dict[str, Any]:
    """Return the combined result as plain JSON.

    Parameters
    ----------
    evaluation : Evaluation
    run : SavedRun, optional
        Where the records are saved.

    Returns
    -------
    dict
        Units stand in the names; uncertainties are standard ones unless the name says 95. A number that
        cannot be given is ``None``.
    """
    combined = evaluation.combined
    document: dict[str, Any] = {name: _number(getattr(combined, field)) for name, field in _FIELDS.items()}
    document |= {
        "records": len(evaluation.waveforms) + len(evaluation.damaged),
        "records_rejected": evaluation.records_rejected,
        "method": evaluation.method_text,
        "noise_model": combined.noise_model,
        "flags": evaluation.flags,
        "scale_factor_pulses_per_deg": evaluation.method.scale_factor,
        "run": str(run.path) if run is not None else None,
    }
    if evaluation.tilt is not None:
        document |= {"tilt_deg": evaluation.tilt.tilt_deg, "tilt_u_deg": evaluation.tilt.tilt_u_deg}
    if (check := evaluation.table_check) is not None:
        document["table_check"] = {
            "lock_in_rate_dps": check.lock_in_rate,
            "lock_in_rate_u_dps": check.lock_in_rate_u,
            "input_rate_dps": check.input_rate,
            "beat_over_table": check.beat_over_table,
        }
    if evaluation.several is not None:
        document["several_rates"] = several_rates_document(evaluation.several, evaluation.without_beat)
    if evaluation.quadratures is not None:
        document["quadratures"] = quadratures_document(evaluation.quadratures)
    if evaluation.budget is not None:
        document["budget"] = budget_document(evaluation.budget)
    if evaluation.truth is not None:
        document["truth"] = evaluation.truth
    return document


def budget_document(budget: Budget) -> dict[str, Any]:
    """Return a budget as plain JSON; null stands for infinitely many degrees of freedom."""
    return {
        "reference": budget.reference,
        "lock_in_rate_dps": budget.lock_in_rate,
        "combined_u_dps": budget.combined_u,
        "combined_u_percent": 100 * budget.relative_u,
        "effective_degrees_of_freedom": _number(budget.effective_degrees_of_freedom),
        "coverage_factor": budget.coverage_factor,
        "expanded_u_95_dps": budget.expanded_u_95,
        "inputs": [
            {
                "name": line.name,
                "quantity": line.quantity,
                "unit": line.unit,
                "value": _number(line.value),
                "u": line.u,
                "distribution": line.distribution,
                "sensitivity_dps_per_unit": line.sensitivity,
                "contribution_dps": line.contribution,
                "share_of_variance": budget.share(line),
                "degrees_of_freedom": _number(line.degrees_of_freedom),
                "note": line.note,
            }
            for line in budget.inputs
        ],
        "not_stated": list(budget.unstated),
    }


def quadratures_document(found: QuadratureResult) -> dict[str, Any]:
    """Return what sine and cosine channel say of each other as plain JSON.

    Parameters
    ----------
    found : QuadratureResult

    Returns
    -------
    dict
    """
    return {
        "records": found.records,
        "sense": found.sense,
        "gain_ratio": found.gain_ratio,
        "gain_ratio_u": found.gain_ratio_u,
        "phase_error_rad": found.phase_error,
        "phase_error_u_rad": found.phase_error_u,
        "distortion": list(found.distortion),
        "distortion_u": list(found.distortion_u),
        "images": list(found.images),
        "sine_alone_dps": _number(found.sine_alone),
        "cosine_alone_dps": _number(found.cosine_alone),
        "flags": list(found.flags),
    }


def record_documents(evaluation: Evaluation, source: str | None = None) -> list[dict[str, Any]]:
    """Return one JSON object for each record, with the names of :func:`result_document`.

    Parameters
    ----------
    evaluation : Evaluation
    source : str, optional
        Path of the run, for records of a run.

    Returns
    -------
    list of dict
    """
    documents, method = [], describe_method(evaluation.method)
    for row, name in enumerate(evaluation.names):
        document: dict[str, Any] = {"run": source, "record": name} if source else {"file": name}
        document |= {key: _number(getattr(evaluation.each, field)[row]) for key, field in _FIELDS.items()}
        document |= {"method": method, "flags": flag_names(int(evaluation.each.flags[row]))}
        documents.append(document)
    return documents


def _number(value: object) -> float | None:
    number = float(value)  # type: ignore[arg-type]  # a zero-dimensional array or a scalar
    return number if math.isfinite(number) else None
