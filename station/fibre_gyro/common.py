"""What the measurements of a fibre gyro share: the truth of a simulation, facts for the report, a staircase."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.fibre_gyro import ClosedLoop, largest_step, predicted_table_scale
from instrument.fibre_gyro import ANGLE_UNITS, HOST_CLOCK_U, HostClock
from station.fibre_gyro.bench import loop_settings, quiet
from station.fibre_gyro.segments import Segment, segments_of
from station.fibre_gyro.settings import FogSettings
from station.report.figure import ACCENT, INK, SECOND, SOFT, THIRD, svg_element
from station.results.numbers import TWO_PI_ERROR_PPM
from station.results.result import Excluded, FactTable, PlacedFigure, Result, Rows, Section, with_uncertainty
from station.runs.store import SavedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from analysis.fibre_gyro import LoopTrace

PPM = 1e6
COUNTS_PER_DPS = "counts per deg/s"
COLOURS = (ACCENT, SECOND, THIRD, INK, "#8a5a9e", "#b0902c", SOFT)
"""Of axes or runs side by side in one figure."""
_HIDDEN = 6.5  # standard deviations of the noise behind which a changed digit cannot be seen
_NOTICEABLE = 0.1  # of the standard uncertainty of a mean: what may move it by more is told
_UNKNOWN_CLOCK_U = 0.03 / math.sqrt(3)
"""Of the interval between two outputs where nobody compared it: clocks of real gyros are up to 3 % off."""
_TRACE_RATE_DPS = 20.0
_TALL = (10.0, 5.6)
_SIMULATED_BY = {"output": "words by the output model", "transit": "every transit time computed"}


def truth_of(settings: FogSettings) -> dict[str, dict[str, float]]:
    """Return the fact ``truth`` of a simulated run, what it should find; nothing for a real gyro."""
    if not settings.simulated:
        return {}
    simulation = settings.simulation
    tilt = 1e-3 * simulation.misalignment_mrad
    scale = predicted_table_scale(
        simulation.scale_change_ppm / PPM, simulation.two_pi_error, gated=settings.gyro.gated_resets
    )
    truth = {
        # about the table's axis, which the gyro's axis is tilted from
        "scale_factor_counts_per_dps": scale * settings.nominal_scale_factor * math.cos(tilt),
        TWO_PI_ERROR_PPM.key(): PPM * simulation.two_pi_error,
        "bias_dph": simulation.bias_dph,
        "angle_random_walk_deg_per_sqrt_h": simulation.angle_random_walk,
        "threshold_dps": simulation.dead_zone_dps,
        "dead_zone_dps": 2 * simulation.dead_zone_dps,
        "bias_repeatability_dph": simulation.switch_on_bias_dph,
        "turn_on_transient_dph": simulation.warm_up_bias_dph,
        "bias_dph_per_k_per_min": simulation.bias_dph_per_k_per_min,
    }
    return {"truth": truth}


def not_taken(run: SavedRun) -> list[Excluded]:
    """Return what was not taken at all."""
    return [Excluded(name, reason) for name, reason in run.facts.left_out_of_plan.items()]


def with_link_remarks(result: Callable[[Any, SavedRun, FogSettings], Result]) -> Callable[..., Result]:
    """Add to the result of a measurement what its segments say of the gyro's clock and of the frame format."""

    def told(found: Any, run: SavedRun, settings: FogSettings) -> Result:
        made = result(found, run, settings)
        segments = _all_segments(run)
        doubts = tuple(dict.fromkeys(f"{doubt}." for one in segments for doubt in one.recording.doubts))
        doubts += _unseen_digits(segments)
        made = replace(made, to_watch=made.to_watch + doubts, flags=made.flags + doubts)
        logs = {str(one.conditions["source"]): one.recording for one in segments if "source" in one.conditions}
        for log, recording in logs.items():
            if rows := list(recording.losses.reasons):
                lost = Excluded(f"part of {log}", f"{len(rows)} row{'s' * (len(rows) > 1)}: {'; '.join(rows[:3])}")
                document = {**made.document, "rows_left_out": made.document.get("rows_left_out", {}) | {log: rows}}
                made = replace(made, left_out=(*made.left_out, lost), document=document)
        clock = clock_of(segments)
        if clock is None:
            return made
        document = {
            "difference_ppm": clock.difference_ppm,
            "difference_u_ppm": clock.u_ppm,
            "output_rate_hz": clock.output_rate_hz,
            "used": clock.used,
        }
        return replace(
            made,
            sentences=(*made.sentences, *_clock_sentences(clock, segments)),
            document={**made.document, "gyro_clock": document},
        )

    return told


def _unseen_digits(segments: Sequence[Segment]) -> tuple[str, ...]:
    """Say how many outputs may hold a changed digit that nothing shows, where they may matter to a mean."""
    losses = [one.recording.losses for one in segments]
    moved = max((_HIDDEN * one.unseen_digits / math.sqrt(max(one.good, 1)) for one in losses), default=0.0)
    if moved < _NOTICEABLE:
        return ()
    unseen, good = sum(one.unseen_digits for one in losses), sum(one.good for one in losses)
    return (
        f"In about {unseen:.0f} of {good} outputs a digit was changed on the line and nothing shows which: the "
        f"text has no checksum. They move a mean by {moved:.2g} of its noise at most, if all to one side; mend "
        "the line, or let the gyro send a checksum.",
    )


def clock_of(segments: Sequence[Segment]) -> HostClock | None:
    """Return the gyro's clock beside the computer's over all segments, weighted; ``None`` if none says it."""
    clocks = [one.recording.host_clock for one in segments if one.recording.host_clock is not None]
    if not clocks:
        return None
    weights = np.array([one.interval_u_s**-2.0 for one in clocks])
    mean = float(weights @ [one.interval_s for one in clocks] / weights.sum())
    # the computer's clock is the same for all, so more segments do not make it better
    u = min(one.interval_u_s for one in clocks)
    return HostClock(clocks[0].stated_s, mean, u, any(one.used for one in clocks))


def angle_clock_u(segments: Sequence[Segment]) -> float:
    """Relative standard uncertainty of K that the clock gives where the output is an angle a frame; else 0."""
    each = []
    for one in segments:
        if one.conditions.get("output_unit") in ANGLE_UNITS:
            clock = one.recording.host_clock
            by_kind = HOST_CLOCK_U if one.recording.clock == "polls" else _UNKNOWN_CLOCK_U
            each.append(by_kind if clock is None else clock.u_ppm / PPM)
    return float(np.sqrt(np.mean(np.square(each)))) if each else 0.0


def _all_segments(run: SavedRun) -> list[Segment]:
    purposes = dict.fromkeys(record.purpose for record in run.records)
    return [segment for purpose in purposes for segment in segments_of(run, purpose)]


def _clock_sentences(clock: HostClock, segments: Sequence[Segment]) -> tuple[str, ...]:
    """Say how the gyro's clock differs, what was done, and what it does to K."""
    angle = any(one.conditions.get("output_unit") in ANGLE_UNITS for one in segments)
    rate = with_uncertainty(clock.output_rate_hz, clock.u_ppm / PPM * clock.output_rate_hz, "Hz")
    if not clock.used:
        return ()
    said = (
        f"The gyro sends {rate} by the computer's clock, {clock} from the stated {1 / clock.stated_s:g} Hz: "
        "times, whole turns and noise follow the computer's clock."
    )
    if angle:
        return said, "The output is an angle a frame, so K rests on that rate; its uncertainty is in that of K."
    return said, "K in counts per deg/s is a mean over words and does not depend on their rate."


def reasons_of(left_out: Sequence[Excluded], before: str = ": ") -> str:
    """Return why something is left out, to follow the text of an error; empty if nothing is."""
    reasons = "; ".join(one.sentence for one in left_out)
    return f"{before}{reasons}" if reasons else ""


def small_ppm(value: float) -> str:
    """Write a change in ppm that may be too small to matter."""
    return f"{value:+.2g} ppm" if abs(value) >= 0.01 else "less than 0.01 ppm"


PLAUSIBLE = 0.05
"""Share by which a scale factor may differ from that by design before something else must be wrong."""


UNLIKE = 0.6  # share from which on a gyro that nobody described is another one than the shipped


def far_from_design(scale_factor: float, settings: FogSettings) -> str:
    """A sentence where a scale factor cannot be that of the gyro by its design; empty where it can."""
    design = settings.nominal_scale_factor
    off = scale_factor / design - 1
    described = settings.gyro_is_described or abs(off) < UNLIKE
    if abs(off) <= PLAUSIBLE or (off > -1 and not described):
        return ""
    sign = "its sign is that of the opposite sense: " if off < -1 else ""
    return (
        f"K = {scale_factor:.6g} {COUNTS_PER_DPS} is {100 * off:+.3g} % off the {design:.6g} by design; {sign}"
        "look at senses and order of the rates, unit and width of the words, and gyro.* of the settings."
    )


def beyond_converter(step_codes: float, dac_bits: int) -> str:
    """Say that a step is beyond the converter."""
    return (
        f"a step of {step_codes:+.6g} codes is beyond the {dac_bits}-bit converter, which takes "
        f"{largest_step(dac_bits):.0f} (half of its range): choose a smaller rate"
    )


def gyro_table(settings: FogSettings) -> FactTable:
    """Return the gyro by design, for the facts of a report."""
    gyro, coil = settings.gyro, settings.coil
    rows = [
        ("fibre, coil", f"{gyro.coil_length_m:g} m, mean diameter {1e3 * gyro.coil_diameter_m:g} mm"),
        ("wavelength", f"{gyro.wavelength_um:g} µm"),
        ("transit time", f"{1e6 * coil.transit_time:.4f} µs, bias at {1e-3 * coil.proper_frequency:.3f} kHz"),
        ("converter", f"{gyro.dac_bits} bits, {gyro.fraction_bits} fractional bits below"),
        ("nominal scale factor", f"{settings.nominal_scale_factor:.6f} {COUNTS_PER_DPS}"),
        ("one code", f"{3600 * gyro.counts_per_code / settings.nominal_scale_factor:.4g} deg/h"),
        ("samples with a reset", "left out of the integrator" if gyro.gated_resets else "used"),
        ("fringe limit", f"{coil.fringe_limit_dps:.1f} deg/s"),
    ]
    return FactTable("Gyro by design", rows)


def output_facts(found: object, run: SavedRun, settings: FogSettings) -> list[FactTable]:
    """Return how the gyro's output was taken, for the facts of a report."""
    return [gyro_table(settings), FactTable("Conditions", _condition_rows(run, settings))]


def _condition_rows(run: SavedRun, settings: FogSettings) -> Rows:
    segments = _all_segments(run)
    losses = [segment.recording.losses for segment in segments]
    clocks = sorted({segment.recording.clock for segment in segments})
    models = sorted({str(one.conditions["model"]) for one in segments if "model" in one.conditions})
    rows = [
        ("output from", ", ".join(run.facts.sources) or settings.link.port or "simulated gyro"),
        ("segments", f"{len(segments)}, {sum(s.recording.duration_s for s in segments):.0f} s of output"),
        ("frames", f"{sum(one.good for one in losses)} used, {sum(one.missing for one in losses)} missing"),
        ("clock", ", ".join(clocks)),
        ("latitude", f"{settings.site.latitude_deg:g}°"),
    ]
    if (host := clock_of(segments)) is not None:
        rows.append(("gyro's clock against the computer's", str(host)))
    if models:
        rows.append(("simulation", ", ".join(_SIMULATED_BY[model] for model in models)))
    if any(segment.conditions.get("acknowledged") is False for segment in segments):
        rows.append(("commands", "sent once and not acknowledged: nothing proves that they arrived"))
    return rows


def staircase_section(settings: FogSettings, open_loop_step: float | None = None) -> Section:
    """Return staircase and detector signal over a few resets, computed from the design."""
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
    figure = PlacedFigure(_staircase_svg(trace, coil.transit_time), f"{caption} Dashed: 2π resets.")
    text = "Computed at every transit time from the design and, in a simulation, its errors; without noise."
    return Section("Staircase and detector signal", text, figures=(figure,))


def _staircase_svg(trace: LoopTrace, interval_s: float) -> str:
    """Draw the staircase, the phase difference and the detector signal over a few resets."""

    def draw(figure: Figure) -> None:
        top, middle, bottom = figure.subplots(3, 1, sharex=True)
        begin = 1e6 * (trace.times_s - trace.times_s[0])
        for axes, values, colour, label in (
            (top, trace.staircase, ACCENT, "staircase,\ncodes"),
            (middle, trace.difference_rad / np.pi, THIRD, "phase difference,\nπ"),
            (bottom, trace.intensity, SECOND, "intensity,\npart of peak"),
        ):
            axes.step(begin, values, where="post", color=colour, linewidth=0.9)
            axes.set_ylabel(label)
            axes.ticklabel_format(axis="y", useOffset=False)
            for at in begin[trace.reset]:
                axes.axvline(at, color=SOFT, linewidth=0.6, linestyle=(0, (3, 3)), zorder=0)
        bottom.set_xlabel(f"time, µs (one sample every {1e6 * interval_s:.3f} µs)")
        bottom.set_xlim(0, begin[-1])

    return svg_element("staircase", _TALL, draw)
