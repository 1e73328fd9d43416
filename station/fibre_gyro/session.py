"""One run of a test from beginning to end: begun or resumed, on the bench or from logs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from analysis.fibre_gyro import InjectionPlan, predicted_table_scale
from station.errors import UsageError
from station.fibre_gyro.campaign import Campaign, Plan, PlannedSegment, take_segments
from station.fibre_gyro.eps import measurement as eps
from station.fibre_gyro.figures import measurement as figures
from station.fibre_gyro.logs import read_logs
from station.fibre_gyro.segments import unusable
from station.fibre_gyro.selfcal import measurement as selfcal
from station.fibre_gyro.serial_bench import open_fog_bench
from station.fibre_gyro.settings import FogSettings, fog_settings_from
from station.fibre_gyro.store import FogRun, FogRunWriter, open_fog_run
from station.fibre_gyro.table import measurement as table
from station.provenance import provenance
from station.runs.database import utc_now
from station.runs.progress import Progress

_PPM = 1e6


def start_run(
    command: str, settings: FogSettings, progress: Progress, *, table_run: Path | None = None
) -> Campaign:
    """Take a new run on the bench.

    Parameters
    ----------
    command : {"table", "selfcal", "eps", "figures"}
    settings : FogSettings
    progress : Progress
    table_run : Path, optional
        For a self-calibration: the rate-table run that gives the numbers and the K to compare with.

    Raises
    ------
    InstrumentError, StationError
        The bench cannot be opened, the run cannot be written, or what is wanted cannot be done.
    """
    facts = _facts(command, settings)
    if command == selfcal.PURPOSE:
        facts |= _facts_of_table(settings, table_run)
    if command == table.PURPOSE:
        for fault in table.fixed_window_faults(settings, 1 / settings.simulation.output_rate_hz):
            progress.note(f"will be left out: {fault}")
    with open_fog_bench(settings) as bench:
        writer = FogRunWriter.create(Path(settings.output.directory), facts)
        progress.note(f"{settings.gyro.name} ({settings.link.port or 'simulated'}), run {writer.path}")
        return take_segments(writer, bench, _stages(command, settings, writer), progress)


def resume_run(command: str, path: Path, progress: Progress) -> Campaign:
    """Go on with a run that was cut short, with the settings that are saved with it; errors as "
    ":func:`start_run`."""
    run = open_fog_run(path)
    if run.facts.get("command") != command:
        raise UsageError(f"{path}: is a run of `gyrolock fog {run.facts.get('command')}`: resume it with that")
    if run.facts.get("logs"):
        raise UsageError(f"{path}: was made from saved logs, there is nothing to resume")
    settings = fog_settings_from(run.facts["settings"], str(run.path))
    with open_fog_bench(settings) as bench:
        writer = FogRunWriter.resume(run.path)
        writer.save_facts({"resumed_at": [*run.facts.get("resumed_at", []), utc_now()]})
        for segment in run.taken_for(table.PURPOSE) + (run.taken_for(command) if command != table.PURPOSE else ()):
            if reason := unusable(segment, settings.table.rate_tolerance_ppm):
                progress.note(f"{segment.key} is taken again: {reason}")
                writer.set_aside(segment.key)
        return take_segments(writer, bench, _stages(command, settings, writer), progress)


def saved_run_of(command: str, path: Path) -> Path:
    """Return the file of a saved run of one test.

    Raises
    ------
    RunError
        There is none.
    UsageError
        It is the run of another test.
    """
    run = open_fog_run(path)
    if run.facts.get("command") != command:
        raise UsageError(f"{path}: is a run of `gyrolock fog {run.facts.get('command')}`, not of {command}")
    return run.path


def run_from_logs(
    command: str,
    settings: FogSettings,
    lists: Sequence[Path],
    progress: Progress,
    *,
    table_run: Path | None = None,
) -> Campaign:
    """Make a run of saved logs; errors as :func:`start_run`."""
    facts = {**_facts(command, settings), "logs": [str(path) for path in lists], "simulated": False}
    facts.pop("truth", None)
    if command == selfcal.PURPOSE and table_run is not None:
        facts |= _facts_of_table(settings, table_run)
    logs = read_logs(lists, command, settings)
    with FogRunWriter.create(Path(settings.output.directory), facts) as writer:
        progress.start("logs", len(logs))
        for key, conditions, recording in logs:
            writer.save_segment(key, conditions, recording)
            progress.advance()
        writer.save_facts({"ended_at": utc_now(), "outcome": "complete"})
    progress.close()
    return Campaign(writer.path, None)


def _facts(command: str, settings: FogSettings) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "command": command,
        "settings": settings.model_dump(mode="json"),
        "simulated": settings.simulated,
        "provenance": provenance(),
    }
    if settings.simulated:
        facts["truth"] = _truth(settings)
    return facts


def _truth(settings: FogSettings) -> dict[str, float]:
    """What a simulated run should find."""
    simulation = settings.simulation
    tilt = 1e-3 * simulation.misalignment_mrad
    scale = predicted_table_scale(
        simulation.scale_change_ppm / _PPM, simulation.two_pi_error, gated=settings.gyro.gated_resets
    )
    return {
        # about the table's axis, which the gyro's axis is tilted from
        "scale_factor_counts_per_dps": scale * settings.nominal_scale_factor * math.cos(tilt),
        "two_pi_error_ppm": _PPM * simulation.two_pi_error,
        "bias_dph": simulation.bias_dph,
        "angle_random_walk_deg_per_sqrt_h": simulation.angle_random_walk,
    }


def _facts_of_table(settings: FogSettings, table_run: Path | None) -> dict[str, Any]:
    """Numbers and reference from a saved table run; nothing where the run makes its own or needs none."""
    if table_run is None:
        if not settings.simulated:
            selfcal.numbers_for(settings, None)  # says what is missing before anything moves
        return {}
    run = open_fog_run(table_run)
    saved = fog_settings_from(run.facts.get("settings", {}), str(run.path))
    found = table.evaluate_table(run, saved).of(settings.selfcal.axis)
    if found is None:
        raise UsageError(f"{table_run}: gives no scale factor of axis {settings.selfcal.axis} (selfcal.axis)")
    source = f"rate-table run {run.path.parent.name}, axis {found.axis}"
    reference = selfcal.TableReference(found.fit.scale_factor, found.fit.scale_factor_u, source)
    numbers = selfcal.numbers_for(settings, found)
    saved_numbers = {
        name: getattr(numbers, name).tolist() for name in ("rate_dps", "number", "number_u", "multiples")
    }
    return {"table_reference": asdict(reference), "numbers": saved_numbers}


def _stages(command: str, settings: FogSettings, writer: FogRunWriter) -> list[Plan]:
    if command == table.PURPOSE:
        return [lambda run: table.plan_table(settings)]
    if command == figures.PURPOSE:
        return [lambda run: figures.plan_figures(settings)]
    if command == eps.PURPOSE:
        return [lambda run: _noting(writer, *eps.plan_eps(settings))]
    return [lambda run: _own_table(run, settings), lambda run: _injections(run, settings, writer)]


def _own_table(run: FogRun, settings: FogSettings) -> list[PlannedSegment]:
    """A simulated self-calibration without a table run makes its own first."""
    if "table_reference" in run.facts or not settings.simulated:
        return []
    return table.plan_table(settings, [settings.selfcal.axis])


def _injections(run: FogRun, settings: FogSettings, writer: FogRunWriter) -> list[PlannedSegment]:
    if (saved := run.facts.get("numbers")) is not None:
        arrays = {name: np.array(values, dtype=np.float64) for name, values in saved.items()}
        numbers = InjectionPlan(**arrays)
    else:
        own = table.evaluate_table(run, settings).of(settings.selfcal.axis)
        numbers = selfcal.numbers_for(settings, own)
    return _noting(writer, *selfcal.plan_selfcal(settings, numbers))


def _noting(writer: FogRunWriter, plan: list[PlannedSegment], left_out: list[Any]) -> list[PlannedSegment]:
    """Save what the plan leaves out, so that the result names it."""
    writer.save_facts({"left_out_of_plan": [one.as_json() for one in left_out]})
    return plan
