"""What can go wrong, in the words and the exit codes that the command line uses."""

import signal
from dataclasses import dataclass

EXIT_OK = 0
EXIT_FAIL = 1  # against a limit, or a wanted uncertainty out of reach
EXIT_USAGE = 2
EXIT_INSTRUMENT = 3
EXIT_NO_SIGNAL = 4
EXIT_OUTPUT = 5  # a result could not be written; the records are kept
EXIT_MARGINAL = 6  # a limit lies within the uncertainty: neither PASS nor FAIL
EXIT_DEFECT = 70
EXIT_INTERRUPTED = 130  # 128 and the number of the signal, as shells count: 129 hung up, 143 terminated

DAMAGE = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""What values of a file raise that no file of ours ever holds."""


class StationError(Exception):
    """Base of the errors of this package; its text is one clear sentence for the user."""

    kind = "error"  # one word for programs: the ``kind`` in the JSON of an error
    exit_code = EXIT_USAGE  # exit code of the command that meets it


class UsageError(StationError):
    """Something was asked for that cannot be done as asked."""

    kind = "usage"


class SettingsError(StationError):
    """A settings file holds mistakes; the text names every one of them."""

    kind = "settings"


class RunError(StationError):
    """A saved run cannot be read or written."""

    kind = "run"


class CannotWrite(RunError):
    """The disk does not take a run, a result or a report."""

    kind = "output"
    exit_code = EXIT_OUTPUT


class NoUsableSignal(StationError):
    """The scope answers, but what it shows gives no lock-in rate."""

    kind = "no_usable_signal"
    exit_code = EXIT_NO_SIGNAL


class OutOfControl(StationError):
    """The bench is not what it always was, or nobody has looked lately: no unit is tested on it."""

    kind = "bench_out_of_control"
    exit_code = EXIT_INSTRUMENT


class Stopped(KeyboardInterrupt):
    """A signal came that ends the program."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@dataclass(frozen=True)
class Failure:
    """An error as it is shown to a user or to a program."""

    kind: str
    message: str
    exit_code: int

    def as_json(self) -> dict[str, object]:
        """Return the value of the key ``error`` of the JSON document."""
        return {"kind": self.kind, "message": self.message, "exit_code": self.exit_code}


_SIGNALS = {
    "SIGTERM": ("terminated", "terminated from outside (SIGTERM)"),
    "SIGHUP": ("hung_up", "the terminal was closed (SIGHUP)"),
}


def describe_failure(error: BaseException) -> Failure | None:
    """Put an exception into words and an exit code."""
    if isinstance(error, StationError):
        return Failure(error.kind, one_line(error), error.exit_code)
    if isinstance(error, Stopped) and error.number != signal.SIGINT:
        kind, words = _SIGNALS.get(signal.Signals(error.number).name, ("interrupted", "interrupted"))
        return Failure(kind, words, 128 + error.number)
    if isinstance(error, KeyboardInterrupt):
        return Failure("interrupted", "interrupted by the operator", EXIT_INTERRUPTED)
    if isinstance(error, OSError):
        return Failure("file", one_line(error), EXIT_USAGE)
    return _describe_instrument_failure(error)


def _describe_instrument_failure(error: BaseException) -> Failure | None:
    # imported here: `gyrolock --help` must not wait for PyVISA
    from instrument import FileFormatError, InstrumentError, LinkError, NoTrigger, SettingError, WrongInstrument

    if not isinstance(error, InstrumentError):
        return None
    kinds: tuple[tuple[type[InstrumentError], str, int], ...] = (
        (LinkError, "link", EXIT_INSTRUMENT),
        (WrongInstrument, "wrong_instrument", EXIT_INSTRUMENT),
        (NoTrigger, "no_trigger", EXIT_NO_SIGNAL),
        (SettingError, "setting", EXIT_USAGE),
        (FileFormatError, "file", EXIT_USAGE),
    )
    for family, kind, exit_code in kinds:
        if isinstance(error, family):
            return Failure(kind, one_line(error), exit_code)
    return Failure("instrument", one_line(error), EXIT_INSTRUMENT)


def one_line(error: BaseException) -> str:
    """Return the text of an error in one line, never empty."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split()) or type(error).__name__
