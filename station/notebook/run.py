"""Opening what was saved: a run of any measurement, or files of an oscilloscope seen as one."""

import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from analysis import LockInEstimate
from instrument import Preamble, Waveform
from station.datasets.data_set import Exported, check_target, export as write, names_of, whole
from station.errors import EXIT_NO_SIGNAL, Failure, NoUsableSignal, UsageError
from station.fibre_gyro.segments import segments_of
from station.live.events import Progress
from station.lock_in.evaluate import LockInEvaluation
from station.notebook.result import Record, Result, RunRecords
from station.reanalysis.combine import AnalyzedFiles, analyze_file, combine
from station.ring_laser.records import saved_waveform
from station.runs.annotations import Remarks, add_remark, read_remarks
from station.runs.store import SavedRecord, SavedRun, open_run as read_run
from station.shell.finish import Evaluated, evaluate_run, kind_of
from station.sources import Source, find_sources, open_source
from station.sources.batches import check_over_time
from station.sources.workers import ThisProcess

PathLike = str | os.PathLike[str]


class Run(RunRecords):
    """Records, and what they say. Made by :func:`open_run` and :func:`read`."""

    def evaluated(self, config: PathLike | None = None, **choices: Any) -> Evaluated | AnalyzedFiles:
        """Evaluate the records; arguments as for :meth:`result`."""
        raise NotImplementedError

    def result(self, config: PathLike | None = None, **choices: Any) -> Result:
        """Return what the records say; always computed again from the raw codes.

        Parameters
        ----------
        config : path, optional
            Settings file: what is known of the bench, and the limits, are taken from it.
        **choices
            As the options of ``gyrolock analyze``: ``scale_factor``, ``input_rate``, ``relation``.

        Raises
        ------
        StationError
            The records cannot be evaluated. Those that are only of no use give a result with a `problem`.
        """
        evaluated = self.evaluated(config, **choices)
        return Result(evaluated, self, with_problem(evaluated.document(), evaluated.result.problem))

    @cached_property
    def estimates(self) -> LockInEstimate:
        """What each record says alone, arrays of shape (n,); UsageError where that is no lock-in rate."""
        found = self.evaluated().found
        if not isinstance(found, LockInEvaluation):
            raise UsageError(f"{self.path}: is a run of `{self.command}`: its records give no lock-in rate each")
        return found.each


class TakenRun(Run):
    """A saved run: the records that its measurement is of; others by their purpose."""

    def __init__(self, saved: SavedRun, method: Mapping[str, Any] | None = None) -> None:
        self._saved, facts, kind, self._method = saved, saved.facts, kind_of(saved), dict(method or {})
        self.purposes = tuple(dict.fromkeys(record.purpose for record in saved.records))
        own = [facts.command] if facts.command in self.purposes else self.purposes
        if kind.declared:  # the answer of a program is no record of an instrument
            own = ()
        records: list[Record] = []
        damaged: list[str] = []
        for purpose in own:
            intact = self.taken_for(purpose)
            records += intact
            there = {record.name for record in intact}
            damaged += [name for name in _names(saved, purpose) if name not in there]
        super().__init__(
            records, saved.path, kind.command, facts.settings, facts.outcome_text, facts.labels, damaged
        )

    def taken_for(self, purpose: str) -> tuple[Record, ...]:
        """Return the intact records of one of the `purposes`: ``"tilt"``, ``"quadrature"``, ``"table"``..."""
        taken = self._saved.taken_for(purpose)
        if any(_is_output(record.header) for record in taken):
            data: Iterable[Any] = (segment.recording for segment in segments_of(self._saved, purpose))
        else:
            data = (saved_waveform(record, self._saved.path) if record.intact else None for record in taken)
        return tuple(
            Record(name, record.conditions, one, purpose, record.taken_at)
            for name, record, one in zip(_names(self._saved, purpose), taken, data, strict=True)
            if record.intact
        )

    def evaluated(self, config: PathLike | None = None, **choices: Any) -> Evaluated:
        """Evaluate the run; arguments as for :meth:`result`."""
        chosen = {**self._method, **choices}
        return evaluate_run(self._saved, config=None if config is None else Path(config), choices=chosen)

    @property
    def remarks(self) -> Remarks:
        """What was said of it afterwards: `mark`, `tags`, `notes`."""
        return read_remarks(self.path)

    def annotate(
        self,
        note: str = "",
        *,
        tags: Sequence[str] = (),
        untagged: Sequence[str] = (),
        mark: str | None = "",
        by: str = "",
    ) -> Remarks:
        """Say something of the run, beside it: the measurement stays as it is."""
        add_remark(self.path, note=note, tags=tags, untagged=untagged, mark=mark, by=by)
        return self.remarks


class FileRun(Run):
    """Files of an oscilloscope as records at one rate."""

    def __init__(
        self, path: Path, sources: Sequence[Source], channel: str | None, method: Mapping[str, Any]
    ) -> None:
        self._method = dict(method)
        self._sources: list[Path | Source] = []
        records, damaged = [], []
        for source in sources:
            for record in source.records():
                if not record.intact:
                    damaged.append(source.name)
                    continue
                waveform = waveform_of(record)
                taken_from = waveform.preamble.wfid.split(",")[0].upper()
                if channel is None or taken_from == channel.upper():
                    records.append(Record(source.name, {"channel": taken_from}, waveform))
                    self._sources.append(source)
        if not records:
            raise UsageError(f"{path}: none of {len(sources)} files is of {channel}")
        outcome = f"{len(records)} files"
        super().__init__(records, path, "gyrolock analyze", {}, outcome, damaged=damaged)

    def evaluated(self, config: PathLike | None = None, **choices: Any) -> AnalyzedFiles:
        """Evaluate the files; arguments as for :meth:`result`."""
        given = {name: one for name, one in {**self._method, **choices}.items() if one is not None}
        if config is not None:
            raise UsageError("files have no settings that others could take the place of")
        if "scale_factor" not in given:
            raise UsageError(
                f"{self.path}: files do not know the gyro's pulses per degree: give scale_factor to gyrolock.read"
            )
        if len(sources := dict.fromkeys(record.conditions["channel"] for record in self.records)) > 1:
            # two inputs of one acquisition are not two records: their mean would seem better than it is
            raise UsageError(
                f"{self.path}: files of {', '.join(sources)}: give one of them as channel to gyrolock.read"
            )
        for record in self.records:
            check_over_time(record.waveform, record.name)
        if len(self._sources) == 1:
            return analyze_file(self._sources[0], None, given)
        return combine(self._sources, given, ThisProcess(), Progress())


def open_run(path: PathLike) -> TakenRun:
    """Open a run that any command has saved, finished or not, of this version or an earlier one.

    Parameters
    ----------
    path : path
        Its directory, or the SQLite file in it.

    Returns
    -------
    TakenRun
        Its records are those that the measurement is of, without damaged ones (`damaged` names them) and
        without what was set aside; `taken_for` gives the others, of the fast run for instance.

    Raises
    ------
    RunError
        There is no run, or it is one that this version does not know.
    """
    return TakenRun(read_run(Path(path)))


def read(
    paths: PathLike | Iterable[PathLike],
    *,
    scale_factor: float | None = None,
    channel: str | None = None,
    input_rate: float | None = None,
    relation: str | None = None,
    run: str | None = None,
) -> Run:
    """Read files of an oscilloscope and see them as a run: records at one rate; or what was exported.

    Parameters
    ----------
    paths : path or iterable of path
        Tektronix CSV or ISF files; a folder, such as a memory card, stands for all that are in it and below. A
        data set of `gyrolock export` (file, folder of parts, URL) is what was exported to it.
    scale_factor : float, optional
        Pulses per degree. Without it files give records, but no estimates.
    channel : str, optional
        Only files of this input: ``"CH1"``.
    input_rate : float, optional
        Rate on the gyro's axis, deg/s; without it each record is its own reference.
    relation : {"exact", "paper-13", "paper-10"}, optional
        Of ratio and rate.
    run : str, optional
        Name of one of several runs, or the end of it.

    Returns
    -------
    Run
        A `TakenRun` where a run was exported.

    Raises
    ------
    FileFormatError, RunError, OSError
        A file cannot be read.
    UsageError
        A folder holds no such file, none is of the channel, or there are several runs and none is named.
    """
    place, sources = _sources(paths)
    method = {"scale_factor": scale_factor, "input_rate": input_rate, "relation": relation}
    taken = [source for source in sources if source.is_run]
    if run is not None:
        sources = taken = [source for source in taken if _is_called(source.name, run)]
    if not taken and run is None:
        return FileRun(place, sources, channel, method)
    if len(taken) < len(sources):
        raise UsageError(f"{place}: holds runs and files: read them one by one ({names_of(sources)})")
    if len(taken) != 1:
        raise UsageError(
            f"{place}: holds {len(taken)} runs{f' called {run}' if run else ''}: name one as run, or take all by "
            f"gyrolock.read_runs ({names_of(taken or _sources(paths)[1])})"
        )
    return TakenRun(whole(taken[0]), method)


def read_runs(paths: PathLike | Iterable[PathLike]) -> list[TakenRun]:
    """Read all runs that paths hold: saved ones, folders of them, and data sets that they were exported to.

    Raises
    ------
    RunError, OSError
        One of them cannot be read.
    """
    return [TakenRun(whole(source)) for source in _sources(paths)[1] if source.is_run]


def waveform_of(record: SavedRecord) -> Waveform:
    """Return the record of an oscilloscope as a waveform."""
    preamble = Preamble.parse(record.header)
    if preamble.byt_nr == 1:
        return Waveform(record.codes, preamble)
    return Waveform(np.frombuffer(record.payload, ">i2").astype(np.int16), preamble)


def with_problem(document: dict[str, Any], problem: str) -> dict[str, Any]:
    """Return a document as the command prints it: with ``error`` where the records give no result."""
    if not problem:
        return document
    return document | {"error": Failure(NoUsableSignal.kind, problem, EXIT_NO_SIGNAL).as_json()}


def _sources(paths: PathLike | Iterable[PathLike]) -> tuple[Path, list[Source]]:
    """What paths hold, and where all of it lies."""
    given = [os.fspath(one) for one in ([paths] if isinstance(paths, str | os.PathLike) else paths)]
    found = [open_source(one) for one in find_sources(given)]
    if not found:
        raise UsageError("no file was given to read")
    if len(given) == 1:
        return Path(given[0]), found
    return Path(os.path.commonpath([os.path.abspath(path) for path in given])), found


def _is_called(name: str, wanted: str) -> bool:
    """Whether a run is meant by its name, its folder, or the end of them."""
    path = Path(name)
    ends = [path.parts, path.parent.parts]
    return any(parts[-len(Path(wanted).parts) :] == Path(wanted).parts for parts in ends)


def _names(saved: SavedRun, purpose: str) -> list[str]:
    """What the results call the records of one purpose: a stretch by its key, an oscilloscope's by its number."""
    taken = saved.taken_for(purpose)
    return [record.key if _is_output(record.header) else str(n) for n, record in enumerate(taken, start=1)]


def _is_output(header: str) -> bool:
    """Whether a record is a stretch of a gyro's output: its columns are described in JSON."""
    return header.startswith("{")


# --------------------
# Export as a call


def export(paths: PathLike | Iterable[PathLike], to: PathLike, *, replace: bool = False) -> Exported:
    """Write the records of runs and files to a data set, as the command ``gyrolock export`` does.

    Parameters
    ----------
    paths : path or iterable of path
        Runs, files of an oscilloscope, data sets, folders of them; a `Run` of :func:`open_run` is one too.
    to : path
        Its ending says the format: ``.parquet``, ``.h5``, ``.npz``, ``.csv``; with ``/`` at its end a folder of
        Parquet parts.
    replace : bool, optional
        Overwrite existing files.

    Returns
    -------
    Exported
        Files, number of records and sources, and what was left out: a warning names that too.

    Raises
    ------
    UsageError, CannotWrite
        It cannot be written there, or there is no record.
    """
    target = os.fspath(to)
    check_target(target, replace=replace)
    given = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    found = find_sources([os.fspath(one) for one in given])
    done = write((open_source(one) for one in found), target)
    for one in done.left_out:
        warnings.warn(f"left out: {one}", RuntimeWarning, stacklevel=2)
    return done
