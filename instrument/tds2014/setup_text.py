"""The answer to ``SET?``: all settings as a text that can be kept, compared and sent back.

Programmer manual 071-1075-04, pp. 2-195 to 2-198.
"""

from __future__ import annotations

from instrument import scpi
from instrument.dialogue.dialogue import Dialogue
from instrument.errors import SettingError, TransferError

_ROUNDS = 3

# These belong to the driver and its link, or say whether an acquisition runs at this moment.
_NOT_PART = (":HEADER", ":VERBOSE", ":DATA", ":LOCK", ":RS232", ":ACQUIRE:STATE")


def read_setup(dialogue: Dialogue) -> str:
    """All settings as one text of commands."""
    setup = ";".join(dialogue.ask(":SET?", parts=None, twice=True))
    if not setup.startswith(":") or not settings_of(setup):
        raise TransferError(f"a setup was expected, but {setup[:40]!r} came; ask again")
    return setup


def write_setup(dialogue: Dialogue, setup: str) -> None:
    """Set what the scope holds otherwise than a setup, until all of it agrees.

    The commands go one branch at a time, so that a slow line's input buffer is not overrun. A branch may move
    settings of another one, which are set in the next round. What the scope refuses without need (the level of a
    mains trigger) does not matter as long as the values agree at the end.

    Raises
    ------
    SettingError
        If a setting is not as in `setup`; names the first one.
    """
    wanted = settings_of(setup)
    if not wanted:
        raise SettingError(f"{setup[:40]!r} is not a setup; give a text that read_setup() returned")
    for _ in range(_ROUNDS):
        other = _other(dialogue, wanted)
        if not other:
            return
        for branch, commands in _branches(wanted).items():
            if any(command.startswith(f"{branch}:") for command in other):
                dialogue.ask_with_events(";".join(commands), parts=0)
    for command, held in _other(dialogue, wanted).items():
        raise SettingError(
            f"{command.lstrip(':')} was set to {wanted[command]} but the scope holds {held}; "
            "is the setup of another model?"
        )


def _other(dialogue: Dialogue, wanted: dict[str, str]) -> dict[str, str]:
    """What the scope holds otherwise; a setting that it does not know is not missed."""
    held = settings_of(read_setup(dialogue))
    return {command: held[command] for command, value in wanted.items() if held.get(command, value) != value}


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


def _branches(settings: dict[str, str]) -> dict[str, list[str]]:
    """The commands of each branch, in the order of the setup."""
    branches: dict[str, list[str]] = {}
    for command, value in settings.items():
        branches.setdefault(command[: command.rindex(":")], []).append(f"{command} {value}")
    return branches
