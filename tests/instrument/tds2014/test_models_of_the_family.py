"""The whole driver once through on several models, with everything put back at the end."""

import numpy as np
import pytest

from instrument import TDS2014
from instrument.simulated import SimulatedTDS2014, VirtualClock, resource_manager
from instrument.tds2014.front_panel import settings_of

USB = "USB0::0x0699::0x0368::C010101::INSTR"


def sine(times):
    return 0.8 * np.sin(2 * np.pi * 1000.0 * times)


@pytest.mark.parametrize("name", ["GPIB0::1::INSTR", USB])
@pytest.mark.parametrize("model", ["TDS1002", "TDS2012B", "TDS2014", "TDS2014C", "TDS2024B", "TPS2014"])
def test_everything_on_every_model(model, name):
    simulated = SimulatedTDS2014({1: sine}, model=model, clock=VirtualClock())
    visa = resource_manager(scopes={name: simulated})

    def front_panel():
        return settings_of(b"".join(answer or b"" for answer in simulated.execute(b"SET?")).decode())

    # The mains have no trigger level: setting one back is refused.
    for command in (b"TRIGGER:MAIN:EDGE:SOURCE LINE", b"CH1:PROBE 1"):
        list(simulated.execute(command))
    found = front_panel()
    with TDS2014(name, resource_manager=visa) as scope:
        assert scope.identity.model.replace(" ", "") == model
        assert len(scope.channels) == (4 if model.rstrip("BC").endswith("4") else 2)
        scope.set_channel(1, scale=0.5)
        scope.set_timebase(2.5e-4)
        scope.acquire(1)
        assert scope.measure("FREQUENCY", 1).value == pytest.approx(1000, rel=0.01)
        setup = scope.read_setup()
        scope.recall_setup("FACTORY")
        scope.autoset()
        scope.save_reference("REFB", 1)
        scope.set_cursors("VBARS", positions=(-1e-4, 1e-4))
        scope.set_math("FFT(CH2)")
        assert scope.screen().png.startswith(b"\x89PNG")
        scope.write_setup(setup)
        assert len(scope.acquire((1,))) == 1
        assert front_panel() != found
    assert front_panel() == found
    visa.close()
