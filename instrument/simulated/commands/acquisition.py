"""Commands that act on the acquisition and the trigger.

Source: programmer manual 071-1075-04, pp. 2-45 to 2-52 and 2-221 to 2-239.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from instrument.simulated.commands.action import Action, answer, one_argument
from instrument.simulated.panel import panel_rules
from instrument.simulated.panel.event_table import Guess, Refusal
from instrument.simulated.panel.formats import INVALID, nr3
from instrument.simulated.panel.kinds import Words
from instrument.simulated.panel.parsing import Argument

if TYPE_CHECKING:
    from instrument.simulated.scope import SimulatedTDS2014

_COUNTER_GATE = 0.25  # s, window of the trigger frequency counter
_COUNTER_POINTS = 1 << 16
_SLOWEST_COUNTED = 10.0  # Hz

_FORCE = Words("FORCe")
_SET_LEVEL = Words("SETLevel")


def _force_trigger(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    _FORCE.read(one_argument(arguments))
    if not scope.acquisition.force_trigger() and Guess.TRIGGER_IGNORED:
        raise Refusal(Guess.TRIGGER_IGNORED)


def _level_to_half(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    """TRIGger:MAIn SETLevel: the middle between the extremes of the trigger signal."""
    _SET_LEVEL.read(one_argument(arguments))
    if not scope.acquisition.running:
        raise Refusal(221)
    volts = _recent_trigger_signal(scope)
    middle = float(volts.max() + volts.min()) / 2
    panel_rules.store(scope.panel, "TRIGGER:MAIN:LEVEL", float(f"{middle:.6e}"))


def _trigger_frequency(scope: SimulatedTDS2014) -> str:
    """Rising edges through the level in the counter's gate; below 10 Hz no number and event 2207."""
    if scope.panel.text("TRIGGER:MAIN:TYPE") == "VIDEO":
        scope.status.post(221)
        return nr3(INVALID)
    above = _recent_trigger_signal(scope) >= scope.panel.number("TRIGGER:MAIN:LEVEL")
    edges = np.flatnonzero(~above[:-1] & above[1:])
    if len(edges) < 2:
        scope.status.post(2207)
        return nr3(INVALID)
    step = _COUNTER_GATE / _COUNTER_POINTS
    frequency = (len(edges) - 1) / (float(edges[-1] - edges[0]) * step)
    if frequency < _SLOWEST_COUNTED:
        scope.status.post(2207)
        return nr3(INVALID)
    return nr3(frequency, 6)


def _recent_trigger_signal(scope: SimulatedTDS2014) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    times = scope.clock.now() - _COUNTER_GATE * (1 - np.arange(_COUNTER_POINTS) / _COUNTER_POINTS)
    return np.asarray(scope.acquisition.trigger_signal(scope.panel.trigger(), times)).reshape(-1)


def _acquisitions(scope: SimulatedTDS2014) -> str:
    scope.acquisition.update()
    return str(0 if scope.panel.scanning else scope.acquisition.acquisitions)


ACTIONS = {
    "ACQuire:NUMACq": Action(answer("ACQuire:NUMACq", _acquisitions)),
    "TRIGger": Action(order=_force_trigger),
    "TRIGger:STATE": Action(answer("TRIGger:STATE", lambda scope: scope.acquisition.state())),
    "TRIGger:MAIn": Action(order=_level_to_half),
    "TRIGger:MAIn:FREQuency": Action(answer("TRIGger:MAIn:FREQuency", _trigger_frequency)),
}
