"""Whole setups: as a text, in the scope's ten memories, from the factory, or chosen by the scope itself.

Programmer manual 071-1075-04, pp. 2-53, 2-186 to 2-198.
"""

from __future__ import annotations

from instrument.dialogue.events import is_error
from instrument.errors import SettingError
from instrument.tds2014.session import Session
from instrument.tds2014.setup_text import read_setup, write_setup

MEMORIES = range(1, 11)
"""Numbers of the setup memories inside the scope."""

FACTORY = "FACTORY"

_AUTOSET_TIME = 10.0  # s: several acquisitions at different settings


class Setups:
    """All settings at once; what they change is put back on closing."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def read_setup(self) -> str:
        """All settings as a text that `write_setup` takes."""
        return read_setup(self._session.dialogue)

    def write_setup(self, setup: str) -> None:
        """Make all settings as in a text from `read_setup`; SettingError if one cannot be made."""
        self._session.before_changing_all()
        write_setup(self._session.dialogue, setup)

    def save_setup(self, memory: int) -> None:
        """Keep the present settings in memory 1 to 10 of the scope, over what was there."""
        self._session.dialogue.command(f":SAVE:SETUP {_memory(memory)}")

    def recall_setup(self, memory: int | str) -> None:
        """Make all settings as in memory 1 to 10, or as at the ``"FACTORY"``; put back on closing."""
        place = FACTORY if str(memory).upper() == FACTORY else str(_memory(memory))
        self._session.before_changing_all()
        self._session.dialogue.command(f":RECALL:SETUP {place}")
        self._session.dialogue.set_format()

    def autoset(self) -> None:
        """Let the scope choose scales, time base and trigger; put back on closing."""
        self._session.before_changing_all()
        _, events = self._session.dialogue.ask_with_events(":AUTOSET EXECUTE;*WAI", parts=0, wait=_AUTOSET_TIME)
        for event in events:
            if is_error(event):
                raise event


def _memory(number: int | str) -> int:
    if number not in MEMORIES:
        raise SettingError(f"there is no setup memory {number!r}; choose 1 to {MEMORIES[-1]}")
    return int(number)
