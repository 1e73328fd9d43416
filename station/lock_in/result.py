"""The lock-in rate as numbers, tables and JSON, with its budget."""

import math
from typing import Any

import numpy as np

from analysis import Flag, flag_names
from analysis.budget import Budget
from analysis.lock_in_run import SeveralRates
from analysis.single_beams import BeamsFit
from station.lock_in.evaluate import LockInEvaluation
from station.lock_in.messages import (
    ALIAS,
    beams_sentences,
    beat_over_table_words,
    by_table_words,
    describe_frequencies,
    describe_rates,
    flag_sentence,
    flag_sentences,
    interval_words,
    lock_in_words,
    no_result_words,
    noise_words,
    quadrature_sentences,
    rates_sentences,
    remedy_sentence,
    separated_words,
    short_remedy,
    table_sentences,
    truth_is_missed,
    truth_sentence,
)
from station.lock_in.quantities import QUANTITIES, result_document
from station.lock_in.settings import Settings
from station.results.numbers import LOCK_IN_RATE
from station.results.quantity import within
from station.results.result import FactTable, Result, Rows, TextTable, picked, with_prefix, with_uncertainty
from station.runs.store import SavedRun

_RECORDS_SHOWN = 40


def result(found: LockInEvaluation, run: SavedRun | None = None, settings: Settings | None = None) -> Result:
    """Put into numbers and sentences what was found; also for records that come from files, without a run."""
    document = _document(found)
    budget = [] if found.budget is None else budget_sentences(found.budget)
    tables: tuple[TextTable, ...] = ()
    # of a run the autoset has looked at faster time bases
    alone = run is None and found.usable and found.several is None and found.table_check is None
    alias = (ALIAS,) if alone and found.method.input_rate is None else ()
    failures = tuple(flag_sentence(found, name) for name in found.flags if name in _failing(found))
    if found.several is not None:
        tables = (rates_table(found.several),)
    elif len(found.names) > 1:
        tables = (records_table(found, _RECORDS_SHOWN),)
    moved, moved_words = _beat_moved(found)
    answered = _ANSWERED - {"beat_wanders"} if moved > _MOVED_MOST else _ANSWERED
    worst_first = sorted(found.flags, key=lambda name: name != "records_differ")
    said = [flag_sentence(found, name) for name in worst_first if name not in answered | _failing(found)]
    if found.budget is not None and (doubt := doubt_sentence(found.budget)):
        said.append(doubt)
    return Result(
        name="lock-in rate",
        value=" = ".join(lock_in_words(found)) if found.usable else "none",
        document=document,
        quantities=QUANTITIES,
        lines=tuple(_lines(found)),
        summary=_summary(found),
        brief=_brief(found, moved_words),
        sentences=(
            *rates_sentences(found),
            *([] if found.several is None else beams_sentences(found.several)),
            *table_sentences(found),
            *quadrature_sentences(found),
            *alias,
            *budget,
        ),
        to_watch=tuple(flag_sentences(found)),
        flags=tuple(found.flags),
        tables=tables,
        problem="" if found.usable else no_result_words(found),
        truth=f"the truth is {found.truth[LOCK_IN_RATE.key()]:.6g} deg/s" if found.truth is not None else "",
        doubts=tuple(said),
        failures=(*failures, truth_sentence(found)) if truth_is_missed(found) else failures,
    )


def _document(found: LockInEvaluation) -> dict[str, Any]:
    """The numbers, what is said of each fit, and the budget."""
    made = result_document(found)
    if found.table_check is not None:
        made["table_check"]["sentences"] = table_sentences(found)
    several = found.several
    fits = {} if several is None else {"by_beat": several.by_beat, "by_table": several.by_table}
    for name, fit in fits.items():
        if fit is not None:
            with_beams = name == "by_beat" and several is not None and several.beams is not None
            made["several_rates"][name]["sentences"] = describe_rates(fit, beams=with_beams)
    if several is not None and several.by_frequency is not None:
        made["several_rates"]["by_frequency"]["sentences"] = describe_frequencies(several.by_frequency)
    if found.budget is not None:
        made["budget"] = budget_document(found.budget)
    return made


_ANSWERED = {"coloured_noise", "rate_wander", "phase_turns", "beat_wanders", "copy"}
"""Flags of what the fit has taken into account, or of what no record's own reference minds."""

_MOVED_MOST = 0.01  # share by which the beat of one setting may move before its result is doubtful

_FAILING = {"table_mismatch", "scale_factor_mismatch"}
"""Flags of checks that say that something does not fit together."""


def _failing(found: LockInEvaluation) -> set[str]:
    """The same, but for a difference that lies within what the budget counts: that is a doubt."""
    explained = found.table_check is not None and not found.table_check.unexplained
    return _FAILING - {"table_mismatch"} if explained else _FAILING


def _lines(found: LockInEvaluation) -> list[str]:
    """Below the value in the report."""
    if not found.usable:
        return [no_result_words(found)]
    counted = len(found.waveforms) - int(found.combined.records_rejected)
    at = f" at {len(found.several.groups)} rates" if found.several is not None else ""
    lines = [
        f"95 % interval {interval_words(found)}, all uncertainties included, from {counted} "
        f"record{'s' if counted != 1 else ''}{at}; the noise of the records alone: {noise_words(found)}."
    ]
    missed = truth_is_missed(found)  # then it is said as what failed
    return lines if missed or found.truth is None else [*lines, truth_sentence(found)]


def _beat_moved(found: LockInEvaluation) -> tuple[float, str]:
    """By what share the beat of one setting has moved, and in words; after which record, where it is a step."""
    if "beat_wanders" not in found.flags:
        return 0.0, ""
    wandered: list[tuple[float, str]] = []
    groups = () if found.several is None else found.several.groups
    settings = [group.rows for group in groups if Flag.BEAT_WANDERS & int(group.combined.flags)]
    for rows in settings or [np.arange(len(found.names))]:
        rows = rows[found.each.usable[rows]]
        beats = found.beats(rows)
        share, steps = float(np.ptp(beats) / beats.mean()), np.abs(np.diff(beats))
        after = f" after record {found.names[rows[steps.argmax()]]}" if 2 * steps.max() > np.ptp(beats) else ""
        moved = "BEAT MOVED" if share > _MOVED_MOST else "beat moved"
        wandered.append((share, f"{moved} {100 * share:.2g} %{after}"))
    return max(wandered)


def _brief(found: LockInEvaluation, moved: str) -> Rows:
    """The value, what was removed, what was checked, records, and what would help most: a line each."""
    rows: list[tuple[str, str]] = []
    if found.usable:
        rate, (low, high) = found.lock_in_rate, found.interval_95
        hourly = within(3600 * rate, 3600 * low, 3600 * high, "deg/h")
        rows.append(("lock-in rate", f"{within(rate, low, high, 'deg/s')} = {hourly} (95 %)"))
    several, check = found.several, found.table_check
    fit = None if several is None else several.by_beat
    if fit is not None and (said := separated_words(fit)):
        rows.append(("removed", said.removesuffix(": found and removed")))
    checks = [moved] if moved else []
    if check is not None:
        checks.append("beat and table DIFFER" if "table_mismatch" in found.flags else "beat and table agree")
        other = "DIFFERS" if "scale_factor_mismatch" in found.flags else "agrees"
        for one in check.scale_factors:
            checks.append(f"K by the {one.by} {with_uncertainty(one.scale_factor, one.scale_factor_u)} {other}")
    if several is not None and (frequencies := several.by_frequency) is not None:
        value = with_uncertainty(frequencies.lock_in_rate, frequencies.lock_in_rate_u)
        checks.append(f"without harmonics {value}")
    if checks:
        rows.append(("checks", "; ".join(checks)))
    if several is not None and (beams := several.beams or several.beams_problem):
        fits = "DO NOT FIT the beat" if "misfit" in found.flags else "fit the beat, and settle its phase"
        rows.append(("single beams", f"not used: {beams}" if isinstance(beams, str) else fits))
    total, combined = len(found.waveforms) + len(found.damaged), found.combined
    records = [f"{total - found.records_rejected} of {total} used"]
    if several is not None:
        senses = "both senses" if len({group.input_rate > 0 for group in several.groups}) > 1 else "one sense"
        records.append(f"{len(several.groups)} rates, {senses}")
    elif math.isfinite(combined.beat_frequency):
        u = float(combined.beat_frequency_u)
        records.append(f"beat {with_uncertainty(float(combined.beat_frequency), u, 'Hz')}")
    if moving := int(np.count_nonzero(found.each.flags & int(Flag.RATE_WANDER))):
        records.append(f"the rate moved in {moving}")
    records.append(f"K = {found.method.scale_factor:.10g} pulses/deg")
    rows.append(("records", ", ".join(records)))
    if found.budget is not None and (remedy := short_remedy(found.budget)):
        rows.append(("improve", remedy))
    return rows


def _summary(found: LockInEvaluation) -> Rows:
    """Below the value on the terminal."""
    combined, rows = found.combined, []
    if found.usable:
        rows.append(("95 % interval", f"{interval_words(found)}, all uncertainties included"))
        rows.append(("noise alone", noise_words(found)))
    fit = None if found.several is None else found.several.by_beat
    if fit is not None and (said := separated_words(fit)):
        rows.append(("besides lock-in", said))
    if found.several is None:
        if found.usable:
            rows.append(("r = A2/A1", with_uncertainty(float(combined.ratio), float(combined.ratio_u))))
        if math.isfinite(combined.beat_frequency):
            beat = with_uncertainty(float(combined.beat_frequency), float(combined.beat_frequency_u), "Hz")
            rows.append(("beat", beat))
        if math.isfinite(combined.input_rate):
            rows.append(("rate on the axis", f"{float(combined.input_rate):.6f} deg/s"))
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
    rows.append(("records", f"{len(found.names)}, rejected {found.records_rejected}"))
    return rows


# --------------------
# Records and rates as tables of text, and the facts at the end of the report


_RATES = ("rate/WL", "table, deg/s", "axis, deg/s", "beat, Hz", "r = A2/A1", "WL alone (noise), deg/s", "records")
_RECORDS = ("record", "lock-in rate (noise), deg/s", "beat, Hz", "r = A2/A1", "noise rms", "flags")


def rates_table(several: SeveralRates) -> TextTable:
    """Return what each rate of a run says alone."""
    rows: list[tuple[str, ...]] = []
    for group in several.groups:
        one, sense = group.combined, "-" if group.input_rate < 0 else "+"
        asked = "" if group.over_lock_in is None else f"{sense}{group.over_lock_in:g}"
        left_out = int(one.records_rejected)
        rows.append(
            (
                asked,
                f"{group.table_rate:+.4f}",
                f"{group.input_rate:+.5f}",
                with_uncertainty(float(one.beat_frequency), float(one.beat_frequency_u)),
                with_uncertainty(float(one.ratio), float(one.ratio_u)),
                with_uncertainty(float(one.lock_in_rate), float(one.lock_in_rate_u)),
                f"{len(group.rows)}, rejected {left_out}" if left_out else f"{len(group.rows)}",
            )
        )
    return TextTable(_RATES, tuple(rows))


def records_table(found: LockInEvaluation, most: int) -> TextTable:
    """Return one row for each record, at most so many."""
    each, rows = found.each[:most], list[tuple[str, ...]]()
    for index, name in enumerate(found.names[:most]):
        rows.append(
            (
                name,
                with_uncertainty(float(each.lock_in_rate[index]), float(each.lock_in_rate_u[index])),
                with_uncertainty(float(each.beat_frequency[index]), float(each.beat_frequency_u[index])),
                with_uncertainty(float(each.ratio[index]), float(each.ratio_u[index])),
                with_prefix(float(each.noise_rms[index]), "V"),
                ", ".join(flag_names(int(each.flags[index]))).replace("_", " "),
            )
        )
    if len(found.names) > most:
        rows.append((f"and {len(found.names) - most} more", "", "", "", "", ""))
    return TextTable(_RECORDS, tuple(rows))


def routes_table(beams: BeamsFit) -> TextTable:
    """Return the lock-in rate by each route, and by all together."""
    together = ("all together", beams.lock_in_rate, beams.lock_in_rate_low_95, beams.lock_in_rate_high_95)
    ways = (
        (one.name, one.lock_in_rate, one.lock_in_rate_low_95, one.lock_in_rate_high_95) for one in beams.routes
    )
    rows = tuple((name, within(value, low, high, "deg/s")) for name, value, low, high in (*ways, together))
    return TextTable(("route", "lock-in rate, 95 %, as the records show it"), rows)


def fact_tables(found: LockInEvaluation, run: SavedRun, settings: Settings) -> list[FactTable]:
    """Return conditions and secondary results as small tables."""
    combined, rows = found.combined, list(_summary(found))
    if found.usable:
        rows += [
            ("backscatter less readout phase", f"{math.degrees(float(combined.backscatter_phase)):.1f}°"),
            ("amplitude", with_prefix(float(combined.amplitude), "V")),
        ]
    if found.several is None and (table_rate := run.facts.get("table_rate_dps")) is not None:
        rows.append(("table rate", f"{table_rate:.5f} deg/s"))
    if found.table_check is not None:
        rows.append(("latitude", f"{settings.site.latitude_deg:g}°"))
    note = "standard (k = 1) in brackets, all uncertainties included; of single records and rates their noise"
    return [
        FactTable("Result", [*rows, ("uncertainty", note)]),
        FactTable("Oscilloscope", _scope_rows(found, run, settings)),
    ]


def _scope_rows(found: LockInEvaluation, run: SavedRun, settings: Settings) -> Rows:
    scope, knobs = settings.scope, run.facts.get("scope_setting", {})
    wave, identity = found.waveforms[0], run.facts.get("identity", {})
    rows = [
        ("instrument", identity.get("text", "not known")),
        ("resource", scope.resource or "simulated bench"),
        ("record", wave.preamble.wfid or scope.channel),
        ("sampling", f"{wave.codes.size} points, every {with_prefix(wave.sample_interval, 's')}"),
        ("bandwidth limit", "20 MHz" if scope.bandwidth_limit else "off"),
    ]
    if knobs:
        rows += [
            ("vertical position", f"{knobs['position']:+.2f} div"),
            ("trigger", f"{scope.channel}, rising, {with_prefix(knobs['trigger_level'], 'V')}"),
        ]
    return rows


# --------------------
# An uncertainty budget as JSON, as a table and in sentences


_LINE = {
    "name": "name",
    "quantity": "quantity",
    "unit": "unit",
    "value": "value",
    "u": "u",
    "distribution": "distribution",
    "sensitivity_dps_per_unit": "sensitivity",
    "contribution_dps": "contribution",
    "degrees_of_freedom": "degrees_of_freedom",
    "note": "note",
    "stated": "stated",
}
BUDGET_COLUMNS = (
    "quantity",
    "value",
    "u (k = 1)",
    "distribution",
    "sensitivity, deg/s per unit",
    "contribution, deg/s",
    "share",
    "d.o.f.",
)
_SHORT = (0, 2, 4, 5, 6)  # columns that a terminal has room for


def budget_document(budget: Budget) -> dict[str, Any]:
    """Return a budget for the JSON document."""
    return {
        "reference": budget.reference,
        LOCK_IN_RATE.key(): budget.lock_in_rate,
        "combined_u_dps": budget.combined_u,
        "combined_u_percent": 100 * budget.relative_u,
        "effective_degrees_of_freedom": budget.effective_degrees_of_freedom,
        "coverage_factor": budget.coverage_factor,
        "expanded_u_95_dps": budget.expanded_u_95,
        "inputs": [{**picked(line, _LINE), "share_of_variance": budget.share(line)} for line in budget.inputs],
        "not_stated": [line.name for line in budget.not_stated],
        "largest_part": budget.inputs[0].name if budget.inputs else None,
        "remedy": remedy_sentence(budget) or None,
    }


def budget_rows(budget: Budget) -> list[tuple[str, ...]]:
    """Return the lines of a budget as text under `BUDGET_COLUMNS`, the largest contribution first."""
    # The last one is the combined uncertainty.
    rows: list[tuple[str, ...]] = []
    for line in budget.inputs:
        unit, share = "" if line.unit == "1" else f" {line.unit}", budget.share(line)
        rows.append(
            (
                line.quantity if line.stated else f"{line.quantity} (not stated)",
                f"{line.value:.6g}{unit}",
                f"{line.u:.2g}{unit}",
                line.distribution,
                f"{line.sensitivity:.3g}" if line.sensitivity else "0",
                f"{line.contribution:.2g}" if line.contribution else "0",
                "0" if share == 0 else "< 0.1 %" if share < 0.001 else f"{100 * share:.1f} %",
                _freedom(line.degrees_of_freedom),
            )
        )
    rows.append(
        (
            "lock-in rate, combined",
            f"{budget.lock_in_rate:.6g} deg/s",
            f"{budget.combined_u:.2g} deg/s",
            "",
            "",
            f"{budget.combined_u:.2g}",
            "100 %",
            _freedom(budget.effective_degrees_of_freedom),
        )
    )
    return rows


def short_budget_table(budget: Budget) -> TextTable:
    """Return the lines that contribute, the largest first, and the combined uncertainty: for a terminal."""
    *rows, combined = budget_rows(budget)
    shown = [row for line, row in zip(budget.inputs, rows, strict=True) if line.contribution > 0]
    header = [BUDGET_COLUMNS[place].replace(", deg/s per unit", "") for place in _SHORT]
    return TextTable(tuple(header), tuple(tuple(row[place] for place in _SHORT) for row in (*shown, combined)))


def budget_sentences(budget: Budget) -> list[str]:
    """Say in words what the budget comes to, what would make it smaller, and what it had to assume."""
    value = with_uncertainty(budget.lock_in_rate, budget.combined_u, "deg/s")
    percent = f" ({100 * budget.coverage_factor * budget.relative_u:.2g} %)" if budget.lock_in_rate > 0 else ""
    said = [
        f"Lock-in rate {value}, all uncertainties included; U95 = {budget.expanded_u_95:.2g} deg/s{percent} with "
        f"k = {budget.coverage_factor:.2f}."
    ]
    if remedy := remedy_sentence(budget):
        said.append(remedy)
    if assumed := assumed_sentence(budget):
        said.append(assumed)
    return said


def assumed_sentence(budget: Budget) -> str:
    """Name what counts with a bound because nobody stated it; empty where everything was stated."""
    parts = [f"{line.quantity} ({line.note.removeprefix('not stated: bound of ')})" for line in budget.not_stated]
    if not parts:
        return ""
    return f"Not given, worst case assumed: {'; '.join(parts)}."


def doubt_sentence(budget: Budget) -> str:
    """Say that something unknown rules the uncertainty; empty where the largest part is known."""
    first = budget.inputs[0] if budget.inputs else None
    if first is None or first.stated or first.contribution == 0:
        return ""
    return f"The largest uncertainty is an assumption: {first.quantity}, {first.note}."


def _freedom(value: float) -> str:
    return "∞" if value > 1e6 else f"{value:.0f}"
