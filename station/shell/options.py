"""From options to a run: options that commands share, the display, a command that takes records."""

from __future__ import annotations

import difflib
import itertools
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from station.errors import EXIT_DEFECT, EXIT_OK, EXIT_USAGE, SettingsError, describe_failure
from station.files import version
from station.live.events import Acknowledgement, Events, Progress
from station.terminal import PRINTS_ALL, PRINTS_ONE_LINE, prints, remark, stepping_aside

if TYPE_CHECKING:
    from station.runs.acquisition import Taken

F = TypeVar("F", bound=Callable[..., Any])


class RunName(click.ParamType):  # type: ignore[type-arg]  # generic from click 8.2 on only
    """A run as a person names it: its path, ``last``, or the beginning of a name in ./runs that no other has."""

    name = "run"

    def __init__(self, kind: type[str] | type[Path]) -> None:
        self._kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Find the run; what is none of these is left to who opens it."""
        text = str(value)
        if text and not os.path.exists(text) and "/" not in text:
            names = sorted(one.name for one in Path("runs").glob("[!.]*") if one.is_dir())
            found = names[-1:] if text == "last" else [name for name in names if name.startswith(text)]
            if len(found) > 1:
                self.fail(f"{len(found)} runs begin with {text!r}, such as {found[-1]}", param, ctx)
            value = Path("runs", found[0]) if found else value
        return self._kind(value)


class ChannelName(click.Choice):  # type: ignore[type-arg]
    """``CH1``, ``ch1`` or ``1``."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Write it as the scope does."""
        return super().convert(f"CH{value}" if str(value).isdigit() else str(value).upper(), param, ctx)


RUN, RUN_PATH = RunName(str), RunName(Path)
CHANNELS = ChannelName(["CH1", "CH2", "CH3", "CH4"])


def positive(_: click.Context, __: click.Parameter, value: float | None) -> float | None:
    """Take an option only if it is a finite number above zero; a `callback` of ``click.option``."""
    if value is not None and not (math.isfinite(value) and value > 0):
        raise click.BadParameter(f"{value:g} is not a positive number")
    return value


def not_zero(_: click.Context, __: click.Parameter, value: float | None) -> float | None:
    """Take an option only if it is a finite number other than zero; a `callback` of ``click.option``."""
    if value is not None and not (math.isfinite(value) and value):
        raise click.BadParameter(f"{value:g} is not a finite number other than 0")
    return value


class SuggestingGroup(click.Group):
    """A group that says which command was perhaps meant; called alone it shows its help."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Take the options of the group; without a command show the help, as lines and not as an error."""
        if not args:
            click.echo(ctx.get_help())
            ctx.exit(EXIT_USAGE)
        return super().parse_args(ctx, args)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, or one that is spelled alike; none of its options is the value of another."""
        names = self.list_commands(ctx)
        if args and args[0] not in names and not args[0].startswith("-"):
            like = difflib.get_close_matches(args[0], names, 1)
            meant = f" Did you mean {like[0]!r}?" if like else ""
            raise click.UsageError(f"No such command {args[0]!r}.{meant}", ctx)
        name, command, rest = super().resolve_command(ctx, args)
        # Click takes `--to` as the folder of `--tek-csv --to x`
        options = {key: one for one in getattr(command, "params", ()) for key in (*one.opts, *one.secondary_opts)}
        for option, value in itertools.pairwise(rest):
            asked = options.get(option)
            if value not in options or not isinstance(asked, click.Option) or asked.is_flag or asked.count:
                continue
            if not isinstance(asked.flag_value, str):  # with one the option may stand alone
                where = click.Context(command, ctx, name) if command else ctx
                raise click.UsageError(f"{option} needs a value, and {value} is an option", where)
        return name, command, rest


def json_option(function: F) -> F:
    """Add ``--json`` and ``--quiet``."""
    one_line = "Print the result in one line, and errors."
    function = click.option("--quiet", is_flag=True, expose_value=False, callback=_keep, help=one_line)(function)
    one_document = "Print one JSON document, also for an error."
    return click.option("--json", "as_json", is_flag=True, help=one_document)(function)


def config_option(function: F) -> F:
    """Add ``--config FILE``."""
    return click.option(
        "--config",
        type=click.Path(path_type=Path),
        metavar="FILE",
        help="Settings file; missing values take the defaults.",
    )(function)


def unused_config_option(function: F) -> F:
    """Take ``--config FILE`` unseen where nothing of it is used, for scripts that give it to every command."""

    def read(_: click.Context, __: click.Parameter, path: Path | None) -> None:
        if path is not None:
            from station.settings import read_toml  # with Pydantic: `--help` starts at once

            read_toml(path)  # a file with a mistake is one here too

    path = click.Path(path_type=Path)
    return click.option("--config", type=path, expose_value=False, callback=read, hidden=True)(function)


def transcript_option(function: F) -> F:
    """Add ``--transcript FILE``: what every link carries while the command runs is written down."""

    def start(context: click.Context, _: click.Parameter, path: Path | None) -> None:
        if path is None:
            return
        from instrument.text_files import recorded

        try:
            context.with_resource(recorded(path))
        except OSError as error:
            raise click.BadParameter(f"{path} cannot be written: {error.strerror or error}") from None

    return click.option(
        "--transcript",
        type=click.Path(path_type=Path, dir_okay=False),
        metavar="FILE",
        callback=start,
        expose_value=False,
        help="Write every message to and from the instruments to this file.",
    )(function)


def dither_option(function: F) -> F:
    """Add ``--dither``."""
    said = "on: the gyro's body dithers, as [dither] of the settings says."
    return click.option("--dither", type=click.Choice(["on", "off"]), help=said)(function)


def report_option(function: F) -> F:
    """Add ``--report`` and ``--no-report``."""
    return click.option("--report/--no-report", default=True, help="Write report.html beside the run [yes].")(
        function
    )


def run_options(function: F) -> F:
    """Add what every command has that takes records: resume, labels, seed, directory, settings, JSON."""
    options = (
        click.option("--resume", type=RUN_PATH, metavar="RUN", help="Resume this run: what is there is kept."),
        click.option("--unit", metavar="TEXT", help="Serial number of the unit under test."),
        click.option("--operator", metavar="TEXT", help="Who measures."),
        click.option("--note", metavar="TEXT", help="A note to keep with the run."),
        click.option("--seed", type=click.IntRange(min=0), metavar="S", help="Seed of the simulated bench."),
        click.option(
            "--runs",
            "--out",
            "out",
            type=click.Path(path_type=Path),
            metavar="DIR",
            help="Directory of runs [./runs].",
        ),
        click.option("--jsonl", is_flag=True, help="Print one JSON line per saved record."),
        transcript_option,
        config_option,
        json_option,
    )
    function = display_options(function)
    for option in reversed(options):
        function = option(function)
    return function


def overrides(given: Mapping[str, Any], places: Mapping[str, str]) -> dict[str, dict[str, object]]:
    """Turn options of the command line into settings; what was not given is left out."""
    chosen: dict[str, dict[str, object]] = {}
    for name, place in places.items():
        if (value := given.get(name)) is not None:
            section, _, key = place.partition(".")
            chosen.setdefault(section, {})[key] = str(value) if isinstance(value, Path) else value
    return chosen


@contextmanager
def told_as_options(places: Mapping[str, str]) -> Iterator[None]:
    """Tell a setting that is wrong, and was given by an option, as that option."""
    try:
        yield
    except SettingsError as error:
        place, _, why = str(error).partition(": ")
        option = next((name for name, setting in places.items() if setting == place), "")
        if not option:
            raise
        raise click.UsageError(f"--{option.replace('_', '-')}: {why}") from None


# --------------------
# A command that takes records: a new run, one that is gone on with, a saved one, or files


_PLACES = {"seed": "simulation.seed", "out": "output.directory"}
_LABELS = ("unit", "operator", "note")


def run_measurement(
    name: str,
    given: Mapping[str, Any],
    *,
    places: Mapping[str, str],
    paths: tuple[Path, ...] = (),
    known: Mapping[str, object] | None = None,
    for_files: Mapping[str, str] | None = None,
    choices: Mapping[str, object] | None = None,
) -> int:
    """Carry out a command that takes records, from its options to its exit code."""
    from station.measurements import measurement
    from station.shell.finish import finish, saved_run

    report, as_json, lines = given["report"], given["as_json"], given["jsonl"]
    read_as = [option for option in for_files or {} if given.get(option) is not None]
    if not hold_a_run(paths):
        if read_as and not paths:
            raise click.UsageError(f"--{read_as[0].replace('_', '-')} says how files are read: name them too")
        chosen = overrides(given, for_files or {})
        with shown_for(name, given) as progress:
            taken = take_measurement(name, given, progress, places=places, paths=paths, known=known, chosen=chosen)
            code = finish(taken, report=report, as_json=as_json, quiet=lines, events=progress.events)
            progress.end(code)
            return code
    _exclude(given, {**places, **(for_files or {})}, paths)
    if len(paths) > 1:
        raise click.UsageError("give one saved run, or files to make one of")
    if lines:
        raise click.UsageError("--jsonl acknowledges records as they are taken; these are saved already")
    taken = saved_run(paths[0], measurement(name))
    how = {"saved": True, "config": given["config"], "choices": choices}
    return finish(taken, report=report, as_json=as_json, **how)


def hold_a_run(paths: Iterable[Path]) -> bool:
    """Whether one of the paths is a saved run, and they are no files to make one of."""
    from station.runs.database import is_database

    return any(path.exists() and is_database(path) for path in paths)


@contextmanager
def shown_for(name: str, given: Mapping[str, Any]) -> Iterator[Progress]:
    """Show what happens while a measurement is taken, as the options want it."""
    from station.measurements import measurement

    command = measurement(name).command.removeprefix("gyrolock ")
    with shown(given, command, **{label: given[label] for label in _LABELS}) as progress:
        yield progress


def take_measurement(
    name: str,
    given: Mapping[str, Any],
    progress: Progress,
    *,
    places: Mapping[str, str],
    paths: tuple[Path, ...] = (),
    known: Mapping[str, object] | None = None,
    chosen: Mapping[str, Mapping[str, object]] | None = None,
) -> Taken:
    """Take a new run, make one of files or go on with one; arguments as :func:`run_measurement`."""
    if not given["jsonl"]:
        return _taken(name, given, progress, places, paths, known, chosen or {}, None)
    acknowledgement = Acknowledgement()
    try:
        return _taken(name, given, progress, places, paths, known, chosen or {}, acknowledgement)
    finally:
        acknowledgement.rest()


def _taken(
    name: str,
    given: Mapping[str, Any],
    progress: Progress,
    places: Mapping[str, str],
    paths: tuple[Path, ...],
    known: Mapping[str, object] | None,
    further: Mapping[str, Mapping[str, object]],
    told: Acknowledgement | None,
) -> Taken:
    from station.measurements import measurement
    from station.settings import load
    from station.shell.finish import resume_run, start_run

    kind, config = measurement(name), given["config"]
    labels = {label: given[label] for label in _LABELS if given[label] is not None}
    chosen = {**overrides(given, {**_PLACES, **places}), **further}
    _exclude(given, places, paths)
    if given["resume"] is not None:
        changes = {"config": config, "overrides": chosen, "labels": labels}
        return resume_run(given["resume"], progress, kind=kind, **changes, acknowledge=told)
    with told_as_options(_PLACES | dict(places)):
        settings = load(kind.kind, config, chosen)
    if given["seed"] is not None and not kind.simulated(settings):
        raise click.UsageError("--seed belongs to a simulated bench; a real one has none")
    return start_run(kind, settings, progress, labels=labels, paths=paths, known=known, acknowledge=told)


def _exclude(given: Mapping[str, Any], places: Mapping[str, str], paths: tuple[Path, ...]) -> None:
    """Refuse options that contradict each other."""
    if given["resume"] is not None and paths:
        raise click.UsageError("--resume goes on with a run: give it without a saved run or files")
    live = [name for name in (*places, "seed") if given.get(name) is not None]
    if paths and live:
        raise click.UsageError(f"saved records and --{live[0].replace('_', '-')} exclude each other")


# --------------------
# Who reads the events of a command: the display that was asked for, a file, `gyrolock status`


def _keep(context: click.Context, parameter: click.Parameter, value: bool) -> bool:
    context.meta[PRINTS_ALL if parameter.name == "full" else PRINTS_ONE_LINE] = value
    return value


def full_option(function: F) -> F:
    """Add ``--full``; :func:`station.terminal.prints` tells of it."""
    return click.option(
        "--full", is_flag=True, expose_value=False, callback=_keep, help="Print everything, not the short page."
    )(function)


def display_options(function: F) -> F:
    """Add ``--full``, ``--plain`` and ``--events``."""
    options = (
        full_option,
        click.option("--plain", is_flag=True, help="Progress as plain lines, also on a terminal."),
        click.option(
            "--events",
            "events_to",
            metavar="FILE",
            help="Write events as JSON lines to this file, pipe or open descriptor (a number).",
        ),
    )
    for option in reversed(options):
        function = option(function)
    return function


@contextmanager
def shown(given: Mapping[str, Any], command: str, **labels: str | None) -> Iterator[Progress]:
    """Show what happens while a command measures."""
    from station.live.events import open_lines
    from station.live.status import StatusFile

    events = Events()
    with ExitStack() as readers:
        if target := given.get("events_to"):
            lines = open_lines(target)
            events.read_by(lines, values=True)
            readers.callback(_tell_lost, lines)
        status = StatusFile()
        events.read_by(status)
        readers.callback(status.close)
        if not (given.get("quiet") or prints(PRINTS_ONE_LINE)):
            if given.get("plain") or not _can_be_drawn_on(lines_on_stdout=bool(given.get("jsonl"))):
                from station.live.console import PlainLines

                events.read_by(PlainLines())
            else:
                from station.live.display import LiveDisplay

                events.read_by(readers.enter_context(LiveDisplay()), values=True)
        readers.enter_context(
            stepping_aside(
                lambda question: events.emit("asked", question=question), lambda: events.emit("answered")
            )
        )
        named = {name: labels.get(name) for name in ("unit", "operator", "note")}
        events.emit("program", command=command, **named, pid=os.getpid(), version=version("gyrolock"))
        progress = Progress(events)
        try:
            yield progress
        except BaseException as error:
            failure = describe_failure(error)
            if failure is None:
                progress.end(EXIT_DEFECT, str(error))
            else:
                progress.end(failure.exit_code, failure.message)
            raise
        progress.end(EXIT_OK)


def _can_be_drawn_on(*, lines_on_stdout: bool) -> bool:
    """Whether stderr is a terminal on which nothing else writes meanwhile."""
    try:
        drawn_on = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        return drawn_on and not (lines_on_stdout and sys.stdout.isatty())
    except (AttributeError, OSError, ValueError):
        return False


def _tell_lost(lines: Any) -> None:
    lines.close()
    if lines.lost:
        remark(f"--events: {lines.lost} lines were not written ({lines.error or 'nobody read them in time'})")
