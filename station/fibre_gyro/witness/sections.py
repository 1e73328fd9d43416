"""Report of the oscilloscope on the modulator: plots, table of the records, conditions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.witness.measurement import WitnessedRecord, WitnessEvaluation
from station.report.figure import ACCENT, INK, SECOND, SOFT, WIDE, legend_above, svg_element
from station.results.numbers import with_uncertainty
from station.results.parts import PlacedFigure, Rows, Section, Table
from station.runs.store import SavedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MICRO = 1e6


def witness_sections(found: WitnessEvaluation, sentences: tuple[str, ...]) -> list[Section]:
    """Return the sections of the report."""
    first = found.records[0]
    return [
        Section("What this result shows, and what it cannot", sentences=sentences),
        Section(
            "Staircase on the oscilloscope",
            figures=(PlacedFigure(staircase_record_svg(first), f"Samples and fitted levels of {first.name}."),),
        ),
        Section(
            "Levels less the even staircase",
            "Heights of the levels against what even steps and resets would give. A pattern over the height is "
            "converter nonlinearity, of the gyro's or of the oscilloscope's.",
            figures=(PlacedFigure(level_residuals_svg(found), "Every level of every record."),),
        ),
        Section("Records", "Without the uncertainty of gain and time base.", table=_record_table(found)),
    ]


def staircase_record_svg(record: WitnessedRecord) -> str:
    """Draw the samples of a record and the levels that were fitted."""
    found, volts = record.found, record.waveform.volts

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        begin = _MICRO * record.waveform.sample_interval * np.arange(volts.size)
        axes.plot(begin, volts, color=ACCENT, linewidth=0.7, label="samples")
        half = _MICRO * found.step_time / 2
        middle = _MICRO * found.times
        label = "fitted levels"
        axes.hlines(found.model, middle - half, middle + half, color=SECOND, linewidth=1.8, label=label)
        axes.set(xlabel="time from the first sample, µs", ylabel="V")
        axes.set_xlim(0, begin[-1])
        legend_above(axes, columns=2)

    return svg_element("witness-record", WIDE, draw)


def level_residuals_svg(found: WitnessEvaluation) -> str:
    """Draw levels less fitted levels against their height."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for one in found.records:
            levels = one.found.levels
            axes.plot(levels, 1000 * (levels - one.found.model), ".", ms=3.5, color=INK, alpha=0.6)
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="height of the level, V", ylabel="level less fit, mV")

    return svg_element("witness-levels", WIDE, draw)


def _record_table(found: WitnessEvaluation) -> Table:
    header = ("record", "step, V", "step time, µs", "fall, V", "V_2π, V", "bias, V", "resets", "noise, mV")
    return Table(header, tuple(_row(one) for one in found.records))


def _row(record: WitnessedRecord) -> tuple[str, ...]:
    found = record.found
    return (
        record.name,
        with_uncertainty(found.step_height, found.step_height_u),
        with_uncertainty(_MICRO * found.step_time, _MICRO * found.step_time_u),
        with_uncertainty(found.reset_height, found.reset_height_u),
        with_uncertainty(found.two_pi_voltage, found.two_pi_voltage_u),
        with_uncertainty(found.bias_height, found.bias_height_u),
        f"{found.resets}",
        f"{1000 * found.noise_rms:.2g}",
    )


def condition_rows(run: SavedRun, settings: FogSettings) -> Rows:
    """Return how the records were taken, for the facts of the report."""
    facts, witness = run.facts, settings.witness
    identity = facts.get("identity")
    scope = f"{identity['manufacturer']} {identity['model']}" if identity else "not known"
    step = facts.get("injected", {}).get("step_codes")
    source = witness.resource or "simulated oscilloscope"
    return [
        ("records from", ", ".join(facts["logs"]) if facts.get("logs") else source),
        ("oscilloscope", scope),
        ("setting", _setting(run)),
        ("injected step", f"{step:g} codes, feedback held" if step else "not by this program"),
        ("half-wave voltage", f"{witness.half_wave_v:g} V, u {witness.half_wave_u_v:g} V" if witness.half_wave_v
         else f"{settings.simulation.half_wave_v:g} V of the simulation" if facts["simulated"] else "not known"),
        ("gain, time base", f"u {100 * witness.gain_u:.3g} %, {_MICRO * witness.time_base_u:.3g} ppm"),
    ]  # fmt: skip


def _setting(run: SavedRun) -> str:
    from instrument import Preamble

    return "; ".join(dict.fromkeys(Preamble.parse(record.preamble).wfid for record in run.records))
