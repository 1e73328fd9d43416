"""A measurement, the test of a unit, and the list of runs, as calls."""

from __future__ import annotations

import inspect
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.campaign.conduct import conduct
from station.campaign.file import read_campaign
from station.campaign.journal import CampaignOutcome, CampaignPlan
from station.campaign.record import RecordCheck, RecordFiles, verify, write_record
from station.catalogue import Entry, RunFilter, chosen, list_runs, runs_table
from station.errors import UsageError
from station.measurements import measurement
from station.notebook.result import Result, data_frame, html_table
from station.notebook.run import TakenRun, open_run, with_problem
from station.results.verdict import Limit, LimitOutcome, Verdict
from station.runs.signals import ending_signals
from station.settings import load, merged
from station.shell.finish import evaluate_run, keep, resume_run, run_as_it_ends, save_outcome, start_run
from station.shell.options import overrides, shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


# --------------------
# An unattended test station as a call: for scripts, and for test frameworks of others


PathLike = str | os.PathLike[str]


class Station:
    """A bench and the campaign that units are tested by. The same as the command ``gyrolock station``.

    Parameters
    ----------
    campaign : path
        TOML file.
    quiet : bool, optional
        Show no progress on stderr.

    Examples
    --------
    ::

        station = gyrolock.Station("campaign.toml")
        tested = station.test("RLG-001", operator="B. Bauer")
        tested.verdict, tested.exit_code, tested.files.json
    """

    def __init__(self, campaign: PathLike, *, quiet: bool = False) -> None:
        self.campaign, self._quiet = Path(campaign), quiet

    def plan(self, unit: str) -> CampaignPlan:
        """Return what would be done with a unit; SettingsError names every mistake of the file."""
        return read_campaign(self.campaign, unit)

    def limits(self, unit: str) -> dict[str, Limit]:
        """Return the limits that a unit has to keep to: by the key of the step and the name of the number."""
        return {f"{step.key}: {limit.number}": limit for step in self.plan(unit).steps for limit in step.limits}

    def test(self, unit: str, *, operator: str = "", note: str = "", resume: PathLike | None = None) -> TestedUnit:
        """Test one unit, and write the record of the test beside its runs.

        Parameters
        ----------
        unit : str
            Serial number.
        resume : path, optional
            Folder of a test that was cut short: it goes on.

        Returns
        -------
        TestedUnit
            Also when the bench has failed or the test was stopped: `verdict` says so.

        Raises
        ------
        SettingsError, StationError
            The test cannot begin, or its record cannot be written.
        """
        plan = self.plan(unit)
        about = {"unit": unit, "operator": operator or None, "note": note or None}
        with ending_signals(second_ends=False), shown({"quiet": self._quiet}, "station", **about) as progress:
            before = None if resume is None else Path(resume)
            outcome = conduct(plan, progress, operator=operator, note=note, resumed=before)
            files = write_record(outcome)
            progress.end(outcome.exit_code, outcome.message)
        return TestedUnit(outcome, files)

    def __repr__(self) -> str:
        return f"<Station of {self.campaign}>"


class TestedUnit:
    """How the test of a unit has ended."""

    __test__ = False  # pytest takes whatever begins with Test for one of its own

    def __init__(self, outcome: CampaignOutcome, files: RecordFiles) -> None:
        self.outcome, self.files = outcome, files

    @property
    def verdict(self) -> Verdict | None:
        """``"PASS"``, ``"MARGINAL"``, ``"FAIL"``, ``"ERROR"``, ``"ABORTED"``; ``None`` without limits."""
        return self.outcome.verdict

    @property
    def exit_code(self) -> int:
        """What the command would have ended with."""
        return self.outcome.exit_code

    @property
    def message(self) -> str:
        """In one line why; empty for PASS."""
        return self.outcome.message

    @property
    def limits(self) -> dict[str, LimitOutcome]:
        """Every number against its limit: by the key of the step and the name of the number."""
        return {f"{step.step.key}: {one.name}": one for step in self.outcome.steps for one in step.limits}

    @property
    def record(self) -> Mapping[str, Any]:
        """The record of the test as JSON."""
        return self.files.document

    def verify(self) -> list[RecordCheck]:
        """Prove that record and raw runs belong together, and compute the result again."""
        return verify(self.files.json)

    def __repr__(self) -> str:
        why = f": {self.message}" if self.message else ""
        return f"<TestedUnit {self.outcome.plan.unit}: {self.verdict or 'measured'}{why}>"

    def _repr_html_(self) -> str:
        rows = [(name, one.sentence) for name, one in self.limits.items()]
        return html_table(f"{self.outcome.plan.unit}: {self.verdict or 'measured'}", rows)


# --------------------
# The list of all runs below a folder, for a notebook


_SHOWN = 50


class Runs(Sequence[Entry]):
    """Runs, each as what is known of it without opening a record. Made by :func:`runs`.

    Parameters
    ----------
    entries : sequence of Entry
    directory : Path
    """

    def __init__(self, entries: Sequence[Entry], directory: Path) -> None:
        self.entries, self.directory = tuple(entries), directory

    def __getitem__(self, place: Any) -> Any:
        return Runs(self.entries[place], self.directory) if isinstance(place, slice) else self.entries[place]

    def __len__(self) -> int:
        return len(self.entries)

    def open(self) -> Iterator[TakenRun]:
        """Open one after the other."""
        return (open_run(entry.run) for entry in self.entries)

    def to_dataframe(self) -> Any:
        """Return a pandas.DataFrame, one row for each value of a result; ImportError without pandas."""
        rows = []
        for entry in self.entries:
            known = {name: value for name, value in vars(entry).items() if name not in ("values", "remarks")}
            values = [
                {"result_name": one.name, "result_of": one.of, "result": one.value, "result_u": one.u}
                for one in entry.values
            ]
            rows += [{**known, **value} for value in values or [{}]]
        return data_frame(rows)

    def plot(self) -> Figure:
        """Draw the results over time, each unit in its own colour."""
        from station.notebook.plots import draw_runs  # half a second of Matplotlib

        return draw_runs(self.entries)

    def __repr__(self) -> str:
        return f"<{len(self)} runs in {self.directory}>"

    def _repr_html_(self) -> str:
        table = runs_table(self.entries[-_SHOWN:], self.directory)
        head = "".join(f"<th>{escape(name)}</th>" for name in table.header)
        rows = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in table.rows)
        more = f", the last {_SHOWN}" if len(self) > _SHOWN else ""
        return f"<table><caption>{len(self)} runs{more}</caption><tr>{head}</tr>{rows}</table>"


def runs(directory: str | os.PathLike[str] = "runs", *, sort: Sequence[str] = (), **wanted: Any) -> Runs:
    """List all runs below a folder, as the command ``gyrolock runs`` does: fast, and without opening a record.

    Parameters
    ----------
    directory : path, optional
    sort : sequence of str, optional
        ``"when"``, ``"unit"``, ``"result"``, ...; ``"-when"``: the newest first.
    **wanted
        As the options of the command: ``unit``, ``command``, ``operator``, ``gyro``, ``verdict``, ``mark``,
        ``tags``, ``text``, ``since``, ``until``.

    Raises
    ------
    UsageError
        There is no such folder, or no such order.
    """
    tags = wanted.pop("tags", ())
    asked = RunFilter(**wanted, tags=(tags,) if isinstance(tags, str) else tuple(tags))
    return Runs(chosen(list_runs(Path(directory)), asked, sort), Path(directory))
