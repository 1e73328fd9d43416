"""Report of the oscilloscope on the modulator: plots, table of the records, conditions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from instrument import Preamble
from station.fibre_gyro.common import gyro_table
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.witness.evaluate import WitnessedRecord, WitnessFound
from station.report.figure import ACCENT, INK, SECOND, SOFT, WIDE, legend_above, svg_element
from station.results.numbers import with_uncertainty
from station.results.parts import FactTable, PlacedFigure, Section, TextTable
from station.results.result import Result
from station.runs.store import SavedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MICRO = 1e6


def sections(found: WitnessFound, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    first = found.records[0]
    return [
        Section("What this result shows, and what it cannot", sentences=result.sentences),
        Section(
            "Staircase on the oscilloscope",
            figures=(PlacedFigure(_record_svg(first), f"Samples and fitted levels of {first.name}."),),
        ),
        Section(
            "Levels less the even staircase",
            "Heights of the levels against what even steps and resets would give. A pattern over the height is "
            "converter nonlinearity, of the gyro's or of the oscilloscope's.",
            figures=(PlacedFigure(_level_residuals_svg(found), "Every level of every record."),),
        ),
        Section("Records", "Without the uncertainty of gain and time base.", table=_record_table(found)),
    ]


def _record_svg(record: WitnessedRecord) -> str:
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


def _level_residuals_svg(found: WitnessFound) -> str:
    """Draw levels less fitted levels against their height."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for one in found.records:
            levels = one.found.levels
            axes.plot(levels, 1000 * (levels - one.found.model), ".", ms=3.5, color=INK, alpha=0.6)
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="height of the level, V", ylabel="level less fit, mV")

    return svg_element("witness-levels", WIDE, draw)


def _record_table(found: WitnessFound) -> TextTable:
    header = ("record", "step, V", "step time, µs", "fall, V", "V_2π, V", "bias, V", "resets", "noise, mV")
    return TextTable(header, tuple(_row(one) for one in found.records))


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


def facts(found: WitnessFound, run: SavedRun, settings: FogSettings) -> list[FactTable]:
    """Return how the records were taken, for the facts of the report."""
    known, witness = run.facts, settings.witness
    identity, step = known.get("identity"), known.get("injected", {}).get("step_codes")
    half_wave = "not known"
    if witness.half_wave_v:
        half_wave = f"{witness.half_wave_v:g} V, u {witness.half_wave_u_v:g} V"
    elif known.simulated:
        half_wave = f"{settings.simulation.half_wave_v:g} V of the simulation"
    rows = [
        ("records from", ", ".join(known.sources) or witness.resource or "simulated oscilloscope"),
        ("oscilloscope", f"{identity['manufacturer']} {identity['model']}" if identity else "not known"),
        ("setting", "; ".join(dict.fromkeys(Preamble.parse(record.preamble).wfid for record in run.records))),
        ("injected step", f"{step:g} codes, feedback held" if step else "not by this program"),
        ("half-wave voltage", half_wave),
        ("gain, time base", f"u {100 * witness.gain_u:.3g} %, {_MICRO * witness.time_base_u:.3g} ppm"),
    ]
    return [gyro_table(settings), FactTable("Conditions", rows)]
