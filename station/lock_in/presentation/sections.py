"""The report's figures and tables: rates or records, checks, budget, and one record."""

from __future__ import annotations

import math
from collections.abc import Iterable

from analysis.budget import Budget
from analysis.lock_in_run import SeveralRates
from station.lock_in.found import LockInFound
from station.lock_in.presentation import plots, rates_plots
from station.lock_in.presentation.budget_plot import budget_svg
from station.lock_in.presentation.budget_table import BUDGET_COLUMNS, budget_rows, budget_sentences
from station.lock_in.presentation.rates_sentences import describe_frequencies
from station.lock_in.presentation.sentences import quadrature_sentences, rates_sentences
from station.lock_in.presentation.table_sentences import table_sentences
from station.lock_in.presentation.tables import rates_table, records_table
from station.results.parts import PlacedFigure, Section, TextTable
from station.results.result import Result

_RECORDS_SHOWN = 200


def sections(found: LockInFound, result: Result) -> list[Section]:
    """Return the sections of the report in their order."""
    made = []
    if found.several is not None:
        made.append(_several_rates(found, found.several))
        made += _checks(found.several)
    elif found.usable:
        caption = "Lock-in rate of every record with its standard uncertainty, and the combined value."
        figure = PlacedFigure(plots.values_svg(found), caption)
        made.append(Section("Records and combined value", figures=(figure,)))
    if found.table_check is not None:
        made.append(Section("Does the table agree?", sentences=tuple(table_sentences(found))))
    if found.quadratures is not None:
        made.append(Section("Sine and cosine", sentences=tuple(quadrature_sentences(found))))
    if found.budget is not None:
        made.append(_budget(found.budget))
    return [*made, *_one_record(found), Section("Records", table=records_table(found, _RECORDS_SHOWN))]


def _budget(budget: Budget) -> Section:
    figure = PlacedFigure(budget_svg(budget), "What each input gives to the standard uncertainty.")
    shown = [budget_rows(budget)[-1], *budget_rows(budget)[:-1]]
    table = TextTable(BUDGET_COLUMNS, tuple(shown))
    return Section("Uncertainty budget", figures=(figure,), sentences=tuple(budget_sentences(budget)), table=table)


def _several_rates(found: LockInFound, several: SeveralRates) -> Section:
    """Each rate alone, and the fit; without a fit the reason for that."""
    table = rates_table(several)
    sentences = tuple(rates_sentences(found))
    if several.by_beat is None:
        return Section("Several rates", sentences=sentences, table=table)
    truth = None if found.truth is None else found.truth["lock_in_rate_dps"]
    figure = PlacedFigure(
        rates_plots.rates_svg(several.groups, several.by_beat, found.method.scale_factor, truth),
        "Lock-in rate that each rate alone would give, with its standard uncertainty. Lock-in itself is the same "
        "at every rate and in both senses; what rises or falls is distortion of the detector, or the gain of the "
        "laser. The lines are what the fit expects at each rate.",
    )
    return Section("Several rates", figures=(figure,), sentences=sentences, table=table)


def _checks(several: SeveralRates) -> list[Section]:
    fit = several.by_beat
    if fit is None:
        return []
    figures = [
        PlacedFigure(
            rates_plots.deviations_svg(fit),
            "Distance of each record from the fit in standard uncertainties. One record in a hundred lies above "
            "the broken line by chance.",
        )
    ]
    if any(math.isfinite(value) for value in fit.left_out.lock_in_rate):
        figures.append(PlacedFigure(rates_plots.left_out_svg(fit), "The fit again, without each rate in turn."))
    other = several.by_frequency
    sentences: tuple[str, ...] = ()
    if other is not None:
        first, *rest = describe_frequencies(other)
        sentences = (f"The other route, beat frequency against rate: {first}", *rest)
    return [Section("Does the model hold?", figures=tuple(figures), sentences=sentences)]


def _one_record(found: LockInFound) -> list[Section]:
    shown = _shown_record(found)
    if shown is None:
        return []
    wave, name = found.waveforms[shown], found.names[shown]
    beat = PlacedFigure(
        plots.time_record_svg(wave),
        f"First periods of record {name} with the fitted harmonics, and what the fit leaves. A rate that moves "
        "within the record shows there as waves of the beat's period; the result's own fit follows it.",
    )
    spectrum = PlacedFigure(
        plots.spectrum_svg(wave),
        f"Record {name}, Blackman-Harris window. Each harmonic of an ideal beat is weaker than the one before by "
        "the same ratio r; r gives the lock-in rate.",
    )
    lines = (
        PlacedFigure(plots.line_svg(wave, 1), "Fundamental, enlarged."),
        PlacedFigure(plots.line_svg(wave, 2), "Second harmonic, enlarged."),
    )
    return [
        Section("The beat", figures=(beat,)),
        Section("Its spectrum", figures=(spectrum,)),
        Section(
            "Fundamental and second harmonic",
            "The values come from the least-squares fit of the samples, not from the spectrum.",
            lines,
        ),
    ]


def _shown_record(found: LockInFound) -> int | None:
    """Pick the first record that gave a value, or else the first with a frequency."""
    rows: Iterable[int] = range(len(found.names))
    if found.several is not None:
        rows = found.several.reference_group.rows
    for values in (found.each.lock_in_rate, found.each.beat_frequency):
        for row in rows:
            if math.isfinite(values[row]):
                return row
    return None
