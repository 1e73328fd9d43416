"""The main job as a call."""

from __future__ import annotations

import inspect
import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from station.display.opening import shown
from station.errors import UsageError
from station.measurements import measurement
from station.notebook.result import Result
from station.notebook.run import open_run, with_problem
from station.runs.stop import ending_signals
from station.settings.load import load
from station.settings.toml_files import merged
from station.shell.ending import keep, run_as_it_ends, save_outcome
from station.shell.evaluated import evaluate_run
from station.shell.options import overrides
from station.shell.running import resume_run, start_run

_PLACES = {
    "resource": "scope.resource",
    "scale_factor": "gyro.scale_factor_pulses_per_deg",
    "rates": "measurement.rates_over_lock_in",
    "records": "measurement.records",
    "channel": "scope.channel",
    "seed": "simulation.seed",
    "out": "output.directory",
}


def measure(
    settings: str | os.PathLike[str] | Mapping[str, Mapping[str, object]] | None = None,
    *,
    resource: str | None = None,
    scale_factor: float | None = None,
    rates: float | Sequence[float] | str | None = None,
    records: int | None = None,
    channel: str | None = None,
    seed: int | None = None,
    out: str | os.PathLike[str] | None = None,
    unit: str | None = None,
    operator: str | None = None,
    note: str | None = None,
    resume: str | os.PathLike[str] | None = None,
    report: bool = True,
    quiet: bool = False,
    **sections: Any,
) -> Result:
    """Measure the lock-in rate: acquire, save, analyse, report. The same as the command ``gyrolock measure``.

    Parameters
    ----------
    settings : path or mapping, optional
        TOML file, or its content as mappings of mappings; only what differs from the defaults.
    resource : str, optional
        VISA name of the oscilloscope; without one, here or in the settings, the bench is simulated.
    scale_factor : float, optional
        Pulses per degree; with a resource it must be given, here or in the settings.
    rates : float, sequence of float or "auto", optional
        One rate or several in expected lock-in rates, or those that the program chooses.
    records, channel, seed, out, unit, operator, note : optional
        As the options of the command.
    resume : path, optional
        A run that was cut short: it goes on.
    report : bool, optional
        Write ``report.html`` beside the run.
    quiet : bool, optional
        Show no progress on stderr.
    **sections : mapping
        Single settings by section; they win over `settings`: ``measurement={"both_senses": True}``.

    Returns
    -------
    Result
        Where the records give no lock-in rate its value is ``None`` and `Result.problem` says why.

    Raises
    ------
    SettingsError, UsageError
        Before anything moves; every mistake in one text.
    InstrumentError, NoUsableSignal, KeyboardInterrupt, ...
        What stopped the measurement. The records so far are kept; a note on the error says where.
    """
    for name, section in sections.items():
        if not isinstance(section, Mapping):
            options = [option for option in inspect.signature(measure).parameters if option != "sections"]
            raise UsageError(f"gyrolock.measure has no option {name!r}; it has {', '.join(options)}")
    directory = None if out is None else Path(out)
    given = {
        "resource": resource,
        "scale_factor": scale_factor,
        "rates": [rates] if isinstance(rates, int | float) else rates,
        "records": records,
        "channel": channel,
        "seed": seed,
        "out": directory,
    }
    named = {label: text for label, text in {"unit": unit, "operator": operator, "note": note}.items() if text}
    chosen = merged(merged({}, sections), overrides(given, _PLACES))
    config = None
    if isinstance(settings, Mapping):
        chosen = merged(settings, chosen)
    elif settings is not None:
        config = Path(settings)
    kind = measurement("measure")
    # a notebook's kernel lives on
    with ending_signals(second_ends=False), shown({"quiet": quiet}, "measure", **named) as progress:
        if resume is not None:
            taken = resume_run(Path(resume), progress, kind=kind, config=config, overrides=chosen, labels=named)
        else:
            wanted = load(kind.kind, config, chosen)
            if seed is not None and not kind.simulated(wanted):
                raise UsageError("seed belongs to a simulated bench; a real one has none")
            taken = start_run(kind, wanted, progress, labels=named)
    if taken.error is not None:
        where = taken.path.parent
        taken.error.add_note(
            f"The records so far are in {where}; gyrolock.measure(resume={str(where)!r}) goes on."
        )
        raise taken.error
    evaluated = evaluate_run(run_as_it_ends(taken))
    document, lost = keep(evaluated, report=report)
    if lost := save_outcome(evaluated.run, lost) or lost:
        warnings.warn(lost.message, RuntimeWarning, stacklevel=2)
    return Result(evaluated, open_run(taken.path), with_problem(document, evaluated.result.problem))
