"""The simulated oscilloscope alone, served in real time: its gyro turns at the slow rate."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import numpy as np

from instrument.facts import LEVELS_PER_DIVISION, VERTICAL_SCALES
from instrument.simulated import PtyServer, RealClock, TcpServer
from instrument.simulated.controllers import (
    LineDevice,
    LineServer,
    RateTableController,
    SimulatedChamber,
    SimulatedPowerSupply,
)
from station.lock_in.settings import Settings
from station.ring_laser.instruments import SimulatedInstruments, build_instruments
from station.scope.autoset import oscilloscope_steps
from station.scope.serve import served


def at_slow_rate(settings: Settings) -> Settings:
    """Return settings of a bench whose table turns at the slow rate from the beginning."""
    return settings.model_copy(update={"table": settings.table.model_copy(update={"kind": "none"})})


@contextmanager
def serve_scope(
    settings: Settings, *, tcp_port: int | None, baud_rate: int | None = None
) -> Iterator[PtyServer | TcpServer]:
    """Serve the simulated oscilloscope in real time, its gyro at the slow rate.

    Parameters
    ----------
    tcp_port : int or None
        ``None``: a serial terminal; 0: any free port.
    baud_rate : int, optional
        Paces the serial terminal.

    Yields
    ------
    PtyServer or TcpServer
        With its VISA name, and with an event that is set when it serves no more.
    """
    with serve_bench(settings, tcp_port=tcp_port, baud_rate=baud_rate) as (server, _):
        yield server


@contextmanager
def serve_bench(
    settings: Settings, *, tcp_port: int | None, baud_rate: int | None = None, controllers: bool = False
) -> Iterator[tuple[PtyServer | TcpServer, dict[str, str]]]:
    """Serve the simulated oscilloscope as :func:`serve_scope`, and the controllers beside it.

    Parameters
    ----------
    controllers : bool, optional
        Whether rate table, chamber and power supply are served too, each on a link of the same kind.

    Yields
    ------
    PtyServer or TcpServer
        Of the oscilloscope.
    dict
        VISA names of the controllers, by their names in the settings.
    """
    clock = RealClock()
    instruments = build_instruments(at_slow_rate(settings), clock)
    _show_the_beat(instruments, settings)
    link, port = ("pty", None) if tcp_port is None else ("tcp", 0)
    devices: dict[str, LineDevice] = {}
    if controllers:
        table = RateTableController(instruments.table)
        devices = {"rate_table": table, "chamber": SimulatedChamber(clock), "power_supply": SimulatedPowerSupply()}
    with ExitStack() as stack:
        scope = stack.enter_context(served(instruments.scope, link, tcp_port=tcp_port or 0, baud_rate=baud_rate))
        servers = {
            name: stack.enter_context(LineServer(device, tcp_port=port)) for name, device in devices.items()
        }
        yield scope, {name: server.resource_name for name, server in servers.items()}


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
