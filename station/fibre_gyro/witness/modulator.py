"""The voltage on the phase modulator of the simulated gyro, and a simulated oscilloscope that shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import ClosedLoop
from instrument import TDS2014
from instrument.simulated import SimulatedTDS2014, VirtualClock
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.simulated_bench import loop_settings
from station.scope.open import open_scope
from station.scope.serve import serve

Floats = NDArray[np.float64]

_DRIVER_TIME_CONSTANT_S = 0.05e-6
_TRACE_SAMPLES = 512


def modulator_voltage(settings: FogSettings) -> Callable[[Floats], Floats]:
    """Return the voltage on the modulator as a function of time, with the feedback held and a step injected.

    The loop is computed at every transit time for a while and its staircase then continued with the same steps:
    in open loop nothing else happens.
    """
    coil, loop = settings.coil, loop_settings(settings)
    gyro = ClosedLoop(coil, loop, settings.simulation.seed, kernel="numpy")
    gyro.clear_feedback()
    trace = gyro.trace(_TRACE_SAMPLES, injected_step=settings.witness.step_codes, closed=False)
    staircase, bias = trace.staircase.astype(np.int64), (trace.code - trace.staircase)[:2].astype(np.int64)
    whole = staircase.size - 2  # an even number, so that the bias fits
    grown = int(staircase[whole] - staircase[0])
    volts_per_code = 2 * settings.simulation.half_wave_v * (1 + loop.two_pi_error) / loop.codes

    def volts_of(number: NDArray[np.int64]) -> Floats:
        laps, place = np.divmod(number, whole)
        counter = np.mod(staircase[place] + laps * grown, loop.wrap)
        return np.asarray(volts_per_code * (counter + bias[number % 2]), dtype=np.float64)

    def voltage(times: Floats) -> Floats:
        turns = np.asarray(times, dtype=np.float64) / coil.transit_time
        number = np.floor(turns).astype(np.int64)
        # what is left of the edge behind the driver of the modulator
        left = np.exp(-(turns - number) * coil.transit_time / _DRIVER_TIME_CONSTANT_S)
        before, now = volts_of(number - 1), volts_of(number)
        return np.asarray((now + (before - now) * left) * (1 + settings.simulation.scope_gain_error))

    return voltage


@contextmanager
def open_simulated_scope(settings: FogSettings, *, times_resumed: int = 0) -> Iterator[TDS2014]:
    """Open a simulated oscilloscope on the modulator, through a real byte stream; its clock jumps over waiting."""
    witness, seed = settings.witness, settings.simulation.seed
    if times_resumed:
        seed = int(np.random.SeedSequence([seed, times_resumed]).generate_state(1)[0])
    voltage = modulator_voltage(settings)
    scope = SimulatedTDS2014(
        {int(witness.channel[2:]): lambda times: voltage(times) / witness.probe},
        clock=VirtualClock(),
        seed=seed,
    )
    with serve(scope, "auto") as resource, open_scope(resource, read_twice=False) as opened:
        yield opened
