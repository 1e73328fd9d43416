"""What one message asks for happens at one moment, however slowly the computer gets through it."""

import numpy as np

from instrument.simulated import SimulatedTDS2014
from instrument.simulated.links.exchange import MessageExchange


class SlowComputer:
    """A clock by which every look takes a tenth of a second: longer than an acquisition."""

    virtual = False

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        self._now += 0.1
        return self._now

    def sleep(self, seconds: float) -> None:
        self._now += max(seconds, 0.0)


def test_no_record_is_taken_between_two_settings_of_one_message() -> None:
    """Between *RST and the probe factor 40 V would be on the screen, and the record clipped."""
    scope = SimulatedTDS2014({1: lambda t: 2 * np.sin(2e3 * np.pi * t)}, clock=SlowComputer(), noise_levels=0.0)
    link = MessageExchange(scope, message_ends=True)
    link.receive(b"HEADER OFF;:HORIZONTAL:SCALE 2.5E-4;:CH1:PROBE 1;SCALE 5")
    link.receive(b"*RST;:CH1:PROBE 1;SCALE 1;:DATA:ENCDG RIBINARY;WIDTH 1;:CURVE?;:WFMPRE:XINCR?")
    curve, _, interval = (link.wait_for_answer(60.0) or b"").rpartition(b";")
    assert np.ptp(np.frombuffer(curve[6:], dtype=np.int8).astype(int)) == 100
    # of the settings that *RST made: 500 us/div
    assert float(interval) == 2e-6


def test_an_answer_has_the_headers_of_its_moment() -> None:
    scope = SimulatedTDS2014()
    link = MessageExchange(scope, message_ends=True)
    link.receive(b"ACQUIRE:NUMAVG?;:VERBOSE OFF;:ACQUIRE:NUMAVG?;:HEADER OFF;:ACQUIRE:NUMAVG?;:VERBOSE ON")
    assert link.wait_for_answer(1.0) == b":ACQUIRE:NUMAVG 16;:ACQ:NUMAV 16;16\n"


def test_the_front_panel_is_unlocked_by_either_command() -> None:
    scope = SimulatedTDS2014()
    link = MessageExchange(scope, message_ends=True)
    link.receive(b"HEADER OFF;:LOCK ALL;:LOCK?;:UNLOCK ALL;:LOCK?;:LOCK ALL;:LOCK NONE;:LOCK?")
    assert link.wait_for_answer(1.0) == b"ALL;NONE;NONE\n"


def test_time_goes_on_while_a_message_waits() -> None:
    scope = SimulatedTDS2014(clock=SlowComputer())
    link = MessageExchange(scope, message_ends=True)
    link.receive(b"HEADER OFF;:ACQUIRE:STOPAFTER SEQUENCE;STATE RUN;*WAI;STATE?;:ACQUIRE:NUMACQ?")
    assert link.wait_for_answer(60.0) == b"0;1\n"
    assert scope.message_clock.now() < scope.message_clock.now()
