"""Commands that act on the acquisition and the trigger.

Source: programmer manual 071-1075-04, pp. 2-45 to 2-52 and 2-221 to 2-239.
"""

from __future__ import annotations

import numpy as np

from instrument.simulated.commands.action import Action, answer, one_argument
from instrument.simulated.panel import panel_rules
from instrument.simulated.panel.event_table import Guess, Refusal
from instrument.simulated.panel.formats import INVALID, nr3
from instrument.simulated.panel.kinds import Words
from instrument.simulated.panel.parsing import Argument
from instrument.simulated.state import ScopeState

_COUNTER_GATE = 0.25  # s, window of the trigger frequency counter
_COUNTER_POINTS = 1 << 16
_SLOWEST_COUNTED = 10.0  # Hz

_STATES = Words(
    "ARMed", "REAdy", "TRIgger", "AUTo", "SAVe", "SCAn"
)  # SAV was seen, the other short forms are guesses
_FORCE = Words("FORCe")
_SET_LEVEL = Words("SETLevel")


def _force_trigger(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    _FORCE.read(one_argument(arguments))
    if not state.acquisition.force_trigger() and Guess.TRIGGER_IGNORED:
        raise Refusal(Guess.TRIGGER_IGNORED)


def _level_to_half(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """TRIGger:MAIn SETLevel: the middle between the extremes of the trigger signal."""
    _SET_LEVEL.read(one_argument(arguments))
    if not state.acquisition.running:
        raise Refusal(221)
    state.acquisition.settle()
    volts = _recent_trigger_signal(state)
    middle = float(volts.max() + volts.min()) / 2
    panel_rules.store(state.panel, "TRIGGER:MAIN:LEVEL", float(f"{middle:.6e}"))


def _trigger_frequency(state: ScopeState) -> str:
    """Rising edges through the level in the counter's gate; below 10 Hz no number and event 2207."""
    if state.panel.text("TRIGGER:MAIN:TYPE") == "VIDEO":
        state.status.post(221)
        return nr3(INVALID)
    above = _recent_trigger_signal(state) >= state.panel.number("TRIGGER:MAIN:LEVEL")
    edges = np.flatnonzero(~above[:-1] & above[1:])
    if len(edges) < 2:
        state.status.post(2207)
        return nr3(INVALID)
    step = _COUNTER_GATE / _COUNTER_POINTS
    frequency = (len(edges) - 1) / (float(edges[-1] - edges[0]) * step)
    if frequency < _SLOWEST_COUNTED:
        state.status.post(2207)
        return nr3(INVALID)
    return nr3(frequency, 6)


def _recent_trigger_signal(state: ScopeState) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    times = state.clock.now() - _COUNTER_GATE * (1 - np.arange(_COUNTER_POINTS) / _COUNTER_POINTS)
    return np.asarray(state.acquisition.trigger_signal(state.panel.trigger(), times)).reshape(-1)


def _trigger_state(state: ScopeState) -> str:
    return _STATES.write(state.acquisition.state(), state.panel.flag("VERBOSE"))


def _acquisitions(state: ScopeState) -> str:
    state.acquisition.update()
    return str(0 if state.panel.scanning else state.acquisition.acquisitions)


ACTIONS = {
    "ACQuire:NUMACq": Action(answer("ACQuire:NUMACq", _acquisitions)),
    "TRIGger": Action(order=_force_trigger),
    "TRIGger:STATE": Action(answer("TRIGger:STATE", _trigger_state)),
    "TRIGger:MAIn": Action(order=_level_to_half),
    "TRIGger:MAIn:FREQuency": Action(answer("TRIGger:MAIn:FREQuency", _trigger_frequency)),
}
