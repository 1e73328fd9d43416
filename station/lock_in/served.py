"""Simulated oscilloscopes alone, in real time: on a gyro that turns at the slow rate, or on other signals."""

from collections.abc import Sequence

import numpy as np

from instrument.scpi import LEVELS_PER_DIVISION, VERTICAL_SCALES
from instrument.simulated import Fault, RealClock, SimulatedRateTable, SimulatedTDS2014
from station.errors import UsageError
from station.lock_in.settings import Settings
from station.ring_laser.instruments import SimulatedInstruments, build_instruments
from station.scope.autoset import oscilloscope_steps
from station.scope.tools import ShownSignal


def at_slow_rate(settings: Settings) -> Settings:
    """Return settings of a bench whose table turns at the slow rate from the beginning."""
    return settings.model_copy(update={"table": settings.table.model_copy(update={"kind": "none"})})


def simulated_scopes(
    settings: Settings,
    *,
    signals: Sequence[ShownSignal] = (),
    models: Sequence[str] = (),
    faults: Sequence[Fault] = (),
) -> list[SimulatedTDS2014]:
    """Oscilloscopes in real time, set so that what they show fills their screens."""
    clock, scopes = RealClock(), []
    for number, model in enumerate(models or ("",)):
        one, simulation = settings, settings.simulation
        if simulation is not None:
            changes = {"seed": simulation.seed + number, **({"scope_model": model} if model else {})}
            one = settings.model_copy(update={"simulation": simulation.model_copy(update=changes)})
        instruments = build_instruments(at_slow_rate(one), clock)
        if signals:
            scopes.append(_showing(signals, one, instruments))
        else:
            _show_the_beat(instruments, one)
            scopes.append(instruments.scope)
        scopes[-1].faults.add(*faults)
    return scopes


def scope_on_table(settings: Settings) -> tuple[SimulatedTDS2014, SimulatedRateTable]:
    """Return a simulated oscilloscope at the beat of the gyro, in real time, and the table under it."""
    instruments = build_instruments(at_slow_rate(settings), RealClock())
    _show_the_beat(instruments, settings)
    return instruments.scope, instruments.table


def _showing(
    signals: Sequence[ShownSignal], settings: Settings, instruments: SimulatedInstruments
) -> SimulatedTDS2014:
    """A scope of the same model on other signals, after AUTOSET."""
    gyro = instruments.scope.acquisition.signal(settings.scope.channel)
    inputs = {shown.channel: shown.signal or gyro for shown in signals}
    if len(inputs) < len(signals):
        raise UsageError("--signal: one channel has two signals; write CH2= before the second one")
    model = instruments.scope.model
    if max(inputs) > model.channels:
        raise UsageError(f"--signal: a {model.name} has no CH{max(inputs)}")
    simulation = settings.simulation
    scope = SimulatedTDS2014(
        inputs,
        model=model.name,
        clock=instruments.clock,
        noise_levels=simulation.scope_noise_levels if simulation else 0.0,
        seed=simulation.seed if simulation else 0,
    )
    probes = ";".join(f":SELECT:CH{n} {int(n in inputs)};:CH{n}:PROBE 1" for n in range(1, model.channels + 1))
    with scope.lock:
        for message in (probes, "AUTOSET EXECUTE"):
            for _ in scope.execute(message.encode()):
                pass
    return scope


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
