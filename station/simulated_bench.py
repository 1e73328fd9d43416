"""The simulated bench: table, gyro and oscilloscope on one clock, the scope behind a real byte stream."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.simulated import (
    PtyServer,
    RealClock,
    SimulatedRateTable,
    SimulatedTDS2014,
    TcpServer,
    VirtualClock,
)
from instrument.simulated.clock import Clock
from station.autoset import LEVELS_PER_DIVISION, VERTICAL_SCALES, time_base_for
from station.bench import Bench, open_scope
from station.errors import UsageError
from station.settings import Settings, SimulationSettings
from station.simulated_gyro import (
    Gyro,
    Segment,
    axis_rate_on_table,
    beat_signal_on_table,
    harmonic_ratio,
    with_detector_noise,
)

Array = NDArray[np.float64]

_TRUTH_POINTS = 201
_STEP_S = 0.05


class TurningTable:
    """The simulated rate table, and the history of its motion for the gyro that stands on it.

    Parameters
    ----------
    clock : Clock
    acceleration : float
        deg/s^2.
    azimuth : float
        At the beginning, deg.
    rate : float, optional
        At the beginning, deg/s.
    """

    def __init__(self, clock: Clock, *, acceleration: float, azimuth: float, rate: float = 0.0) -> None:
        self._clock, self._acceleration = clock, acceleration
        self._table = SimulatedRateTable(clock, acceleration=acceleration, azimuth=azimuth)
        self.motion: tuple[Segment, ...] = (Segment(clock.now(), azimuth, 0.0),)
        if rate:
            self.set_rate(rate)

    def set_rate(self, rate_dps: float) -> None:
        """Bring the table to a rate in deg/s and return when it turns steadily."""
        start, azimuth, before = self._clock.now(), self._table.azimuth(), self._table.rate()
        self._table.set_rate(rate_dps)
        slew_s = abs(rate_dps - before) / self._acceleration
        if slew_s == 0:
            return
        steady = start + slew_s
        reached = azimuth + slew_s * (before + rate_dps) / 2
        slew = Segment(start, azimuth, before, math.copysign(self._acceleration, rate_dps - before))
        # one assignment: the thread of the scope may be reading it
        self.motion = (*self.motion, slew, Segment(steady, reached, rate_dps))
        while (left := steady - self._clock.now()) > 0:
            self._clock.sleep(min(left, _STEP_S) + 1e-9)

    def rate(self) -> float:
        """Rate in deg/s now."""
        return self._table.rate()

    def azimuth(self) -> float:
        """Azimuth in deg now, not folded into one turn."""
        return self._table.azimuth()

    def close(self) -> None:
        """Leave the table as it is."""
        self._table.close()


@dataclass(frozen=True)
class SimulatedInstruments:
    """Everything on the simulated bench, before it is put behind a link."""

    clock: Clock
    table: TurningTable
    gyro: Gyro
    scope: SimulatedTDS2014


def slow_table_rate(settings: Settings, simulation: SimulationSettings) -> float:
    """Return the table rate in deg/s that gives the slow rate on the axis of the simulated gyro."""
    wanted = settings.gyro.expected_lock_in_rate_dps * settings.table.slow_rate_over_lock_in
    return wanted / math.cos(math.radians(simulation.tilt_deg))


def at_slow_rate(settings: Settings) -> Settings:
    """Return settings of a bench whose table turns at the slow rate from the beginning."""
    return settings.model_copy(update={"table": settings.table.model_copy(update={"kind": "none"})})


def build_instruments(settings: Settings, clock: Clock) -> SimulatedInstruments:
    """Put gyro, table and oscilloscope together, as the settings and their seed say.

    Parameters
    ----------
    settings : Settings
        With ``simulation``; with ``table.kind = "none"`` the table turns at the slow rate already.
    clock : Clock
        The time of all of them.

    Returns
    -------
    SimulatedInstruments

    Raises
    ------
    UsageError
        If the settings describe a real bench only, or a model that does not exist.
    """
    simulation = settings.simulation
    if simulation is None:
        raise UsageError("these settings describe a real bench: there is no [simulation] in them")
    start = np.random.default_rng([simulation.seed, 0x6B])
    turning = slow_table_rate(settings, simulation) if settings.table.kind == "none" else 0.0
    table = TurningTable(
        clock,
        acceleration=simulation.table_acceleration_dps2,
        azimuth=float(start.uniform(0.0, 360.0)),
        rate=turning,
    )
    gyro = Gyro(
        scale_factor=settings.gyro.scale_factor_pulses_per_deg,
        lock_in_rate=simulation.lock_in_rate_dps,
        backscatter_phase=math.radians(simulation.backscatter_phase_deg),
        readout_phase=math.radians(simulation.readout_phase_deg),
        tilt_deg=simulation.tilt_deg,
        latitude_deg=settings.site.latitude_deg,
        north_azimuth_deg=settings.table.north_azimuth_deg,
        amplitude=simulation.amplitude_v,
        offset=simulation.offset_v,
        start_phase=float(start.uniform(0.0, 2 * math.pi)),
    )

    def detector(times: Array) -> Array:
        return beat_signal_on_table(gyro, table.motion, times)

    signal = with_detector_noise(detector, simulation.detector_noise_v, simulation.seed)
    try:
        scope = SimulatedTDS2014(
            {int(settings.scope.channel[2:]): signal},
            model=simulation.scope_model,
            clock=clock,
            noise_levels=simulation.scope_noise_levels,
            seed=simulation.seed,
        )
    except ValueError as error:
        raise UsageError(f"simulation.scope_model: {error}") from None
    return SimulatedInstruments(clock, table, gyro, scope)


@contextmanager
def serve(scope: SimulatedTDS2014, link: str, *, tcp_port: int = 0, baud_rate: int | None = None) -> Iterator[str]:
    """Put the simulated oscilloscope behind a byte stream.

    Parameters
    ----------
    scope : SimulatedTDS2014
    link : {"auto", "pty", "tcp"}
        ``"auto"``: a serial terminal where the system has one.
    tcp_port : int, optional
        0: any free one.
    baud_rate : int, optional
        Paces the serial terminal.

    Yields
    ------
    str
        VISA resource name.

    Raises
    ------
    UsageError
        If the system has no such link, or the port is taken.
    """
    server: PtyServer | TcpServer
    try:
        server = TcpServer(scope, port=tcp_port) if link == "tcp" else PtyServer(scope, baud_rate=baud_rate)
    except OSError as error:
        if link != "auto":
            raise UsageError(f"the simulated scope cannot be served: {error.strerror or error}") from None
        server = TcpServer(scope, port=tcp_port)
    try:
        yield server.resource_name
    finally:
        server.close()


@contextmanager
def open_simulated_bench(settings: Settings) -> Iterator[Bench]:
    """Open the simulated bench: on a clock that jumps instead of waiting, through a real link.

    Parameters
    ----------
    settings : Settings

    Yields
    ------
    Bench
    """
    instruments = build_instruments(settings, VirtualClock())
    assert settings.simulation is not None  # build_instruments has looked
    turning_already = settings.table.kind == "none"
    with serve(instruments.scope, settings.simulation.link) as resource, open_scope(resource) as scope:
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
    settings : Settings
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
    gyro, scope, measurement = instruments.gyro, instruments.scope, settings.measurement
    rate = settings.gyro.expected_lock_in_rate_dps * settings.table.slow_rate_over_lock_in
    frequency = max(float(gyro.beat_frequency(np.array([rate]))[0]), 1.0)
    base = time_base_for(frequency, measurement.periods_min, measurement.samples_per_period_min)
    wanted = gyro.amplitude * LEVELS_PER_DIVISION / measurement.fill_levels
    scale = next((step for step in VERTICAL_SCALES if step >= wanted), VERTICAL_SCALES[-1])
    channel = settings.scope.channel
    knobs = (
        f":SELECT:{channel} ON",
        f":{channel}:PROBE 1;SCALE {scale:g};POSITION {-gyro.offset / scale:.2f}",
        f":HORIZONTAL:MAIN:SCALE {base:g}",
        f":TRIGGER:MAIN:EDGE:SOURCE {channel};:TRIGGER:MAIN:LEVEL {gyro.offset:g}",
    )
    with scope.lock:
        for _ in scope.execute(";".join(knobs).encode()):
            pass
        # what was taken with the knobs as they stood before is not for a client
        while (record := scope.acquisition.latest()) is None or record.seconds_per_division != base:
            instruments.clock.sleep(base)


def true_values(instruments: SimulatedInstruments) -> dict[str, float]:
    """Return what the last record should give, with the names of the results.

    Parameters
    ----------
    instruments : SimulatedInstruments

    Returns
    -------
    dict
        Means over the time of the record; empty if there is no record.
    """
    with instruments.scope.lock:
        record = instruments.scope.acquisition.record
    if record is None:
        return {}
    gyro, duration = instruments.gyro, 2500 * record.xincr
    times = record.starts[-1] + np.linspace(0.0, duration, _TRUTH_POINTS)
    rates = axis_rate_on_table(gyro, instruments.table.motion, times)
    return {
        "lock_in_rate_dps": gyro.lock_in_rate,
        "input_rate_dps": float(np.mean(np.abs(rates))),
        "beat_frequency_hz": float(np.mean(np.abs(gyro.beat_frequency(rates)))),
        "ratio": float(np.mean(harmonic_ratio(rates, gyro.lock_in_rate))),
        "backscatter_phase_rad": gyro.backscatter_phase - gyro.readout_phase,
        "amplitude_v": gyro.amplitude,
    }
