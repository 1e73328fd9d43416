"""The simulated scope as somebody meets it first: without any argument, with factory settings."""

import subprocess
import sys

import numpy as np
import pyvisa

from instrument import TDS2014
from instrument.simulated import resource_manager

WITHOUT_SCIPY = """
import sys
from instrument.simulated import SimulatedTDS2014, VirtualClock
scope = SimulatedTDS2014({1: lambda t: t % 1e-3}, clock=VirtualClock())
for message in (b"CH1:COUPLING AC", b"SELECT:MATH ON", b"MATH:DEFINE 'FFT(CH1)'", b"DATA:SOURCE MATH", b"CURVE?"):
    for answer in scope.execute(message):
        if answer is None:
            scope.clock.sleep(0.01)
assert len(answer) > 1024, answer
assert "scipy" not in sys.modules
"""


def test_default_signals_stand_well_on_the_screen():
    visa = resource_manager()
    with TDS2014("GPIB0::1::INSTR", resource_manager=visa) as scope:
        scope.set_channel(2)
        first, second = scope.acquire((1, 2))
    visa.close()
    for waveform in (first, second):
        assert not waveform.clipped
        assert 80 < np.ptp(waveform.codes) < 130  # of the 200 levels of the screen
    # a quarter of a period apart: together a circle
    assert np.hypot(first.volts, second.volts).std() < 0.1
    assert abs(float(np.mean(first.volts * second.volts))) < 0.1


def test_backend_shows_the_same_signals():
    manager = pyvisa.ResourceManager("@gyrolock")
    with TDS2014("ASRL1::INSTR", resource_manager=manager) as scope:
        waveform = scope.acquire(1)
    manager.close()
    assert not waveform.clipped
    assert 80 < np.ptp(waveform.codes) < 130


def test_spectrum_and_ac_coupling_need_numpy_only():
    result = subprocess.run([sys.executable, "-c", WITHOUT_SCIPY], capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stderr
