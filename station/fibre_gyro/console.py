"""The result on a terminal."""

from __future__ import annotations

import math

from rich.table import Table as Printed

from station.fibre_gyro import words
from station.fibre_gyro.results import FogResult
from station.fibre_gyro.selfcal.measurement import SelfcalEvaluation
from station.fibre_gyro.table.measurement import TableEvaluation
from station.report.console import stdout_console
from station.results.numbers import with_uncertainty


def print_fog_result(result: FogResult, *, simulated: bool, truth: dict[str, float] | None) -> None:
    """Print a result: values, what they mean, what to watch, and the verdict.

    Parameters
    ----------
    result : FogResult
    simulated : bool
    truth : dict or None
        Of a simulated run.
    """
    console = stdout_console()
    if isinstance(result.evaluation, TableEvaluation):
        console.print(_axes(result.evaluation))
    summary = Printed(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    summary.add_column(style="dim", no_wrap=True)
    summary.add_column()
    summary.add_row("", "")
    summary.add_row("result", f"[bold]{result.value}[/bold]")
    for line in result.lines:
        summary.add_row("", line)
    if isinstance(result.evaluation, SelfcalEvaluation):
        fit, net = result.evaluation.fit, result.evaluation.net
        u = math.hypot(fit.intercept_u, net.static_u)
        summary.add_row("intercept F_0", f"{with_uncertainty(fit.intercept, u)} counts")
        summary.add_row("static output N_0", f"{with_uncertainty(net.static, net.static_u)} counts")
    if simulated:
        told = ", ".join(f"{name.replace('_', ' ')} {value:.9g}" for name, value in (truth or {}).items())
        summary.add_row("bench", f"simulated; {told}")
    console.print(summary)
    for sentence in result.sentences:
        console.print(f"• {sentence}", markup=False)
    for sentence in result.flags:
        console.print(f"• {sentence}", markup=False, style="yellow")
    for tested in result.tested:
        console.print(tested.sentence, markup=False, style="green" if tested.passed else "bold red")


def _axes(found: TableEvaluation) -> Printed:
    table = Printed(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for name in ("axis", "K, counts per deg/s", "even part, deg/h", "bias, deg/h", "scatter"):
        table.add_column(name, justify="right", no_wrap=True)
    for one in found.axes:
        fit = one.fit
        table.add_row(
            one.axis,
            with_uncertainty(fit.scale_factor, fit.scale_factor_u),
            with_uncertainty(*fit.even_dph),
            with_uncertainty(*one.bias_dph),
            words.ppm(fit.scatter_ppm).lstrip("+"),
        )
    return table
