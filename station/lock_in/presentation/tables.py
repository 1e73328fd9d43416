"""Records and rates as tables of text, and the facts at the end of the report."""

from __future__ import annotations

import math

from analysis import flag_names
from analysis.lock_in_run import SeveralRates
from station.lock_in.found import LockInFound
from station.lock_in.presentation.sentences import span_words
from station.lock_in.presentation.table_sentences import beat_over_table_words, by_table_words
from station.lock_in.settings import Settings
from station.results.numbers import with_prefix, with_uncertainty
from station.results.parts import FactTable, Rows, TextTable
from station.runs.store import SavedRun

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
                f"{len(group.rows)}, left out {left_out}" if left_out else f"{len(group.rows)}",
            )
        )
    return TextTable(_RATES, tuple(rows))


def records_table(found: LockInFound, most: int) -> TextTable:
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


def fact_tables(found: LockInFound, run: SavedRun, settings: Settings) -> list[FactTable]:
    """Return conditions and secondary results as small tables."""
    return [
        FactTable("Result", _result_rows(found)),
        FactTable("Rate", _rate_rows(found, run, settings)),
        FactTable("Oscilloscope", _scope_rows(found, run, settings)),
    ]


def _result_rows(found: LockInFound) -> Rows:
    combined = found.combined
    counted = len(found.waveforms) + len(found.damaged)
    rows = [
        ("method", found.method_text),
        ("scale factor K", f"{found.method.scale_factor:g} pulses/deg"),
        ("noise model", combined.noise_model),
        (
            "uncertainty",
            "standard (k = 1) in brackets, every input counted; of single records and rates their noise. The "
            "interval covers 95 %",
        ),
        ("records", f"{counted}, left out {found.records_rejected}"),
    ]
    if found.usable:
        if found.several is None:
            rows.append(("ratio r = A2/A1", with_uncertainty(float(combined.ratio), float(combined.ratio_u))))
        rows += [
            ("noise alone", f"{found.noise_u:.2g} deg/s of the lock-in rate (k = 1)"),
            ("backscatter less readout phase", f"{math.degrees(float(combined.backscatter_phase)):.1f}°"),
            ("amplitude", with_prefix(float(combined.amplitude), "V")),
            ("noise in each sample", f"{with_prefix(float(combined.noise_rms), 'V')} rms"),
        ]
    return rows


def _rate_rows(found: LockInFound, run: SavedRun, settings: Settings) -> Rows:
    combined, several, rows = found.combined, found.several, []
    if several is not None:
        each = several.groups
        rows += [
            ("beat frequency", span_words((float(one.combined.beat_frequency) for one in each), "Hz")),
            ("rate on the axis", span_words((one.input_rate for one in each), "deg/s")),
            ("table rate", span_words((one.table_rate for one in each), "deg/s")),
        ]
    elif math.isfinite(combined.beat_frequency):
        beat = with_uncertainty(float(combined.beat_frequency), float(combined.beat_frequency_u), "Hz")
        rows.append(("beat frequency", beat))
    if several is None and math.isfinite(combined.input_rate):
        rows.append(("rate on the axis, by the beat", f"{float(combined.input_rate):.6f} deg/s"))
    if (check := found.table_check) is not None:
        rows += [
            ("rate on the axis, by the table", f"{check.input_rate:.6f} deg/s"),
            ("beat over table", f"{beat_over_table_words(check)} (K and tilt found with it cancel)"),
            ("lock-in rate, by the table", by_table_words(check)),
        ]
    if several is None and (table_rate := run.facts.get("table_rate_dps")) is not None:
        rows.append(("table rate", f"{table_rate:.5f} deg/s"))
    if found.tilt is not None:
        rows.append(("tilt of the axis", with_uncertainty(found.tilt.tilt_deg, found.tilt.tilt_u_deg, "deg")))
    if found.table_check is not None:
        rows += [
            (
                f"K by the {one.by}",
                with_uncertainty(one.scale_factor, one.scale_factor_u, "pulses/deg"),
            )
            for one in found.table_check.scale_factors
        ]
        rows.append(("latitude", f"{settings.site.latitude_deg:g}°"))
    return rows


def _scope_rows(found: LockInFound, run: SavedRun, settings: Settings) -> Rows:
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
