"""The sections of a report: figures with their captions, sentences, tables."""

from __future__ import annotations

import math
from collections.abc import Iterable

from analysis.budget import Budget
from analysis.lock_in_run import SeveralRates
from station.lock_in import plots, rates_plots
from station.lock_in.budget_plot import budget_svg
from station.lock_in.evaluation import Evaluation
from station.lock_in.rates_sentences import describe_frequencies
from station.lock_in.sentences import (
    BUDGET_COLUMNS,
    budget_rows,
    budget_sentences,
    group_rows,
    quadrature_sentences,
    rates_sentences,
)
from station.results.parts import PlacedFigure, Section, Table
from station.runs.store import SavedRun


def report_sections(evaluation: Evaluation, run: SavedRun) -> list[Section]:
    """Return the sections of a report in their order.

    Parameters
    ----------
    evaluation : Evaluation
    run : SavedRun

    Returns
    -------
    list of Section
    """
    sections = []
    if evaluation.several is not None:
        sections.append(_several_rates(evaluation, evaluation.several))
    elif evaluation.usable:
        caption = "Lock-in rate of every record with its standard uncertainty, and the combined value."
        figure = PlacedFigure(plots.values_svg(evaluation), caption)
        sections.append(Section("Records and combined value", figures=(figure,)))
    if evaluation.several is not None and evaluation.several.by_beat is not None:
        sections.append(_checks(evaluation.several))
    if evaluation.quadratures is not None:
        sections.append(Section("Sine and cosine", sentences=tuple(quadrature_sentences(evaluation))))
    if evaluation.budget is not None:
        sections.append(_budget(evaluation.budget))
    return sections + _one_record(evaluation)


def _budget(budget: Budget) -> Section:
    figure = PlacedFigure(budget_svg(budget), "What each input gives to the standard uncertainty.")
    shown = [budget_rows(budget)[-1], *budget_rows(budget)[:-1]]
    table = Table(BUDGET_COLUMNS, tuple(shown))
    return Section("Uncertainty budget", figures=(figure,), sentences=tuple(budget_sentences(budget)), table=table)


def _several_rates(evaluation: Evaluation, several: SeveralRates) -> Section:
    """Each rate alone, and the fit; without a fit the reason for that."""
    header = (
        "rate / WL",
        "table, deg/s",
        "axis, deg/s",
        "beat, Hz",
        "r = A2/A1",
        "lock-in rate alone, deg/s",
        "records",
    )
    table = Table(header, tuple(group_rows(several)))
    sentences = tuple(rates_sentences(evaluation))
    if several.by_beat is None:
        return Section("Several rates", sentences=sentences, table=table)
    truth = None if evaluation.truth is None else evaluation.truth["lock_in_rate_dps"]
    figure = PlacedFigure(
        rates_plots.rates_svg(several, evaluation.method.scale_factor, truth),
        "Lock-in rate that each rate alone would give, with its standard uncertainty. Lock-in itself is the same "
        "at every rate and in both senses; what rises or falls is distortion of the detector, or the gain of the "
        "laser. The lines are what the fit expects at each rate.",
    )
    return Section("Several rates", figures=(figure,), sentences=sentences, table=table)


def _checks(several: SeveralRates) -> Section:
    fit = several.by_beat
    assert fit is not None  # the caller has looked
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
    return Section("Does the model hold?", figures=tuple(figures), sentences=sentences)


def _one_record(evaluation: Evaluation) -> list[Section]:
    shown = _shown_record(evaluation)
    if shown is None:
        return []
    wave, name = evaluation.waveforms[shown], evaluation.names[shown]
    beat = PlacedFigure(plots.time_record_svg(wave), f"First periods of record {name}, and the fitted waveform.")
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


def _shown_record(evaluation: Evaluation) -> int | None:
    """Pick the first record that gave a value, or else the first with a frequency."""
    rows: Iterable[int] = range(len(evaluation.names))
    if evaluation.several is not None:
        rows = evaluation.several.reference_group.rows
    for values in (evaluation.each.lock_in_rate, evaluation.each.beat_frequency):
        for row in rows:
            if math.isfinite(values[row]):
                return row
    return None
