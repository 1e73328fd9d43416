"""An oscilloscope opened by name, served to others, its screen grabbed, its signals and faults made."""

import io
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from instrument import (
    ATTEMPTS,
    RECONNECT_FOR,
    TDS2014,
    ExecutionError,
    FileFormatError,
    FoundPanel,
    Identity,
    Persistence,
    TransferError,
    Waveform,
    WrongInstrument,
    read_waveform,
)
from instrument.simulated import GpibAdapterServer, HislipServer, PtyServer, Signal, SimulatedTDS2014, TcpServer
from instrument.simulated.faults import Fault, FaultKind
from station.errors import CannotWrite, UsageError

_SIMULATED_ANSWER_S = 30.0


@contextmanager
def open_scope(
    resource: str,
    baud_rate: int = 0,
    *,
    reconnect_s: float = RECONNECT_FOR,
    simulated: bool = False,
    tell: Callable[[str], None] | None = None,
    put_back: FoundPanel | None = None,
    same_as: Identity | None = None,
) -> Iterator[TDS2014]:
    """Open an oscilloscope and put its front panel back afterwards."""
    persistence = Persistence(ATTEMPTS, reconnect_s, tell=tell or (lambda _: None))
    if simulated:  # no byte changes inside this computer, and a scope that computes its signals takes its time
        persistence = replace(persistence, read_twice=False, answer_time=_SIMULATED_ANSWER_S)
    with TDS2014(resource, baud_rate=baud_rate or None, persistence=persistence) as scope:
        if same_as is not None and not scope.identity.same_unit(same_as):
            raise WrongInstrument(
                f"the run was begun with {same_as.text!r}, and on {resource} answers {scope.identity.text!r}: "
                "connect the one it was begun with, or take a new run (`gyrolock analyze --combine` makes one "
                "result of several)"
            )
        if put_back is not None:
            scope.put_back_in_the_end(put_back)
        yield scope


# --------------------
# Simulated oscilloscopes behind a real link


Server = PtyServer | TcpServer | HislipServer | GpibAdapterServer


@dataclass(frozen=True)
class Served:
    """Instruments that are served, and their VISA names in the same order."""

    servers: tuple[Server, ...]
    resource_names: tuple[str, ...]

    def wait(self, timeout: float) -> bool:
        """Wait until one of them is served no more; False after `timeout` s."""
        one, *others = (server.ended for server in self.servers)
        return any(ended.is_set() for ended in others) or one.wait(timeout=timeout)


@contextmanager
def serve(scope: SimulatedTDS2014, link: str, *, tcp_port: int = 0) -> Iterator[str]:
    """Put one simulated oscilloscope behind a byte stream, as :func:`served` does it; yields its VISA name."""
    with served([scope], link, port=tcp_port) as found:
        yield found.resource_names[0]


@contextmanager
def served(
    scopes: Sequence[SimulatedTDS2014], link: str, *, port: int = 0, baud_rate: int | None = None
) -> Iterator[Served]:
    """Put simulated oscilloscopes behind a link."""
    with ExitStack() as stack:
        try:
            yield _start(stack, scopes, link, port, baud_rate)
        except _NotServed as problem:
            if link != "auto":
                raise UsageError(f"the simulated scope cannot be served: {problem}") from None
            yield _start(stack, scopes, "tcp", port, None)


class _NotServed(Exception):
    """The system does not give the link."""


def _start(
    stack: ExitStack, scopes: Sequence[SimulatedTDS2014], link: str, port: int, baud_rate: int | None
) -> Served:
    try:
        if link == "hislip":
            server = stack.enter_context(HislipServer(scopes, port=port))
            return Served((server,), server.resource_names)
        servers: list[TcpServer | PtyServer | GpibAdapterServer] = []
        for number, scope in enumerate(scopes):
            own = port + number if port else 0
            if link == "tcp":
                servers.append(stack.enter_context(TcpServer(scope, port=own)))
            elif link == "prologix":
                servers.append(stack.enter_context(GpibAdapterServer(scope, port=own)))
            else:
                servers.append(stack.enter_context(PtyServer(scope, baud_rate=baud_rate)))
    except OSError as error:
        raise _NotServed(error.strerror or str(error)) from None
    return Served(tuple(servers), tuple(server.resource_name for server in servers))


# --------------------
# Signals that `gyrolock simulate` can show: sine, square, or what a file holds, played again and again


Floats = NDArray[np.float64]
Shape = Callable[[Floats], Floats]

GYRO = "gyro"
_FREQUENCY_HZ, _AMPLITUDE_V = 1000.0, 0.2


SHAPES: dict[str, Shape] = {
    "sine": lambda phase: np.asarray(np.sin(phase)),
    "square": lambda phase: np.where(np.mod(phase, 2 * math.pi) < math.pi, 1.0, -1.0),
}


@dataclass(frozen=True)
class Periodic:
    """A shape that repeats: `shape` takes a phase in rad and gives -1 to 1; frequency in Hz, the others in V."""

    shape: Shape
    frequency: float
    amplitude: float
    offset: float

    def __call__(self, times: Floats) -> Floats:
        """Volts at times in s."""
        return np.asarray(self.offset + self.amplitude * self.shape(2 * math.pi * self.frequency * times))


@dataclass(frozen=True)
class PlayedBack:
    """A record of even steps (s) in V, begun at time zero and repeated without a gap."""

    step: float
    volts: Floats

    def __call__(self, times: Floats) -> Floats:
        """Volts at times in s: straight lines from one sample to the next, and from the last to the first."""
        places = np.mod(times / self.step, len(self.volts))
        before = np.minimum(places.astype(np.intp), len(self.volts) - 1)
        after = (before + 1) % len(self.volts)
        return np.asarray(self.volts[before] + (places - before) * (self.volts[after] - self.volts[before]))


@dataclass(frozen=True)
class ShownSignal:
    """What stands at one input; `signal` is None for the beat of the simulated gyro."""

    channel: int
    signal: Signal | None


def parse_signal(text: str) -> ShownSignal:
    """Read `[CHn=]gyro`, `[CHn=]sine[:Hz[:V[:offset V]]]`, the same with `square`, or `[CHn=]FILE`."""
    before, equals, after = text.partition("=")
    name = before.upper() if equals else "CH1"
    what = after if equals else text
    if not (name.startswith("CH") and name[2:].isdigit() and 1 <= int(name[2:]) <= 4):
        if not equals or Path(text).exists():
            name, what = "CH1", text  # a file name with an equals sign
        else:
            raise UsageError(f"--signal {text}: {before!r} is no channel; write CH1= to CH4=")
    channel = int(name[2:])
    word, *numbers = what.split(":")
    if word.lower() == GYRO and not numbers:
        return ShownSignal(channel, None)
    if word.lower() in SHAPES and len(numbers) <= 3:
        shape = word.lower()
        given = [_FREQUENCY_HZ, _AMPLITUDE_V, 0.0]
        try:
            given[: len(numbers)] = [float(number) for number in numbers]
        except ValueError:
            raise UsageError(f"--signal {text}: write it as {shape}:HZ:VOLTS:OFFSET, with numbers") from None
        if not (all(map(math.isfinite, given)) and given[0] > 0):
            raise UsageError(f"--signal {text}: the frequency has to be above zero, and all numbers finite")
        return ShownSignal(channel, Periodic(SHAPES[shape], *given))
    return ShownSignal(channel, _from_file(Path(what)))


def _from_file(path: Path) -> PlayedBack:
    """A Tek CSV or ISF file, or a plain CSV of two columns: times in s at even steps, volts."""
    if not path.is_file():
        raise UsageError(f"--signal {path}: no such file, and neither gyro, sine nor square")
    try:
        record = read_waveform(path)
    except (FileFormatError, TransferError):
        return _from_columns(path)
    volts = record.volts[np.isfinite(record.volts)]
    if len(volts) < 2:
        raise UsageError(f"--signal {path}: holds no samples to show")
    return PlayedBack(record.sample_interval, volts)


def _from_columns(path: Path) -> PlayedBack:
    rows = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        try:
            rows.append([float(cell) for cell in line.replace(";", ",").split(",")[:2]])
        except ValueError:
            continue  # a title, an empty line
    columns = np.array([row for row in rows if len(row) == 2], dtype=np.float64).reshape(-1, 2)
    steps = np.diff(columns[:, 0])
    if len(columns) < 2 or not np.isfinite(columns).all():
        raise UsageError(f"--signal {path}: neither a Tek file nor two columns of times (s) and volts")
    step = float(np.median(steps))
    if step <= 0 or np.abs(steps - step).max() > 0.01 * step:
        raise UsageError(f"--signal {path}: its times do not rise in even steps")
    return PlayedBack(step, columns[:, 1])


# --------------------
# Faults of a simulated oscilloscope as a user writes them


KINDS: tuple[str, ...] = get_args(FaultKind)
_DEFAULT_CHANCE = 0.01


def parse_fault(text: str) -> Fault:
    """Read `KIND`, `KIND:CHANCE` or `knob turned:CHANCE:COMMAND`; without a chance, one answer in a hundred."""
    kind, _, rest = text.partition(":")
    chance, _, command = rest.partition(":")
    if kind not in KINDS:
        raise UsageError(f"--faults {text}: there is no fault {kind!r}; choose one of {', '.join(KINDS)}")
    try:
        probability = float(chance) if chance else _DEFAULT_CHANCE
    except ValueError:
        probability = -1.0
    if not 0 <= probability <= 1:
        raise UsageError(f"--faults {text}: the chance {chance!r} is no number from 0 to 1")
    if kind.startswith("knob") and not command:
        raise UsageError(f"--faults {text}: say what the hand turns, as in 'knob turned:0.1:CH1:SCALE 2'")
    return Fault(kind, probability=probability, command=command)  # type: ignore[arg-type]


# --------------------
# What an oscilloscope shows, into files: its screen as a picture, its traces as numbers


@dataclass(frozen=True)
class GrabbedTrace:
    """One trace, and what the scope measures on it: V and Hz; None where it has no value."""

    channel: str
    waveform: Waveform
    peak_to_peak: float
    frequency: float | None

    def __str__(self) -> str:
        frequency = "no period" if self.frequency is None else f"{self.frequency:.6g} Hz"
        cut = "clipped: more than " if self.waveform.clipped else ""
        return f"{self.channel}: {cut}{self.peak_to_peak:.4g} Vpp, {frequency}"


def grab_traces(scope: TDS2014, channels: Sequence[str] = ()) -> list[GrabbedTrace]:
    """The traces on the screen, or those that are named."""
    # A scope that runs takes one record of all of them; one that is stopped keeps what it holds.
    shown = list(channels) or [name for name in scope.channels if scope.channel_settings(name).displayed]
    if not shown:
        return []
    running = scope.query(":ACQUIRE:STATE?").split()[-1] == "1"
    waveforms = scope.acquire(shown) if running else scope.fetch(shown)
    return [_trace(scope, name, waveform) for name, waveform in zip(shown, waveforms, strict=True)]


def _trace(scope: TDS2014, channel: str, waveform: Waveform) -> GrabbedTrace:
    try:
        frequency = scope.measure("FREQUENCY", channel).value
    except ExecutionError:
        frequency = None
    return GrabbedTrace(channel, waveform, float(np.nanmax(waveform.volts) - np.nanmin(waveform.volts)), frequency)


def write_grab(folder: Path, name: str, traces: Sequence[GrabbedTrace], picture: bytes | None) -> list[Path]:
    """Write `NAME.png`, `NAME.csv` (a column of times for each trace, and one of volts) and `NAME.npz`."""
    # The NumPy file has `CH1_times`, `CH1_volts`, `CH1_codes` and `CH1_preamble` for each channel. A file that is
    # there already is not written over: CannotWrite.
    files: dict[str, bytes] = {} if picture is None else {"png": picture}
    if traces:
        columns = [column for trace in traces for column in (trace.waveform.times, trace.waveform.volts)]
        title = ",".join(f"{trace.channel}_time_s,{trace.channel}_volts" for trace in traces)
        text = io.StringIO()
        np.savetxt(text, np.column_stack(columns), fmt="%.9g", delimiter=",", header=title, comments="")
        files |= {"csv": text.getvalue().encode(), "npz": _as_numpy(traces)}
    written = []
    for ending, content in files.items():
        path = folder / f"{name}.{ending}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with path.open("xb") as file:
                file.write(content)
        except OSError as error:
            raise CannotWrite(f"{path} cannot be written: {error.strerror or error}") from None
        written.append(path)
    return written


def _as_numpy(traces: Sequence[GrabbedTrace]) -> bytes:
    arrays: dict[str, NDArray[Any]] = {}
    for trace in traces:
        arrays |= {
            f"{trace.channel}_times": trace.waveform.times,
            f"{trace.channel}_volts": trace.waveform.volts,
            f"{trace.channel}_codes": trace.waveform.codes,
            f"{trace.channel}_preamble": np.array(trace.waveform.preamble.to_text()),
        }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()
