"""The simulated bench: gyro, rate table and oscilloscope on one clock."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.arrays import NoFit
from analysis.ring_laser import (
    Detector,
    Dither,
    DitheredFringe,
    Gyro,
    NoisySignal,
    Winking,
    axis_rate_on_table,
    beat_signal_on_table,
    mean_beat_on_table,
    signal_above,
    signal_bounds,
    smooth_interval,
)
from instrument import RateTable
from instrument.scpi import POINTS
from instrument.simulated import SimulatedRateTable, SimulatedTDS2014, VirtualClock
from instrument.simulated.clock import Clock
from instrument.simulated.controllers import RateTableController, TableMotion
from station.controllers import open_simulated_rate_table, open_surroundings
from station.errors import UsageError
from station.results.numbers import AMPLITUDE, BACKSCATTER_PHASE, BEAT_FREQUENCY, INPUT_RATE, LOCK_IN_RATE
from station.ring_laser.records import Bench
from station.ring_laser.settings import BenchSettings, SimulationSettings
from station.scope.tools import open_scope, serve

Array = NDArray[np.float64]

_TRUTH_POINTS = 201
_TURN_POINTS = 181


class TurningTable(SimulatedRateTable):
    """The simulated rate table of the bench: it comes back from a new rate when it turns steadily."""

    # ``when_steady``, if it is set, is called with the new piece of motion then.

    when_steady: Callable[[TableMotion], None] | None = None

    def set_rate(self, rate_dps: float) -> None:
        """Bring the table to a rate in deg/s and return when it turns steadily."""
        before = self.motion
        super().set_rate(rate_dps)
        if self.motion is before:
            return
        self.wait_until_steady()
        if self.when_steady is not None:
            try:
                self.when_steady(self.motion[-1])
            except UsageError:
                self.motion = before  # the scope must be able to answer until the end
                raise


@dataclass(frozen=True)
class SimulatedInstruments:
    """Everything on the simulated bench, before it is put behind a link."""

    clock: Clock
    table: TurningTable
    gyro: Gyro
    detector: Detector
    scope: SimulatedTDS2014
    link: str


def build_instruments(settings: BenchSettings, clock: Clock, *, times_resumed: int = 0) -> SimulatedInstruments:
    """Put gyro, table and oscilloscope together, as the settings and their seed say."""
    simulation = settings.simulation
    if simulation is None:
        raise UsageError("these settings describe a real bench: there is no [simulation] in them")
    if times_resumed:
        again = np.random.SeedSequence([simulation.seed, times_resumed]).generate_state(1)[0]
        simulation = simulation.model_copy(update={"seed": int(again)})
    start = np.random.default_rng([simulation.seed, 0x6B])
    table = TurningTable(
        clock, acceleration=simulation.table_acceleration_dps2, azimuth=float(start.uniform(0.0, 360.0))
    )
    table.set_rate(settings.turning_dps)
    gyro = _gyro(settings, simulation, float(start.uniform(0.0, 2 * math.pi)))
    detector = _detector(simulation)
    if detector.filtered or gyro.winking is not None:
        table.when_steady = lambda steady: _prepare(gyro, detector, table, steady)
        table.when_steady(table.motion[-1])
    signals = {settings.scope.channel: _signal(gyro, detector, table, simulation, 0)}
    if settings.dither.on:
        signals = {settings.scope.channel: _dithered(gyro, detector, table, simulation)}
    elif settings.scope.quadrature_channel:
        added = simulation.contaminants
        further = math.pi / 2 + math.radians(added.quadrature_phase_error_deg)
        cosine = replace(
            detector,
            readout_phase=detector.readout_phase + further,
            amplitude=detector.amplitude * (1 + added.quadrature_gain_error),
        )
        signals[settings.scope.quadrature_channel] = _signal(gyro, cosine, table, simulation, 1)
    light = simulation.beams
    for beam, channel in enumerate(settings.beams.channels, 1):
        crosstalk = _share(light.crosstalk_db) * simulation.amplitude_v
        one = Detector(
            detector.readout_phase,
            amplitude=light.level_v[beam - 1],
            offset=light.level_v[beam - 1],
            pump_ripple=detector.pump_ripple,
            pump_hz=detector.pump_hz,
            beam=beam,
            crosstalk_v=crosstalk,
        )
        quiet = simulation.model_copy(update={"detector_noise_v": light.noise_v})
        signals[channel] = _signal(gyro, one, table, quiet, 1 + beam)
    try:
        scope = SimulatedTDS2014(
            {int(channel[2:]): signal for channel, signal in signals.items()},
            model=simulation.scope_model,
            clock=clock,
            noise_levels=simulation.scope_noise_levels,
            seed=simulation.seed,
        )
    except ValueError as error:
        raise UsageError(f"simulation.scope_model: {error}") from None
    return SimulatedInstruments(clock, table, gyro, detector, scope, simulation.link)


def _prepare(gyro: Gyro, detector: Detector, table: TurningTable, steady: TableMotion) -> None:
    """Work out the beat of a whole turn beforehand: the scope must not keep a program waiting for it."""
    turn_s = 360.0 / max(abs(steady.rate_dps), 1e-3)
    try:
        beat_signal_on_table(gyro, detector, table.motion, steady.start + np.linspace(0.0, turn_s, _TURN_POINTS))
    except NoFit as error:
        wrong = f"simulation.contaminants: {error}"
        raise UsageError(f"{wrong}; set a larger gain_corner_hz or a smaller backscatter_phase_sum_deg") from None


def _gyro(settings: BenchSettings, simulation: SimulationSettings, start_phase: float) -> Gyro:
    added = simulation.contaminants
    scale_factor = settings.gyro.scale_factor_pulses_per_deg * (1 + 1e-6 * added.scale_factor_error_ppm)
    winking = None
    if added.gain_corner_hz > 0 and simulation.lock_in_rate_dps > 0:
        winking = Winking(
            scale_factor,
            simulation.lock_in_rate_dps,
            gain_corner_hz=added.gain_corner_hz,
            phase_sum=math.radians(added.backscatter_phase_sum_deg),
            cross_saturation=added.cross_saturation,
            backscatter_ratio=added.backscatter_ratio,
            beam_imbalance=added.beam_imbalance,
            gain_dispersion=added.gain_dispersion,
        )
    return Gyro(
        scale_factor=scale_factor,
        lock_in_rate=simulation.lock_in_rate_dps,
        backscatter_phase=math.radians(simulation.backscatter_phase_deg),
        tilt_deg=simulation.tilt_deg,
        latitude_deg=settings.site.latitude_deg,
        north_azimuth_deg=settings.table.north_azimuth_deg,
        start_phase=start_phase,
        scale_factor_drift_ppm_per_hour=added.scale_factor_drift_ppm_per_hour,
        ripple_dps=added.rate_ripple_dps,
        ripple_hz=added.rate_ripple_hz,
        winking=winking,
    )


def _detector(simulation: SimulationSettings) -> Detector:
    added = simulation.contaminants
    return Detector(
        readout_phase=math.radians(simulation.readout_phase_deg),
        amplitude=simulation.amplitude_v,
        offset=simulation.offset_v,
        # s^2 of a sine of amplitude 1 has the second harmonic 1/2, s^3 the third harmonic 1/4
        second_order=2 * _share(added.second_harmonic_dbc),
        third_order=4 * _share(added.third_harmonic_dbc),
        low_pass_hz=added.bandwidth_hz,
        ac_corner_hz=added.ac_corner_hz,
        pump_ripple=added.pump_ripple,
        pump_hz=added.pump_ripple_hz,
        single_beams=added.single_beams,
    )


def _share(dbc: float | None) -> float:
    return 0.0 if dbc is None else 10 ** (dbc / 20)


def _signal(
    gyro: Gyro, detector: Detector, table: TurningTable, simulation: SimulationSettings, channel: int
) -> Callable[[Array], Array]:
    def silent(times: Array) -> Array:
        return beat_signal_on_table(gyro, detector, table.motion, times)

    def interval(start: float, stop: float) -> float:
        return smooth_interval(gyro, detector, table.motion, start, stop)

    def bounds(start: float, stop: float) -> tuple[float, float]:
        return signal_bounds(gyro, detector, table.motion, start, stop)

    def above(corner_hz: float, start: float, stop: float) -> Callable[[Array], Array] | None:
        return signal_above(gyro, detector, table.motion, corner_hz, start, stop)

    def mean(starts: Array, times: Array, corner_hz: float, settling_s: float) -> Array | None:
        return mean_beat_on_table(
            gyro, detector, table.motion, starts, times, corner_hz=corner_hz, settling_s=settling_s
        )

    noise = simulation.detector_noise_v
    return NoisySignal(silent, noise, simulation.seed, channel, interval, bounds, above, mean)


def _dithered(
    gyro: Gyro, detector: Detector, table: TurningTable, simulation: SimulationSettings
) -> Callable[[Array], Array]:
    """The beat of a gyro whose body dithers, at a receiver that is fast enough for it."""
    moves = simulation.dither
    dither = Dither(moves.rate_dps, moves.frequency_hz, 0.01 * moves.noise_percent, simulation.seed)

    def bias(times: Array) -> Array:
        return axis_rate_on_table(gyro, table.motion, times)

    fringe = DitheredFringe(gyro, dither, bias, moves.bandwidth_hz)

    def silent(times: Array) -> Array:
        return detector.volts(fringe(times), gyro.backscatter_phase) * detector.swing(times)

    return NoisySignal(silent, simulation.detector_noise_v, simulation.seed)


def true_values(instruments: SimulatedInstruments) -> dict[str, float]:
    """Return what the last record should give, with the names of the results."""
    with instruments.scope.lock:
        record = instruments.scope.acquisition.record
    if record is None:
        return {}
    gyro, duration = instruments.gyro, POINTS * record.xincr
    times = record.starts[-1] + np.linspace(0.0, duration, _TRUTH_POINTS)
    rates = axis_rate_on_table(gyro, instruments.table.motion, times)
    return {
        LOCK_IN_RATE.key(): gyro.lock_in_rate,
        INPUT_RATE.key(): float(np.mean(np.abs(rates))),
        BEAT_FREQUENCY.key(): float(np.mean(np.abs(gyro.beat_frequency(rates) * gyro.drift(times)))),
        "ratio": float(np.mean(gyro.harmonic_ratio(rates))),
        BACKSCATTER_PHASE.key(): gyro.backscatter_phase - instruments.detector.readout_phase,
        AMPLITUDE.key(): instruments.detector.amplitude,
    }


# --------------------
# The simulated bench: table, gyro and oscilloscope on one clock, the scope behind a real byte stream


@contextmanager
def open_simulated_bench(
    settings: BenchSettings, *, times_resumed: int = 0, tell: Callable[[str], None] = lambda text: None
) -> Iterator[Bench]:
    """Open the simulated bench: on a clock that jumps instead of waiting, through a real link."""
    instruments = build_instruments(settings, VirtualClock(), times_resumed=times_resumed)
    clock, truth = instruments.clock, lambda: true_values(instruments)
    with (
        serve(instruments.scope, instruments.link) as resource,
        open_scope(resource, simulated=True) as scope,
        _table(settings, instruments, tell) as table,
        open_surroundings(settings.controllers, tell=tell, simulated=True) as surroundings,
    ):
        yield Bench(scope, table, clock.sleep, truth, clock.now, surroundings)


@contextmanager
def _table(
    settings: BenchSettings, instruments: SimulatedInstruments, tell: Callable[[str], None]
) -> Iterator[RateTable | None]:
    """The simulated table: within this program, or through the bytes of its controller."""
    named = None if settings.controllers is None else settings.controllers.rate_table
    if settings.table.kind == "controller" and named is not None:
        device = RateTableController(instruments.table)
        with open_simulated_rate_table(device, named, instruments.clock, tell) as table:
            yield table
        return
    yield None if settings.table.kind == "none" else instruments.table
