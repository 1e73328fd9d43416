"""The lock-in rate as numbers and sentences."""

from __future__ import annotations

import math

from station.lock_in.found import LockInFound
from station.lock_in.presentation.budget_table import budget_sentences, doubt_sentence
from station.lock_in.presentation.documents import result_document
from station.lock_in.presentation.rates_sentences import separated_words
from station.lock_in.presentation.sentences import (
    flag_sentence,
    flag_sentences,
    interval_words,
    lock_in_words,
    no_result_words,
    noise_words,
    quadrature_sentences,
    rates_sentences,
    span_words,
    truth_is_missed,
    truth_sentence,
)
from station.lock_in.presentation.table_sentences import beat_over_table_words, by_table_words, table_sentences
from station.lock_in.presentation.tables import rates_table, records_table
from station.lock_in.settings import LimitSettings, Settings
from station.results.numbers import with_prefix, with_uncertainty
from station.results.parts import Rows, TextTable
from station.results.result import Measured, Result
from station.runs.store import SavedRun

_RECORDS_SHOWN = 40


def result(found: LockInFound, run: SavedRun | None = None, settings: Settings | None = None) -> Result:
    """Put into numbers and sentences what was found; also for records that come from files, without a run."""
    document = result_document(found)
    budget = [] if found.budget is None else budget_sentences(found.budget)
    tables: tuple[TextTable, ...] = ()
    if found.several is not None:
        tables = (rates_table(found.several),)
    elif len(found.names) > 1:
        tables = (records_table(found, _RECORDS_SHOWN),)
    return Result(
        name="lock-in rate",
        value=" = ".join(lock_in_words(found)) if found.usable else "none",
        document=document,
        measured=tuple(Measured(name, _number(document.get(name))) for name in LimitSettings.model_fields),
        lines=tuple(_lines(found)),
        summary=_summary(found),
        sentences=(*rates_sentences(found), *table_sentences(found), *quadrature_sentences(found), *budget),
        to_watch=tuple(flag_sentences(found)),
        flags=tuple(found.flags),
        tables=tables,
        problem="" if found.usable else no_result_words(found),
        truth=_truth(found),
        doubts=tuple(_doubts(found)),
        failures=tuple(_failures(found)),
    )


_ANSWERED = {"coloured_noise", "rate_wander"}
"""Flags of what the fit has taken into account: its uncertainty holds it."""

_FAILING = {"table_mismatch", "scale_factor_mismatch"}
"""Flags of checks that say that something does not fit together."""


def _failing(found: LockInFound) -> set[str]:
    """The same, but for a difference that lies within what the budget counts: that is a doubt."""
    explained = found.table_check is not None and not found.table_check.unexplained
    return _FAILING - {"table_mismatch"} if explained else _FAILING


def _doubts(found: LockInFound) -> list[str]:
    """What rules the result: a flag that the uncertainty does not answer, or something that nobody knows."""
    said = [flag_sentence(found, name) for name in found.flags if name not in _ANSWERED | _failing(found)]
    if found.budget is not None and (doubt := doubt_sentence(found.budget)):
        said.append(doubt)
    return said


def _failures(found: LockInFound) -> list[str]:
    said = [flag_sentence(found, name) for name in found.flags if name in _failing(found)]
    return [*said, truth_sentence(found)] if truth_is_missed(found) else said


def _number(value: object) -> float:
    return math.nan if value is None else float(value)  # type: ignore[arg-type]  # an array of no dimensions, or a number


def _lines(found: LockInFound) -> list[str]:
    """Below the value in the report."""
    if not found.usable:
        return [no_result_words(found)]
    counted = len(found.waveforms) - int(found.combined.records_rejected)
    at = f" at {len(found.several.groups)} rates" if found.several is not None else ""
    lines = [
        f"95 % interval {interval_words(found)}, every input counted, from {counted} "
        f"record{'s' if counted != 1 else ''}{at}; the noise of the records alone: {noise_words(found)}."
    ]
    missed = truth_is_missed(found)  # then it is said as what failed
    return lines if missed or found.truth is None else [*lines, truth_sentence(found)]


def _truth(found: LockInFound) -> str:
    return f"the truth is {found.truth['lock_in_rate_dps']:.6g} deg/s" if found.truth is not None else ""


def _summary(found: LockInFound) -> Rows:
    """Below the value on the terminal."""
    combined, rows = found.combined, []
    if found.usable:
        rows.append(("95 % interval", f"{interval_words(found)}, every input counted"))
        rows.append(("noise alone", noise_words(found)))
    fit = None if found.several is None else found.several.by_beat
    if fit is not None and (said := separated_words(fit)):
        rows.append(("besides lock-in", said))
    rows += _rate_rows(found)
    if found.tilt is not None:
        rows.append(("tilt of the axis", with_uncertainty(found.tilt.tilt_deg, found.tilt.tilt_u_deg, "deg")))
    if (check := found.table_check) is not None:
        said = f"{by_table_words(check)}, beat over table {beat_over_table_words(check)}"
        rows.append(("by the table's rate", said))
        rows += [
            (f"K by the {one.by}", with_uncertainty(one.scale_factor, one.scale_factor_u, "pulses/deg"))
            for one in check.scale_factors
        ]
    if found.several is not None and (other := found.several.by_frequency) is not None:
        by_frequency = with_uncertainty(other.lock_in_rate, other.lock_in_rate_u, "deg/s")
        rows.append(("by the frequencies", f"{by_frequency}, beat frequency against rate, without harmonics"))
    if math.isfinite(combined.noise_rms):
        rows.append(("noise", f"{with_prefix(float(combined.noise_rms), 'V')} rms; {combined.noise_model}"))
    rows.append(("scale factor", f"{found.method.scale_factor:.10g} pulses/deg"))
    rows.append(("method", found.method_text))
    rows.append(("records", f"{len(found.names)}, left out {found.records_rejected}"))
    return rows


def _rate_rows(found: LockInFound) -> Rows:
    """Ratio, beat and rate; of several rates where they go from and to."""
    if found.several is not None:
        each = [group.combined for group in found.several.groups]
        return [
            ("r = A2/A1", f"{span_words(float(one.ratio) for one in each)} at {len(each)} rates, see the table"),
            ("beat", span_words((float(one.beat_frequency) for one in each), "Hz")),
            ("rate on the axis", span_words((group.input_rate for group in found.several.groups), "deg/s")),
        ]
    combined, rows = found.combined, []
    if found.usable:
        rows.append(("r = A2/A1", with_uncertainty(float(combined.ratio), float(combined.ratio_u))))
    if math.isfinite(combined.beat_frequency):
        beat = with_uncertainty(float(combined.beat_frequency), float(combined.beat_frequency_u), "Hz")
        rows.append(("beat", beat))
    if math.isfinite(combined.input_rate):
        rows.append(("rate on the axis", f"{float(combined.input_rate):.6f} deg/s"))
    return rows
