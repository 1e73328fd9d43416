"""Signals that `gyrolock simulate` can show: sine, square, or what a file holds, played again and again."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from instrument import FileFormatError, TransferError, read_waveform
from instrument.simulated import Signal
from station.errors import UsageError

Floats = NDArray[np.float64]
Shape = Callable[[Floats], Floats]

GYRO = "gyro"
_FREQUENCY_HZ, _AMPLITUDE_V = 1000.0, 0.2


def _sine(phase: Floats) -> Floats:
    return np.asarray(np.sin(phase))


def _square(phase: Floats) -> Floats:
    return np.asarray(np.where(np.mod(phase, 2 * math.pi) < math.pi, 1.0, -1.0), dtype=np.float64)


SHAPES: dict[str, Shape] = {"sine": _sine, "square": _square}


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
    """Read `[CHn=]gyro`, `[CHn=]sine[:Hz[:V[:offset V]]]`, the same with `square`, or `[CHn=]FILE`.

    Examples
    --------
    >>> parse_signal("CH2=sine:50:0.5").signal(np.array([0.005])).round(6).tolist()
    [0.5]
    >>> parse_signal("gyro")
    ShownSignal(channel=1, signal=None)
    """
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
        return ShownSignal(channel, _periodic(text, word.lower(), numbers))
    return ShownSignal(channel, _from_file(Path(what)))


def _periodic(text: str, shape: str, numbers: list[str]) -> Periodic:
    given = [_FREQUENCY_HZ, _AMPLITUDE_V, 0.0]
    try:
        given[: len(numbers)] = [float(number) for number in numbers]
    except ValueError:
        raise UsageError(f"--signal {text}: write it as {shape}:HZ:VOLTS:OFFSET, with numbers") from None
    if not (all(map(math.isfinite, given)) and given[0] > 0):
        raise UsageError(f"--signal {text}: the frequency has to be above zero, and all numbers finite")
    return Periodic(SHAPES[shape], *given)


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
