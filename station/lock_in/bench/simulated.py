"""The simulated bench: table, gyro and oscilloscope on one clock, the scope behind a real byte stream."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from instrument.facts import LEVELS_PER_DIVISION, VERTICAL_SCALES
from instrument.simulated import RealClock, VirtualClock
from station.lock_in.bench.bench import Bench
from station.lock_in.bench.instruments import SimulatedInstruments, at_slow_rate, build_instruments, true_values
from station.lock_in.settings import Settings
from station.scope.autoset import oscilloscope_steps
from station.scope.open import open_scope
from station.scope.serve import serve


@contextmanager
def open_simulated_bench(settings: Settings, *, times_resumed: int = 0) -> Iterator[Bench]:
    """Open the simulated bench: on a clock that jumps instead of waiting, through a real link.

    Parameters
    ----------
    times_resumed : int, optional
        How often it was switched on before for the same run: phases and noise are other ones each time.
    """
    instruments = build_instruments(settings, VirtualClock(), times_resumed=times_resumed)
    turning_already = settings.table.kind == "none"
    with serve(instruments.scope, instruments.link) as resource, open_scope(resource) as scope:
        yield Bench(
            scope,
            table=None if turning_already else instruments.table,
            sleep=instruments.clock.sleep,
            truth=lambda: true_values(instruments),
        )


@contextmanager
def serve_scope(settings: Settings, *, tcp_port: int | None, baud_rate: int | None = None) -> Iterator[str]:
    """Serve the simulated oscilloscope in real time, its gyro at the slow rate.

    Parameters
    ----------
    tcp_port : int or None
        ``None``: a serial terminal; 0: any free port.
    baud_rate : int, optional
        Paces the serial terminal.

    Yields
    ------
    str
        VISA resource name.
    """
    instruments = build_instruments(at_slow_rate(settings), RealClock())
    _show_the_beat(instruments, settings)
    link = "pty" if tcp_port is None else "tcp"
    with serve(instruments.scope, link, tcp_port=tcp_port or 0, baud_rate=baud_rate) as resource:
        yield resource


def _show_the_beat(instruments: SimulatedInstruments, settings: Settings) -> None:
    """Turn the knobs as an operator would: a client that only reads finds a beat that fills the screen."""
    gyro, detector = instruments.gyro, instruments.detector
    scope, measurement = instruments.scope, settings.measurement
    rate = settings.gyro.expected_lock_in_rate_dps * settings.table.slow_rate_over_lock_in
    frequency = max(float(gyro.beat_frequency(np.array([rate]))[0]), 1.0)
    base = oscilloscope_steps().time_base(frequency, measurement.periods_min, measurement.samples_per_period_min)
    wanted = detector.amplitude * LEVELS_PER_DIVISION / measurement.fill_levels
    scale = next((step for step in VERTICAL_SCALES if step >= wanted), VERTICAL_SCALES[-1])
    channel = settings.scope.channel
    knobs = (
        f":SELECT:{channel} ON",
        f":{channel}:PROBE 1;SCALE {scale:g};POSITION {-detector.offset / scale:.2f}",
        f":HORIZONTAL:MAIN:SCALE {base:g}",
        f":TRIGGER:MAIN:EDGE:SOURCE {channel};:TRIGGER:MAIN:LEVEL {detector.offset:g}",
    )
    with scope.lock:
        for _ in scope.execute(";".join(knobs).encode()):
            pass
        # what was taken with the knobs as they stood before is not for a client
        while (record := scope.acquisition.latest()) is None or record.seconds_per_division != base:
            instruments.clock.sleep(base)
