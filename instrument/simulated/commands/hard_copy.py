"""HARDCopy: the picture of the screen goes out on the link, as a file without header or terminator.

Source: programmer manual 071-1075-04, pp. 2-126 to 2-131.
"""

from __future__ import annotations

from instrument.simulated.commands.action import Action
from instrument.simulated.files.picture_formats import FORMATS
from instrument.simulated.files.screen import draw
from instrument.simulated.panel.event_table import Guess, Refusal
from instrument.simulated.panel.kinds import Words
from instrument.simulated.panel.parsing import Argument
from instrument.simulated.state import ScopeState

_ORDERS = Words("STARt", "ABOrt")


def _hard_copy(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """STARt sends the picture, if a link and not a printer is the port; printer languages are refused."""
    if len(arguments) > 1:
        raise Refusal(Guess.SURPLUS_ARGUMENT)
    word = _ORDERS.read(arguments[0]) if arguments else "START"
    if word == "ABORT" or state.panel.text("HARDCOPY:PORT") == "CENTRONICS":
        return
    write = FORMATS.get(state.panel.text("HARDCOPY:FORMAT"))
    if write is None:
        raise Refusal(Guess.PICTURE_FORMAT_NOT_SIMULATED)
    state.picture = write(draw(state.screen_traces()))


ACTIONS = {"HARDCopy": Action(order=_hard_copy, waits=lambda state: state.awaits_record())}
