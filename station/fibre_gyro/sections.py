"""Sections of the reports: plots, sentences and tables of each test."""

from __future__ import annotations

import math

from station.fibre_gyro import plots, words
from station.fibre_gyro.eps.measurement import EpsEvaluation
from station.fibre_gyro.figures.measurement import FiguresEvaluation
from station.fibre_gyro.results import FogResult
from station.fibre_gyro.selfcal.measurement import SelfcalEvaluation
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.table.measurement import AxisResult, TableEvaluation
from station.fibre_gyro.witness.measurement import WitnessEvaluation
from station.fibre_gyro.witness.sections import witness_sections
from station.lock_in.sentences import with_uncertainty
from station.results.parts import PlacedFigure, Section, Table

_PPM = 1e6
_TRACE_RATE_DPS = 20.0


def sections_of(result: FogResult) -> list[Section]:
    """Return the sections of a report, what is to be watched last."""
    found = result.evaluation
    if isinstance(found, TableEvaluation):
        made = _table_sections(found, result)
    elif isinstance(found, SelfcalEvaluation):
        made = _selfcal_sections(found, result)
    elif isinstance(found, EpsEvaluation):
        made = _eps_sections(found, result)
    elif isinstance(found, WitnessEvaluation):
        made = witness_sections(found, result.sentences)
    else:
        made = _figures_sections(found, result)
    if result.flags:
        made.append(Section("What to watch", sentences=result.flags))
    return made


def _table_sections(found: TableEvaluation, result: FogResult) -> list[Section]:
    made = [
        Section("Scale factor of each axis", result.sentences[0], table=_axis_table(found, result.settings)),
        Section(
            "Output and residuals",
            figures=(
                PlacedFigure(
                    plots.output_against_rate_svg(found), "Mean output over whole turns, and the fitted lines."
                ),
                PlacedFigure(
                    plots.residuals_svg(found),
                    "Output less fit; the bars are the standard uncertainty of each mean. Filled: positive "
                    "sense; open: negative.",
                ),
            ),
        ),
    ]
    if any(one.differences is not None for one in found.axes):
        made.append(
            Section(
                "Numbers of small rates",
                "Differences of two large numbers, as the patent CN104634364A makes them. White noise hardly "
                "matters; "
                f"{result.settings.table.irreproducibility_ppm:g} ppm of table rate and scale factor from run "
                "to run "
                "is multiplied by base rate over difference.",
                figures=(
                    PlacedFigure(
                        plots.differences_svg(found),
                        "Each number against K by least squares times the rate. Thick: standard uncertainty "
                        "from noise; "
                        "thin: with the irreproducibility.",
                    ),
                ),
                table=_difference_table(found),
            )
        )
    made.append(_staircase_section(result.settings))
    made.append(Section("Runs", table=_run_table(found)))
    return made


def _axis_table(found: TableEvaluation, settings: FogSettings) -> Table:
    header = (
        "axis",
        "K, counts per deg/s",
        "less design",
        "even part, deg/h",
        "bias, deg/h",
        "scatter",
        "ARW, deg/√h",
    )
    rows = [_axis_row(one, settings) for one in found.axes]
    return Table(header, tuple(rows))


def _axis_row(one: AxisResult, settings: FogSettings) -> tuple[str, ...]:
    fit = one.fit
    k_u = _PPM * fit.scale_factor_u / abs(fit.scale_factor)
    return (
        one.axis,
        with_uncertainty(fit.scale_factor, fit.scale_factor_u),
        words.ppm_words(_PPM * (fit.scale_factor / settings.nominal_scale_factor - 1), k_u),
        with_uncertainty(*fit.even_dph),
        with_uncertainty(*one.bias_dph),
        f"{fit.scatter_ppm:.2g} ppm",
        f"{fit.angle_random_walk:.2g}",
    )


def _difference_table(found: TableEvaluation) -> Table:
    rows = []
    for one in found.axes:
        differences = one.differences
        if differences is None:
            continue
        for place in range(differences.delta_dps.size):
            number = float(differences.number[place])
            rows.append(
                (
                    f"{one.axis}, {differences.delta_dps[place]:.6g} deg/s",
                    with_uncertainty(number, float(differences.number_u[place])),
                    f"{_PPM * differences.noise_u[place] / abs(number):.4g} ppm",
                    f"{_PPM * differences.irreproducibility_u[place] / abs(number):.4g} ppm",
                    f"{_PPM * (number / (one.fit.scale_factor * differences.delta_dps[place]) - 1):+.3g} ppm",
                )
            )
    return Table(
        ("difference for", "N, counts", "u from noise", "u from irreproducibility", "off the fit"), tuple(rows)
    )


def _run_table(found: TableEvaluation) -> Table:
    rows = []
    for one in found.axes:
        for key, window, residual in zip(one.keys, one.windows, one.fit.residual_ppm, strict=True):
            rows.append(
                (
                    key,
                    f"{window.turns}",
                    f"{window.duration_s:.3f}",
                    f"{window.total:.10g}",
                    with_uncertainty(window.mean, window.mean_u),
                    f"{residual:+.3g}",
                )
            )
    return Table(("run", "turns", "window, s", "sum, counts", "mean, counts", "residual, ppm"), tuple(rows))


def _selfcal_sections(found: SelfcalEvaluation, result: FogResult) -> list[Section]:
    made = [
        Section("What this result shows, and what it cannot", sentences=result.sentences),
        Section(
            "Injected steps and output",
            figures=(
                PlacedFigure(
                    plots.injected_steps_svg(found), "Net output against the rate that each step stands for."
                ),
                PlacedFigure(
                    plots.selfcal_residuals_svg(found),
                    "Net output less the injected number, and less the fitted line.",
                ),
            ),
            table=_selfcal_table(found),
        ),
        Section("Slope, intercept and static output", table=_slope_table(found)),
        _staircase_section(result.settings),
    ]
    if result.table is not None and result.table.axes:
        made.append(
            Section("Rate-table run of the same run", table=_axis_table(result.table, result.settings)),
        )
    return made


def _selfcal_table(found: SelfcalEvaluation) -> Table:
    rows = [
        (
            f"{rate:+.10g} deg/s",
            f"{given:.6f}",
            with_uncertainty(float(output), float(u)),
            f"{output - given:+.3g}",
        )
        for rate, given, output, u in zip(
            found.rate_dps, found.number, found.net.output, found.net.output_u, strict=True
        )
    ]
    return Table(("stands for", "injected, counts", "net output, counts", "difference, counts"), tuple(rows))


def _slope_table(found: SelfcalEvaluation) -> Table:
    fit, net, reference = found.fit, found.net, found.reference
    rows = [
        ("slope K_self, counts per deg/s", with_uncertainty(fit.slope, fit.slope_u)),
        ("slope of the injected numbers", f"{found.numbers.slope:.9g}"),
        ("intercept F_0, counts", with_uncertainty(fit.intercept, math.hypot(fit.intercept_u, net.static_u))),
        ("static output N_0, counts", with_uncertainty(net.static, net.static_u)),
        ("static output after less before", with_uncertainty(net.drift, net.drift_u)),
    ]
    if reference is not None:
        rows.append(
            (f"K, {reference.source}", with_uncertainty(reference.scale_factor, reference.scale_factor_u)),
        )
    return Table(("", "value"), tuple(rows))


def _eps_sections(found: EpsEvaluation, result: FogResult) -> list[Section]:
    rows = tuple(
        (f"{step:+g} codes", with_uncertainty(float(n), float(nu)), with_uncertainty(float(r), float(ru)))
        for step, n, nu, r, ru in zip(
            found.step_codes, found.normal, found.normal_u, found.reset, found.reset_u, strict=True
        )
    )
    header = ("injected step", "error without reset, counts", "error with reset, counts")
    return [
        Section("What this result shows, and what it cannot", sentences=result.sentences),
        Section(
            "Pairs with and without a reset",
            figures=(
                PlacedFigure(plots.errors_svg(found), "Demodulated error against the injected step."),
                PlacedFigure(plots.reset_differences_svg(found), "Their difference is the 2π error alone."),
            ),
            table=Table(header, rows),
        ),
        _staircase_section(result.settings, open_loop_step=float(abs(found.step_codes).min())),
    ]


def _figures_sections(found: FiguresEvaluation, result: FogResult) -> list[Section]:
    header = ("run", "°C", "K, counts per deg/s", "nonlin. FS", "nonlin. point", "asymmetry", "pattern")
    rows = tuple(
        (
            run.name,
            f"{run.temperature_c:.1f}" if math.isfinite(run.temperature_c) else "",
            with_uncertainty(run.figures.fit.slope, run.figures.fit.slope_u),
            f"{run.figures.nonlinearity_ppm:.3g} ppm",
            f"{run.figures.nonlinearity_of_point_ppm:.3g} ppm",
            words.ppm_words(run.figures.asymmetry_ppm, run.figures.asymmetry_u_ppm).lstrip("+"),
            ", ".join(run.pattern.names) or "none",
        )
        for run in (*found.runs, *found.at_temperatures)
    )
    return [
        Section(
            "Deviations from the line",
            "Measured less fitted output. GJB style gives the nonlinearity of full scale, IEEE style names "
            "either.",
            figures=(
                PlacedFigure(plots.deviations_svg(found, of_point=False), "As ppm of the largest output."),
                PlacedFigure(plots.deviations_svg(found, of_point=True), "As ppm of the point's own output."),
            ),
            sentences=result.sentences,
        ),
        Section(
            "Scale factor of each run",
            "Repeatability is the standard deviation over the runs from cold starts; the temperature "
            "coefficient is the "
            "largest change of K per kelvin from their mean.",
            figures=(PlacedFigure(plots.scale_factors_svg(found), "Each run less the mean of the runs."),),
            table=Table(header, rows),
        ),
    ]


def _staircase_section(settings: FogSettings, open_loop_step: float | None = None) -> Section:
    """Staircase and detector signal over a few resets, computed from the design."""
    from analysis.fibre_gyro import ClosedLoop
    from station.fibre_gyro.simulated_bench import loop_settings, quiet

    loop, coil = quiet(loop_settings(settings)), settings.coil
    gyro = ClosedLoop(coil, loop, 0, kernel="numpy")
    step = open_loop_step or coil.nominal_scale(loop.dac_bits) * _TRACE_RATE_DPS
    samples = int(3.2 * loop.codes / step)
    if open_loop_step is None:
        rate = min(_TRACE_RATE_DPS, 0.5 * coil.fringe_limit_dps)
        gyro.run(2, output_period_s=200 * coil.transit_time, rate_dps=rate)
        trace = gyro.trace(samples, rate_dps=rate)
        caption = (
            f"At {rate:g} deg/s in closed loop: the feedback keeps the intensity at one level between resets."
        )
    else:
        gyro.clear_feedback()
        trace = gyro.trace(samples, injected_step=step, closed=False)
        caption = f"A step of {step:g} codes in open loop: the intensity alternates with the bias."
    figure = PlacedFigure(plots.staircase_svg(trace, coil.transit_time), f"{caption} Dashed: 2π resets.")
    text = "Computed at every transit time from the design and, in a simulation, its errors; without noise."
    return Section("Staircase and detector signal", text, figures=(figure,))
