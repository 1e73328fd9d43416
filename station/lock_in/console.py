"""The result on a terminal: a table that a person can read."""

from __future__ import annotations

import math
import sys

from rich.console import Console
from rich.table import Table

from analysis.lock_in_run import SeveralRates
from station.lock_in.evaluation import Evaluation
from station.lock_in.sentences import (
    GROUP_COLUMNS,
    budget_sentences,
    flag_sentences,
    group_rows,
    interval_words,
    lock_in_words,
    quadrature_sentences,
    rates_sentences,
    record_flags,
    with_prefix,
    with_uncertainty,
)

_RECORDS_SHOWN = 40


def stdout_console() -> Console:
    """Return a console on stdout; wide enough for a table also where there is no terminal."""
    return Console(width=None if sys.stdout.isatty() else 100, highlight=False)


def print_result(evaluation: Evaluation, *, simulated: bool = False) -> None:
    """Print records and combined result.

    Parameters
    ----------
    evaluation : Evaluation
    simulated : bool, optional
        Say that the bench was simulated.
    """
    console = stdout_console()
    if evaluation.several is not None:
        console.print(_rate_table(evaluation.several))
    elif len(evaluation.names) > 1:
        console.print(_record_table(evaluation))
    console.print(_summary(evaluation, simulated))
    budget = [] if evaluation.budget is None else budget_sentences(evaluation.budget)
    for sentence in (*rates_sentences(evaluation), *quadrature_sentences(evaluation), *budget):
        console.print(f"• {sentence}", markup=False)
    for sentence in flag_sentences(evaluation):
        console.print(f"• {sentence}", markup=False, style="yellow")


def _rate_table(several: SeveralRates) -> Table:
    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for name in GROUP_COLUMNS:
        table.add_column(name, justify="right", no_wrap=True)
    for row in group_rows(several):
        table.add_row(*row)
    return table


def _record_table(evaluation: Evaluation) -> Table:
    each = evaluation.each
    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for name in ("record", "lock-in rate, deg/s", "beat, Hz", "r = A2/A1"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("flags")
    for index, flags in enumerate(record_flags(evaluation)[:_RECORDS_SHOWN]):
        table.add_row(
            evaluation.names[index],
            with_uncertainty(float(each.lock_in_rate[index]), float(each.lock_in_rate_u[index])),
            with_uncertainty(float(each.beat_frequency[index]), float(each.beat_frequency_u[index])),
            with_uncertainty(float(each.ratio[index]), float(each.ratio_u[index])),
            ", ".join(flags).replace("_", " "),
        )
    if len(evaluation.names) > _RECORDS_SHOWN:
        table.add_row("...")
    return table


def _summary(evaluation: Evaluation, simulated: bool) -> Table:
    combined = evaluation.combined
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    table.add_row("", "")
    if evaluation.usable:
        rate, hourly = lock_in_words(evaluation)
        table.add_row("lock-in rate", f"[bold]{rate}[/bold]  =  {hourly}")
        table.add_row("95 % interval", interval_words(evaluation))
        table.add_row("r = A2/A1", with_uncertainty(float(combined.ratio), float(combined.ratio_u)))
    else:
        table.add_row("lock-in rate", "[bold]none[/bold]")
    if math.isfinite(combined.beat_frequency):
        beat = with_uncertainty(float(combined.beat_frequency), float(combined.beat_frequency_u), "Hz")
        table.add_row("beat", beat)
    if math.isfinite(combined.input_rate):
        table.add_row("rate on the axis", f"{float(combined.input_rate):.6f} deg/s")
    if evaluation.tilt is not None:
        tilt = with_uncertainty(evaluation.tilt.tilt_deg, evaluation.tilt.tilt_u_deg, "deg")
        table.add_row("tilt of the axis", tilt)
    if (check := evaluation.table_check) is not None:
        by_table = with_uncertainty(check.lock_in_rate, check.lock_in_rate_u, "deg/s")
        table.add_row("by the table's rate", f"{by_table}, beat over table {check.beat_over_table:.5f}")
    several = evaluation.several
    if several is not None and (other := several.by_frequency) is not None:
        by_frequency = with_uncertainty(other.lock_in_rate, other.lock_in_rate_u, "deg/s")
        table.add_row("by the frequencies", f"{by_frequency}, beat frequency against rate, without harmonics")
    if math.isfinite(combined.noise_rms):
        table.add_row("noise", f"{with_prefix(float(combined.noise_rms), 'V')} rms; {combined.noise_model}")
    table.add_row("method", evaluation.method_text)
    table.add_row("records", f"{len(evaluation.names)}, left out {evaluation.records_rejected}")
    if simulated:
        truth = evaluation.truth
        told = f"the truth is {truth['lock_in_rate_dps']:.6g} deg/s" if truth else "no truth is saved"
        table.add_row("bench", f"simulated; {told}")
    return table


def print_harmonics(harmonics: list[dict[str, float]]) -> None:
    """Print the harmonics of a record, as :func:`station.lock_in.harmonics.harmonics_of` gives them."""
    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for name in ("harmonic", "frequency", "amplitude", "of the first"):
        table.add_column(name, justify="right", no_wrap=True)
    first = harmonics[0]["amplitude_v"]
    for line in harmonics:
        share = f"{line['amplitude_v'] / first:.4f}" if first > 0 else ""
        frequency, amplitude = with_prefix(line["frequency_hz"], "Hz"), with_prefix(line["amplitude_v"], "V")
        table.add_row(f"{line['order']:.0f}", frequency, amplitude, share)
    stdout_console().print(table)
