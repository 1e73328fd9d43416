"""The answer to ``SET?``: all settings as a text that can be kept, compared and sent back.

Programmer manual 071-1075-04, pp. 2-195 to 2-198.
"""

from __future__ import annotations

from instrument import scpi
from instrument.dialogue.dialogue import Dialogue
from instrument.errors import SettingError, TransferError

# These belong to the driver and its link, or say whether an acquisition runs at this moment.
_NOT_PART = (":HEADER", ":VERBOSE", ":DATA", ":LOCK", ":RS232", ":ACQUIRE:STATE")


def read_setup(dialogue: Dialogue) -> str:
    """All settings as one text of commands."""
    setup = ";".join(dialogue.ask("SET?", parts=None))
    if not setup.startswith(":") or not settings_of(setup):
        raise TransferError(f"a setup was expected, but {setup[:40]!r} came; ask again")
    return setup


def write_setup(dialogue: Dialogue, setup: str) -> None:
    """Send a setup back and compare what the scope then holds.

    The commands go one branch at a time, so that a slow line's input buffer is not overrun. What the scope
    refuses without need (the level of a mains trigger) does not matter as long as the values agree at the end.

    Raises
    ------
    SettingError
        If a setting is not as in `setup`; names the first one.
    """
    wanted = settings_of(setup)
    if not wanted:
        raise SettingError(f"{setup[:40]!r} is not a setup; give a text that read_setup() returned")
    for branch in _branches(setup):
        dialogue.ask_with_events(branch, parts=0)
    held = settings_of(read_setup(dialogue))
    for command, value in wanted.items():
        if held.get(command, value) != value:
            raise SettingError(
                f"{command.lstrip(':')} was set to {value} but the scope holds {held[command]}; "
                "is the setup of another model?"
            )


def settings_of(setup: str) -> dict[str, str]:
    """The settings of a setup by their whole command.

    A part without a leading colon continues the branch of the one before it.

    >>> settings_of(":CH1:PROBE 10;SCALE 1.0E0;:LOCK NONE;:CURSOR:SELECT:SOURCE CH1")
    {':CH1:PROBE': '10', ':CH1:SCALE': '1.0E0', ':CURSOR:SELECT:SOURCE': 'CH1'}
    """
    found: dict[str, str] = {}
    branch = ":"
    for part in scpi.split_parts(setup):
        header, value = scpi.split_header(part)
        command = header if header.startswith(":") else f"{branch}{header}"
        branch = command[: command.rindex(":") + 1]
        if header and not command.startswith(_NOT_PART):
            found[command] = value
    return found


def _branches(setup: str) -> list[str]:
    """The settings as messages of one branch each, in the order of the setup."""
    messages: dict[str, list[str]] = {}
    for command, value in settings_of(setup).items():
        messages.setdefault(command[: command.rindex(":")], []).append(f"{command} {value}")
    return [";".join(commands) for commands in messages.values()]
