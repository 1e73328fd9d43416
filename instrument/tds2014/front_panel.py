"""One open scope: opening, closing, names, plain text, and what must be known again after settings changed."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import pyvisa

from instrument import scpi
from instrument.dialogue.dialogue import Dialogue
from instrument.dialogue.link import Link
from instrument.dialogue.retry import Persistence, Tally
from instrument.errors import (
    ExecutionError,
    InstrumentError,
    LinkError,
    NoTrigger,
    ScopeEvent,
    SettingError,
    TransferError,
)
from instrument.scpi import DIVISIONS, POINTS_PER_DIVISION, SCAN_FROM
from instrument.waveform import Waveform

T = TypeVar("T")

_TIMING_COMMANDS = (
    ":HORIZONTAL:MAIN:SCALE",
    ":ACQUIRE:MODE",
    ":ACQUIRE:NUMAVG",
    ":TRIGGER:MAIN:MODE",
    ":TRIGGER:MAIN:HOLDOFF:VALUE",
    ":TRIGGER:MAIN:TYPE",
    ":TRIGGER:MAIN:EDGE:SOURCE",
)


_HURRIED = 5.0  # s for which a lost link is tried again when somebody wants the program to end


class ScopeConnection:
    """What the parts of `TDS2014` share: the dialogue with the scope and its front panel."""

    def __init__(
        self,
        resource_name: str,
        resource_manager: pyvisa.ResourceManager | None,
        baud_rate: int | None,
        persistence: Persistence | None = None,
    ) -> None:
        wanted = persistence or Persistence()
        link = Link(resource_name, resource_manager, baud_rate, wanted.clock)
        try:
            self.dialogue = Dialogue(link, wanted)
            self.panel = FrontPanel(self.dialogue)
            self.found: FoundPanel | None = self.panel.found() if wanted.careful else None
        except BaseException:
            link.close()
            raise
        self._timing: AcquisitionTime | None = None
        self.panel_is_back = False
        """Whether the front panel was put back on closing."""
        self._closed = False
        self._stepping = False

    def close(self) -> None:
        """Put the front panel back as found and close the link; closing twice does nothing."""
        if self._closed:
            return
        self._closed = True
        try:
            self.dialogue.let_late_messages_pass()
            self.restore()
            self.panel_is_back = True
        except LinkError:
            self.dialogue.link.close()  # asking a lost scope for more would only cost time
            raise
        finally:
            self.dialogue.close()

    def restore(self) -> None:
        """Put back every group of settings that was changed, as it was found."""
        self.forget()
        self.panel.restore()

    # ------------------------------------------------------------------ a link with faults

    @property
    def link_faults(self) -> Tally:
        """What it took so far to keep the link: exchanges repeated, connections, settings made again."""
        return self.dialogue.tally

    @property
    def front_panel_found(self) -> FoundPanel | None:
        """The front panel as it will be put back; None without persistence: groups are then read as needed."""
        return self.found

    def put_back_in_the_end(self, found: FoundPanel) -> None:
        """Put this front panel back on closing, not the one that was found: an earlier session could not do it."""
        self.found = found
        self.panel.put_back_in_the_end(found)

    def abandon(self) -> None:
        """Close the link and put nothing back, as when the program is killed."""
        self._closed = True
        self.dialogue.link.close()

    def hurry(self) -> None:
        """Somebody wants the program to end: a lost link is not waited for any longer."""
        patience = min(_HURRIED, self.dialogue.persistence.reconnect_for)
        self.dialogue.persistence = replace(self.dialogue.persistence, reconnect_for=patience)

    def step(self, work: Callable[[], T]) -> T:
        """Do something that can be done again as a whole, until it succeeds, as often as the persistence allows.

        After a fault the settings that records depend on are verified first, and made again where the scope has
        lost them. A step inside a step is part of it. Errors are those of `work`.
        """
        if self._stepping or not self.dialogue.persistence.careful:
            return work()
        self._stepping = True
        try:
            return self.dialogue.repeated(lambda: self._with_settings_held(work))
        finally:
            self._stepping = False

    def _with_settings_held(self, work: Callable[[], T]) -> T:
        while self.dialogue.settings_in_doubt():
            self.dialogue.in_doubt = False
            self.panel.hold()
            self.forget()
        before = self.dialogue.tally.repeated
        try:
            return work()
        except NoTrigger as missing:
            if self.dialogue.tally.repeated == before and not self.dialogue.in_doubt:
                raise
            # Perhaps it was the trigger's setting that was spoiled on its way.
            raise TransferError(f"{missing}; but there were faults on the link, so ask again") from missing

    # ------------------------------------------------------------------ events and plain text

    def events(self) -> list[ScopeEvent]:
        """Read and empty the scope's event queue."""
        return self.dialogue.events()

    def query(self, text: str) -> str:
        """Send a query of your own and return its answer as text.

        Events that it causes without staying unanswered (a measurement that cannot be made, for example) are
        there for `events` until the next record is read.
        """
        self.dialogue.unread_events = True
        return ";".join(self.dialogue.ask(text, parts=None))

    def write(self, text: str) -> None:
        """Send commands of your own; raises `ScopeEvent` if the scope refuses them.

        What they change is not put back on closing.
        """
        self.forget()
        self.dialogue.command(text)

    # ------------------------------------------------------------------ names

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels of this model, ``("CH1", "CH2", ...)``."""
        return tuple(f"CH{number}" for number in range(1, self.dialogue.identity.channel_count + 1))

    def channel(self, channel: str | int) -> str:
        """Name of a channel of this model; SettingError if it has none like that."""
        name = f"CH{channel}" if isinstance(channel, int) else channel.strip().upper()
        if name not in self.channels:
            raise SettingError(
                f"{self.dialogue.identity.model} has no channel {name}; choose one of {', '.join(self.channels)}"
            )
        return name

    def source(self, name: str | int) -> str:
        """A channel, MATH, or one of the references (as many as channels)."""
        word = str(name).strip().upper()
        references = [f"REF{letter}" for letter in "ABCD"[: len(self.channels)]]
        return word if word in ("MATH", *references) else self.channel(name)

    # ------------------------------------------------------------------ settings that change

    def before_changing(self, *groups: str) -> None:
        """Remember these groups of settings as they are, to be put back on closing."""
        self.panel.remember(*groups)
        self.forget()

    def before_changing_all(self) -> None:
        """Remember the whole setup, to be put back on closing."""
        self.panel.remember_all()
        self.forget()

    def forget(self) -> None:
        """Settings may have changed: what was derived from them must be read again."""
        self._timing = None
        self.panel.lock = None
        self.dialogue.source = None

    def acquisition_time(self) -> AcquisitionTime:
        """How long an acquisition takes with the settings of now."""
        if self._timing is None:
            scale, mode, averages, trigger_mode, holdoff, kind, source = self.panel.read(_TIMING_COMMANDS)
            self._timing = AcquisitionTime(
                seconds_per_division=scpi.number(scale),
                acquisitions=scpi.integer(averages) if mode.startswith("AVE") else 1,
                automatic=trigger_mode.startswith("AUTO"),
                holdoff=scpi.number(holdoff),
                mains=kind == "EDGE" and source.endswith("LINE"),
            )
        return self._timing

    def check_time_base(self, waveform: Waveform) -> None:
        """Somebody may have turned the knob: the record tells the time base it was taken with."""
        taken_with = waveform.sample_interval * POINTS_PER_DIVISION
        if self._timing and abs(taken_with / self._timing.seconds_per_division - 1) > 1e-3:
            self._timing = None


# --------------------
# What can be set on the scope: the commands of each group, the values read back, and how close is equal.
#
# `FrontPanel` remembers a group as it was found before the first change in it and can put it back


Value = str | int | float | bool

# In the order in which they must be put back: PROBE changes SCALE, SCALE limits POSITION.
CHANNEL_LEAVES = ("PROBE", "SCALE", "POSITION", "COUPLING", "BANDWIDTH", "INVERT")
HORIZONTAL = (":HORIZONTAL:MAIN:SCALE", ":HORIZONTAL:MAIN:POSITION")
TRIGGER = (
    ":TRIGGER:MAIN:MODE",
    ":TRIGGER:MAIN:TYPE",
    ":TRIGGER:MAIN:EDGE:SOURCE",
    ":TRIGGER:MAIN:EDGE:COUPLING",
    ":TRIGGER:MAIN:EDGE:SLOPE",
    ":TRIGGER:MAIN:HOLDOFF:VALUE",
    ":TRIGGER:MAIN:LEVEL",
)
CURSOR = tuple(f":CURSOR:{bars}:POSITION{n}" for bars in ("VBARS", "HBARS") for n in (1, 2))
CURSOR_KIND = (":CURSOR:FUNCTION", ":CURSOR:SELECT:SOURCE", ":CURSOR:VBARS:UNITS")
MATH = (":MATH:DEFINE", ":SELECT:MATH")
MEASUREMENT = (":MEASUREMENT:IMMED:TYPE", ":MEASUREMENT:IMMED:SOURCE")
LOCK = (":LOCK",)
HARDCOPY = (":HARDCOPY:FORMAT", ":HARDCOPY:PORT")
ACQUIRE = (":ACQUIRE:MODE", ":ACQUIRE:NUMAVG", ":ACQUIRE:STOPAFTER", ":ACQUIRE:STATE")

# The trigger level is given in volts of its channel, so it follows the channels; the acquisition starts last.
# Cursors are kept on the screen, so other scales move them: they follow as well.
_RESTORE_ORDER = (
    *("CH1", "CH2", "CH3", "CH4", "HORIZONTAL", "TRIGGER", "CURSOR", "CURSOR KIND", "MATH"),
    *("REFA", "REFB", "REFC", "REFD", "MEASUREMENT", "HARDCOPY", "LOCK", "ACQUIRE"),
)

_IN_NO_SETUP = ("LOCK", "ACQUIRE")  # groups of which a setup says nothing, or not whether an acquisition runs

_OF_RECORDS = (":CH", ":SELECT:CH", ":HORIZONTAL", ":TRIGGER", ":ACQUIRE:MODE", ":ACQUIRE:NUMAVG")
_ROUNDS = 3  # a setting may move another one that was right before

_TRUE, _FALSE = ("1", "ON", "RUN"), ("0", "OFF", "STOP")


@dataclass(frozen=True)
class ChannelSettings:
    """One channel as read back.

    Attributes
    ----------
    scale : float
        V/div at the probe tip (the probe factor is in it).
    position : float
        Divisions above the centre.
    coupling : str
        ``DC``, ``AC`` or ``GND``.
    probe : float
        Attenuation factor, 1 or 10 usually.
    bandwidth_limit, invert, displayed : bool
        20 MHz limit; inverted; on the screen (only then can it be read).
    """

    channel: str
    scale: float
    position: float
    coupling: str
    probe: float
    bandwidth_limit: bool
    invert: bool
    displayed: bool


@dataclass(frozen=True)
class FoundPanel:
    """The front panel as it was found: a setup, and the groups that are in none, by name."""

    setup: str
    groups: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class Change:
    """One setting to make: command, wanted value, and how far the value read back may differ."""

    command: str
    wanted: Value
    tolerance: float = 0.0


_GROUPS = {
    "HORIZONTAL": HORIZONTAL,
    "TRIGGER": TRIGGER,
    "CURSOR": CURSOR,
    "CURSOR KIND": CURSOR_KIND,
    "MATH": MATH,
    "MEASUREMENT": MEASUREMENT,
    "HARDCOPY": HARDCOPY,
    "LOCK": LOCK,
    "ACQUIRE": ACQUIRE,
}


def group_commands(group: str) -> tuple[str, ...]:
    """Commands of a group: ``"CH1"`` to ``"CH4"``, ``"REFA"`` to ``"REFD"``, ``"HORIZONTAL"``, ``"TRIGGER"``..."""
    if group in _GROUPS:
        return _GROUPS[group]
    if group.startswith("REF"):
        return (f":SELECT:{group}",)
    return (*(f":{group}:{leaf}" for leaf in CHANNEL_LEAVES), f":SELECT:{group}")


def _group_of(command: str) -> str:
    return command.split(":")[1]


def _moved_by(command: str) -> list[str]:
    """Settings that move along when this one is changed, as on the front panel."""
    if command == ":HORIZONTAL:MAIN:SCALE":
        return [":HORIZONTAL:MAIN:POSITION"]
    if command.startswith(":CH"):
        channel = command[: command.rindex(":")]
        scale = [f"{channel}:SCALE"] if command.endswith(":PROBE") else []
        return [*scale, ":TRIGGER:MAIN:LEVEL"]  # which is given in the volts of its channel
    return []


def write_value(value: Value) -> str:
    """A value as the scope takes it: ON/OFF, NR3 or the word itself."""
    if isinstance(value, bool):
        return "ON" if value else "OFF"
    return value if isinstance(value, str) else scpi.nr3(value)


def is_on(text: str) -> bool:
    """Read a boolean answer, which is 1/0 for some commands and ON/OFF for others."""
    return text.strip().upper() in _TRUE


def same_value(wanted: Value, got: str, tolerance: float) -> bool:
    """Whether the value read back is the one that was set, within `tolerance` (absolute)."""
    if isinstance(wanted, bool):
        return got.strip().upper() in (_TRUE if wanted else _FALSE)
    if isinstance(wanted, str):
        # A short spelling such as PEAK is answered by the long one.
        return got.strip().upper().startswith(wanted.upper())
    # Settings are answered with about seven digits.
    return abs(scpi.number(got) - wanted) <= tolerance + 1e-6 * abs(wanted)


class FrontPanel:
    """Makes changes with read-back and remembers how each group was before its first change."""

    def __init__(self, dialogue: Dialogue) -> None:
        self.dialogue = dialogue
        self.lock: str | None = None
        """What LOCk says outside our own exchanges, None if not known."""
        self._found: dict[str, tuple[str, ...]] = {}
        self._found_setup: str | None = None
        self._made: dict[str, Change] = {}

    def remember(self, *groups: str) -> None:
        """Read the groups that have not been changed yet, before they are."""
        for group in groups:
            if group not in self._found and (self._found_setup is None or group in _IN_NO_SETUP):
                self._found[group] = tuple(self.read(group_commands(group)))

    def found(self) -> FoundPanel:
        """Read everything that can be changed, and remember it to be put back in the end."""
        self.remember_all()
        self.remember(*_IN_NO_SETUP)
        return FoundPanel(self._found_setup or "", {group: self._found[group] for group in _IN_NO_SETUP})

    def put_back_in_the_end(self, found: FoundPanel) -> None:
        """Take this for what was found: an earlier session read it and could not put it back."""
        self._found_setup = found.setup
        self._found = dict(found.groups)

    def remember_all(self) -> None:
        """Read the whole setup, before a command that changes any part of it."""
        self._made.clear()
        if self._found_setup is None:
            self._found_setup = read_setup(self.dialogue)

    def read(self, commands: tuple[str, ...]) -> list[str]:
        """Values of these settings, in one exchange."""
        question = ";".join(f"{command}?" for command in commands)
        return self.dialogue.ask(question, parts=len(commands), twice=True)

    def change(self, *changes: Change) -> list[str]:
        """Make the changes and read them back, all in one exchange.

        Raises
        ------
        SettingError
            For the first value that came back different; names command, wanted and got.
        ScopeEvent
            If the scope refused a command.
        """
        if not changes:
            return []
        answers = self.dialogue.repeated(lambda: self._change_once(changes))
        for change in changes:
            for follower in _moved_by(change.command):
                self._made.pop(follower, None)
        for change in changes:
            self._made.pop(change.command, None)  # the last one goes to the end
            if change.command.startswith(_OF_RECORDS):
                self._made[change.command] = change
        return answers

    def _change_once(self, changes: tuple[Change, ...]) -> list[str]:
        sets = ";".join(f"{change.command} {write_value(change.wanted)}" for change in changes)
        queries = ";".join(f"{change.command}?" for change in changes)
        answers = self.dialogue.checked(f"{sets};{queries};*ESR?", parts=len(changes))
        for change, got in zip(changes, answers, strict=True):
            if not same_value(change.wanted, got, change.tolerance):
                raise SettingError(
                    f"{change.command.lstrip(':')} was set to {write_value(change.wanted)} but the scope "
                    f"holds {got}; choose a value that it can take"
                )
        return answers

    def hold(self) -> None:
        """See that the scope still holds what was set for the records, and set again what it does not.

        Raises
        ------
        SettingError
            If it does not take it any more.
        """
        made = list(self._made.values())
        lost = self._lost(made)
        self.dialogue.tally.set_again += len(lost)
        for _ in range(_ROUNDS):
            if not lost:
                return
            for group in dict.fromkeys(_group_of(change.command) for change in lost):
                self.change(*(change for change in lost if _group_of(change.command) == group))
            lost = self._lost(made)
        command = lost[0].command.lstrip(":")
        raise SettingError(f"{command} was set to {write_value(lost[0].wanted)} and the scope does not keep it")

    def _lost(self, made: list[Change]) -> list[Change]:
        if not made:
            return []
        held = self.read(tuple(change.command for change in made))
        return [one for one, got in zip(made, held, strict=True) if not same_value(one.wanted, got, one.tolerance)]

    def restore(self) -> None:
        """Put every remembered group back as it was found; all are tried, the first error is raised."""
        first_error: InstrumentError | None = None
        self._made.clear()
        # The setup holds what was changed before it was remembered; the groups, older, come after it.
        if self._found_setup is not None:
            try:
                write_setup(self.dialogue, self._found_setup)
            except LinkError:
                raise
            except InstrumentError as error:
                first_error = error
        for group in sorted(self._found, key=_RESTORE_ORDER.index):
            try:
                self._restore_group(group, self._found[group])
            except LinkError:
                raise  # nothing more can be put back
            except InstrumentError as error:
                first_error = first_error or error
        self._found.clear()
        self._found_setup = None
        if first_error is not None:
            raise first_error

    @contextlib.contextmanager
    def front_panel_locked(self) -> Iterator[None]:
        """Lock the knobs while a ``with`` block runs; afterwards they are as found, also after an exception."""
        (found,) = self.read((":LOCK",))
        self.change(Change(":LOCK", "ALL"))
        self.lock = "ALL"
        try:
            yield
        except LinkError:
            raise  # a scope that is gone cannot be unlocked
        except BaseException:
            with contextlib.suppress(InstrumentError):
                self.dialogue.command(f":LOCK {found}")
            raise
        finally:
            self.lock = None
        self.dialogue.command(f":LOCK {found}")

    @contextlib.contextmanager
    def held(self) -> Iterator[tuple[str, str]]:
        """Commands that keep hands off the scope during one exchange, and those that end it."""
        self.remember("LOCK")
        (found,) = self.read((":LOCK",)) if self.lock is None else (self.lock,)
        self.lock = found
        if found == "ALL":
            yield "", ""
            return
        try:
            yield ":LOCK ALL", f":LOCK {found}"
        except LinkError:
            raise
        except InstrumentError:
            with contextlib.suppress(InstrumentError):
                self.dialogue.command(f":LOCK {found}")
            raise

    def _restore_group(self, group: str, values: tuple[str, ...]) -> None:
        pairs = list(zip(group_commands(group), values, strict=True))
        if group == "TRIGGER" and "LINE" in values[2]:
            pairs.pop()  # the mains have no trigger level; setting one is refused (event 221)
        if group == "CURSOR":
            # A scope may refuse to move cursors that it does not show now; nobody misses those.
            with contextlib.suppress(ExecutionError):
                self.dialogue.command(_settings(pairs))
            return
        # A single acquisition that is put back in its course ends by itself.
        lasting = pairs[:-1] if group == "ACQUIRE" and values[2].startswith("SEQ") else pairs
        queries = ";".join(f"{command}?" for command, _ in lasting)
        lost: list[tuple[str, str, str]] = []
        for _ in range(_ROUNDS):
            # A damaged message may have set another value that is a right one too, so they are read back.
            held = self.dialogue.checked(f"{_settings(pairs)};{queries};*ESR?", parts=len(lasting))
            lost = [(*pair, got) for pair, got in zip(lasting, held, strict=True) if not _is_back(pair[1], got)]
            if not lost:
                return
        command, found, got = lost[0]
        raise SettingError(
            f"{command.lstrip(':')} was found at {found} and is {got} after it was put back; set it at the scope"
        )


def _settings(pairs: list[tuple[str, str]]) -> str:
    return ";".join(f"{command} {value}" for command, value in pairs)


def _is_back(found: str, got: str) -> bool:
    """Whether a setting is as it was found, but for last digits, which a scope may round."""
    if found == got:
        return True
    try:
        return math.isclose(float(found), float(got), rel_tol=1e-4, abs_tol=1e-12)
    except ValueError:
        return False


def one_of(name: str, value: str, allowed: tuple[str, ...]) -> str:
    """The allowed word that `value` spells, full or in the scope's short form; SettingError if none."""
    word = value.strip().upper()
    for full in allowed:
        if word and full.startswith(word) and len(word) >= min(3, len(full)):
            return full
    raise SettingError(f"{name} cannot be {value!r}; choose one of {', '.join(allowed)}")


def optional(command: str, value: Value | None, tolerance: float = 0.0) -> list[Change]:
    """A change if `value` is given, else none."""
    return [] if value is None else [Change(command, value, tolerance)]


# --------------------
# The answer to ``SET?``: all settings as a text that can be kept, compared and sent back.
#
# Programmer manual 071-1075-04, pp. 2-195 to 2-198


_SETUP_ROUNDS = 3

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
    for _ in range(_SETUP_ROUNDS):
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


# --------------------
# How long one acquisition can take, from the settings that decide it


AUTO_DELAY = 0.05
"""Time in s after which AUTO mode triggers by itself at the latest, on short records: a generous guess."""


@dataclass(frozen=True)
class AcquisitionTime:
    """The settings that an acquisition's duration follows from."""

    seconds_per_division: float
    acquisitions: int = 1  # number of averages; 1 in Sample and Peak Detect
    automatic: bool = True  # trigger mode AUTO
    holdoff: float = 0.0  # trigger holdoff in s
    mains: bool = False  # triggered by the mains, which are always there

    @property
    def record_time(self) -> float:
        """Time in s that the record spans."""
        return DIVISIONS * self.seconds_per_division

    @property
    def longest(self) -> float:
        """Time in s after which the sequence is complete if triggers come.

        Every acquisition fills its record and may wait as long again for its trigger: a repetitive signal
        with a period in the record gives one within that time.
        """
        trigger_wait = max(self.record_time, AUTO_DELAY)
        return self.acquisitions * (self.record_time + trigger_wait + self.holdoff)

    @property
    def surely_ends(self) -> bool:
        """Whether it completes whatever the signals are: without a trigger, or with one that always comes."""
        scanning = self.automatic and self.seconds_per_division >= SCAN_FROM
        return (self.automatic or self.mains) and not scanning
