"""The command ``gyrolock``. Modules of :mod:`station.commands` are imported when a command of theirs is run."""

import importlib
import os
import sys
import traceback
from collections.abc import Sequence

import click

from station.errors import (
    EXIT_DEFECT,
    EXIT_FAIL,
    EXIT_INTERRUPTED,
    EXIT_OK,
    EXIT_OUTPUT,
    EXIT_USAGE,
    Failure,
    describe_failure,
    one_line,
)
from station.runs.signals import ending_signals
from station.shell.options import SuggestingGroup
from station.terminal import print_failure, print_json, remark, unbreakable_streams

_TRACEBACK_VARIABLE = "GYROLOCK_TRACEBACK"

# NumPy's threads for matrices: those of a fit are so small that a second thread costs more than it saves, most
# of all on a busy machine. Whoever sets the number keeps it.
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")

# command: module and name in it, and the line that `gyrolock --help` shows without importing it
COMMANDS = {
    "measure": ("commands.measure:measure", "Measure the lock-in rate: acquire, save, analyse, report."),
    "start": ("commands.measure:start", "Measure for the first time, step by step."),
    "acquire": ("commands.measure:acquire", "Acquire and save records only."),
    "deadband": ("commands.measure:deadband", "Search the dead band: sweep the rate through zero, up and down."),
    "analyze": ("commands.analyze:command", "Evaluate saved runs again, and files of Tektronix oscilloscopes."),
    "compare": (
        "commands.saved:compare_command",
        "Compare two analyses of the same records, or records of two gyros.",
    ),
    "report": ("commands.saved:report_command", "Write the HTML report of saved runs."),
    "runs": ("commands.catalogue:runs_command", "List runs: when, what, unit, result, quality, verdict."),
    "annotate": ("commands.saved:annotate_command", "Add notes, tags or a good or bad mark to saved runs."),
    "export": ("commands.saved:export_command", "Write records to a data set: CSV, Parquet, HDF5, NumPy."),
    "verify": ("commands.saved:verify_command", "Check that the record of a test matches its raw runs."),
    "history": ("commands.catalogue:history_command", "Show tested units and control charts."),
    "salvage": ("commands.saved:salvage_command", "Copy what can still be read of a damaged run into a new one."),
    "status": ("commands.running:status", "Show running measurements."),
    "stop": ("commands.running:stop", "Stop a running measurement or station; its records are kept."),
    "panel": ("commands.running:panel", "Show and measure in a browser: extra `panel`."),
    "grab": ("commands.instruments:grab_command", "Save the screen as PNG and the traces as CSV and NumPy."),
    "plan": ("commands.planning:plan_command", "Plan a measurement: records for a wanted uncertainty."),
    "station": ("commands.station:command", "Test a unit by a campaign file: one verdict."),
    "fog": ("fibre_gyro.command:command", "Scale factor of a fibre gyro: rate table, self-calibration, ..."),
    "study": ("commands.planning:study_command", "Repeat the paper's simulations, by its method and exactly."),
    "simulate": (
        "commands.instruments:simulate_command",
        "Serve the simulated oscilloscope: TCP, HiSLIP, GPIB, terminal.",
    ),
    "list": ("commands.instruments:list_command", "List the instruments that VISA can see."),
    "doctor": ("commands.doctor:doctor_command", "Check this installation; say what is missing."),
    "settings": ("commands.measure:settings_command", "Print a commented settings file to copy."),
}


GROUPS = {
    "Measure": ("start", "measure", "deadband", "fog", "station"),
    "Look": ("status", "panel", "runs", "report", "history"),
    "Judge": ("analyze", "compare", "plan"),
    "Keep": ("export",),
    "Bench": ("doctor", "settings", "simulate"),
}
"""What `gyrolock --help` explains; the other commands are named."""


class _LazyGroup(SuggestingGroup):
    """A group whose commands are imported only when they are run: ``gyrolock --help`` starts at once."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module, _, name = COMMANDS[cmd_name][0].partition(":")
        command: click.Command = getattr(importlib.import_module(f"station.{module}"), name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for heading, names in GROUPS.items():
            with formatter.section(heading):
                formatter.write_dl([(name, COMMANDS[name][1]) for name in names])
        shown = {name for names in GROUPS.values() for name in names}
        with formatter.section("More"):
            formatter.write_text(", ".join(name for name in COMMANDS if name not in shown))


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="gyrolock", prog_name="gyrolock")
def gyrolock() -> None:
    """Lock-in rate of a ring laser gyro from the records of a bench oscilloscope.

    `gyrolock measure` alone shows a whole measurement on a simulated bench. RUN is a path, the beginning of a name
    in ./runs, or `last`.

    Exit codes: 0 done, 1 FAIL, 2 usage or settings, 3 instrument or link, 4 no usable signal, 5 output not written
    (records are kept), 6 MARGINAL, 130 interrupted.
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; every error becomes one line and an exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    for name in _ONE_THREAD:
        os.environ.setdefault(name, "1")
    with unbreakable_streams() as streams, ending_signals():
        try:
            code = _run(given)
        except KeyboardInterrupt as error:  # one that came while the end was told
            code = _tell(describe_failure(error) or _defect(error), given)
        if (lost := streams.lost) and code in (EXIT_OK, EXIT_FAIL):
            remark(f"the result could not be written to stdout ({lost}); what was saved is kept")
            code = EXIT_OUTPUT
    return code


def _run(given: Sequence[str]) -> int:
    try:
        return int(gyrolock.main(list(given), prog_name="gyrolock", standalone_mode=False) or 0)
    except click.exceptions.Exit as done:
        return done.exit_code
    except click.Abort:
        return _tell(Failure("interrupted", "interrupted by the operator", EXIT_INTERRUPTED), given)
    except click.ClickException as error:
        return _tell(Failure("usage", _usage_line(error), EXIT_USAGE), given)
    except (Exception, KeyboardInterrupt) as error:
        return _tell(describe_failure(error) or _defect(error), given)


def _defect(error: BaseException) -> Failure:
    """Describe an error that should not have happened."""
    if os.environ.get(_TRACEBACK_VARIABLE):
        traceback.print_exception(error)
    text = f"{type(error).__name__}: {one_line(error)}"
    advice = f"this is a defect of gyrolock; {_TRACEBACK_VARIABLE}=1 in the environment shows where"
    return Failure("defect", f"{text} ({advice})", EXIT_DEFECT)


def _tell(failure: Failure, arguments: Sequence[str]) -> int:
    """Report a failure: one line on stderr, and with ``--json`` one document on stdout."""
    if "--json" in arguments or "--jsonl" in arguments:
        print_json({"error": failure.as_json()})
    print_failure(failure)
    return failure.exit_code


def _usage_line(error: click.ClickException) -> str:
    text = " ".join(error.format_message().split())
    if isinstance(error, click.UsageError) and error.ctx is not None:
        return f"{text} (see `{error.ctx.command_path} --help`)"
    return text


if __name__ == "__main__":
    sys.exit(main())
