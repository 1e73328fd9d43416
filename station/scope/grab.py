"""What an oscilloscope shows, into files: its screen as a picture, its traces as numbers."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument import TDS2014, ExecutionError, Waveform
from station.errors import CannotWrite


@dataclass(frozen=True)
class Trace:
    """One trace, and what the scope measures on it: V and Hz; None where it has no value."""

    channel: str
    waveform: Waveform
    peak_to_peak: float
    frequency: float | None

    def __str__(self) -> str:
        frequency = "no period" if self.frequency is None else f"{self.frequency:.6g} Hz"
        cut = "clipped: more than " if self.waveform.clipped else ""
        return f"{self.channel}: {cut}{self.peak_to_peak:.4g} Vpp, {frequency}"


def grab_traces(scope: TDS2014, channels: Sequence[str] = ()) -> list[Trace]:
    """The traces on the screen, or those that are named.

    A scope that runs takes one record of all of them; one that is stopped keeps what it holds.
    """
    shown = list(channels) or [name for name in scope.channels if scope.channel_settings(name).displayed]
    if not shown:
        return []
    running = scope.query(":ACQUIRE:STATE?").split()[-1] == "1"
    waveforms = scope.acquire(shown) if running else scope.fetch(shown)
    return [_trace(scope, name, waveform) for name, waveform in zip(shown, waveforms, strict=True)]


def _trace(scope: TDS2014, channel: str, waveform: Waveform) -> Trace:
    try:
        frequency = scope.measure("FREQUENCY", channel).value
    except ExecutionError:
        frequency = None
    return Trace(channel, waveform, float(np.nanmax(waveform.volts) - np.nanmin(waveform.volts)), frequency)


def write_grab(folder: Path, name: str, traces: Sequence[Trace], picture: bytes | None) -> list[Path]:
    """Write `NAME.png`, `NAME.csv` (a column of times for each trace, and one of volts) and `NAME.npz`.

    The NumPy file has `CH1_times`, `CH1_volts`, `CH1_codes` and `CH1_preamble` for each channel. A file that is
    there already is not written over: CannotWrite.
    """
    files: dict[str, bytes] = {} if picture is None else {"png": picture}
    if traces:
        files |= {"csv": _as_csv(traces), "npz": _as_numpy(traces)}
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


def _as_csv(traces: Sequence[Trace]) -> bytes:
    columns = [column for trace in traces for column in (trace.waveform.times, trace.waveform.volts)]
    title = ",".join(f"{trace.channel}_time_s,{trace.channel}_volts" for trace in traces)
    text = io.StringIO()
    np.savetxt(text, np.column_stack(columns), fmt="%.9g", delimiter=",", header=title, comments="")
    return text.getvalue().encode()


def _as_numpy(traces: Sequence[Trace]) -> bytes:
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
