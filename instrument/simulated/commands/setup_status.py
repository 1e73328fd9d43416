"""Whole setups, autoset and self-tests; identity and status; the hard copy.

Source: programmer manual 071-1075-04, pp. 2-53, 2-104, 2-186 to 2-198 and appendix B.
"""

import math
from collections.abc import Iterator

import numpy as np

from instrument.scpi import DIVISIONS, LEVELS_PER_DIVISION
from instrument.simulated.commands.tree import Action, Order, answer, no_argument, one_argument, one_number, plain
from instrument.simulated.panel.events import Guess, Refusal
from instrument.simulated.panel.parsing import Argument, Leaf, Mnemonics, block, join_leaves, quoted
from instrument.simulated.panel.settings import Words, time_steps
from instrument.simulated.pictures import FORMATS, draw
from instrument.simulated.state import ScopeState

MEMORIES = 10
_LONGEST_TRIGGER_MESSAGE = 80
_EXECUTE = Words("EXECute")
_FACTORY = Words("FACtory")
_AUTOSET_LOOK = 0.1  # s of signal that autoset looks at
_AUTOSET_POINTS = 1 << 16
_SQUARE_BETWEEN = 0.15  # of the time that a square wave may be between its levels (a sine: 0.41)
_SINE_SHARE = 0.95  # of its power that a sine has in one line
_SCALES = tuple(digit * 10.0**exponent for exponent in range(-3, 2) for digit in (1, 2, 5))


def whole_setup(state: ScopeState) -> str:
    """All settings as one message that can be sent back; always with headers."""
    rows = [row for row in state.panel.rows.values() if row.in_set]
    leaves = state.leaves(rows)
    if state.model.letter_series:
        leaves = _with_short_scale(leaves)
    return join_leaves(leaves, header=True, verbose=state.panel.flag("VERBOSE"))


def setup_file(state: ScopeState) -> str:
    """What the instrument writes on its card: the same without what no recalled setup changes."""
    rows = [row for row in state.panel.rows.values() if row.in_set and row.in_file and not row.kept]
    return join_leaves(_with_short_scale(state.leaves(rows)), header=True, verbose=True)


def _with_short_scale(leaves: list[Leaf]) -> list[Leaf]:
    """The main scale once more under its short name, behind the other horizontal settings."""
    short: Mnemonics = ("HORizontal", "SCAle")
    at = max(n for n, (path, _) in enumerate(leaves) if path[0] == "HORizontal") + 1
    value = next(value for path, value in leaves if path == ("HORizontal", "MAIn", "SCAle"))
    return [*leaves[:at], (short, value), *leaves[at:]]


def save(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """Keep the setup in memory 1 to 10."""
    number = one_number(arguments, 1, MEMORIES, Guess.MEMORY_NUMBER_OUT_OF_RANGE)
    state.setups[number] = state.panel.stored()


def _recall(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    number = one_number(arguments, 1, MEMORIES, Guess.MEMORY_NUMBER_OUT_OF_RANGE)
    state.acquisition.settle()
    if number in state.setups:
        state.panel.values.update(state.setups[number])
        state.acquisition.restart()
    else:
        state.reset()  # a memory never written holds the factory setup


def recall_setup(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """Bring back the factory setup or that of memory 1 to 10."""
    if one_argument(arguments).text[:1].isalpha():
        _FACTORY.read(arguments[0])
        state.reset()
    else:
        _recall(state, arguments)


def _define_trigger(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    argument = one_argument(arguments)
    message = argument.data if argument.data is not None else argument.text.encode("latin-1")
    if argument.data is None and not argument.quoted:
        raise Refusal(Guess.BLOCK_EXPECTED)
    if len(message) > _LONGEST_TRIGGER_MESSAGE:
        raise Refusal(223)
    state.trigger_message = message


def _trigger(state: ScopeState, arguments: tuple[Argument, ...]) -> Iterator[bytes | None]:
    """*TRG carries out what *DDT defined; a definition that triggers itself does nothing."""
    no_argument(arguments)
    message, state.trigger_message = state.trigger_message, b""
    yield from state.execute(message)
    state.trigger_message = state.trigger_message or message


def _nothing(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """Accepted with any argument, without effect here: a simulated instrument is always calibrated."""


def _autoset(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """Choose scales, time base and trigger for the signals at the displayed channels."""
    _EXECUTE.read(one_argument(arguments))
    panel = state.panel
    if not panel.values.get("AUTOSET:ENABLE", 1):
        raise Refusal(221)
    names = [name for name in panel.model.channel_names if name in panel.displayed] or ["CH1"]
    times = state.clock.now() - _AUTOSET_LOOK * (1 - np.arange(_AUTOSET_POINTS) / _AUTOSET_POINTS)
    frequencies: dict[str, float] = {}
    kinds: dict[str, str] = {}
    for name in names:
        volts = np.asarray(state.acquisition.signal(name)(times), dtype=np.float64) + np.zeros_like(times)
        volts = volts * panel.number(f"{name}:PROBE")
        _autoset_channel(state, name, volts)
        frequencies[name] = _lowest_frequency(volts)
        kinds[name] = _kind_of_signal(volts, frequencies[name])
    source = min(names, key=lambda name: frequencies[name] or math.inf)
    frequency = frequencies[source] or 200.0
    state.set("HORIZONTAL:MAIN:POSITION", 0.0)
    wanted = 4 / frequency / DIVISIONS
    steps = [step for step in time_steps(panel.model.fastest) if step >= wanted]
    state.set("HORIZONTAL:MAIN:SCALE", steps[0] if steps else 50.0)
    for key, value in (
        ("ACQUIRE:MODE", "SAMPLE"),
        ("ACQUIRE:STOPAFTER", "RUNSTOP"),
        ("DISPLAY:FORMAT", "YT"),
        ("HORIZONTAL:VIEW", "MAIN"),
        ("TRIGGER:MAIN:MODE", "AUTO"),
        ("TRIGGER:MAIN:TYPE", "EDGE"),
        ("TRIGGER:MAIN:HOLDOFF:VALUE", 5e-7),
        ("TRIGGER:MAIN:EDGE:SOURCE", source),
        ("TRIGGER:MAIN:EDGE:SLOPE", "RISE"),
        ("TRIGGER:MAIN:EDGE:COUPLING", "DC"),
    ):
        state.set(key, value)
    middle = -panel.number(f"{source}:POSITION") * panel.number(f"{source}:SCALE")
    state.set("TRIGGER:MAIN:LEVEL", middle)
    state.set("ACQUIRE:STATE", 1)
    state.autoset_found = kinds[source]


def _kind_of_signal(volts: np.ndarray[tuple[int], np.dtype[np.float64]], frequency: float) -> str:
    """The word of AUTOSet:SIGNAL?: by where the values lie between the extremes (video is not recognised)."""
    low, high = float(np.percentile(volts, 1)), float(np.percentile(volts, 99))
    if not frequency or high <= low:
        return "LEVEL"
    places = (volts - low) / (high - low)
    if float(np.mean((places > 0.2) & (places < 0.8))) < _SQUARE_BETWEEN:
        return "SQUARE"
    spectrum = np.abs(np.fft.rfft((volts - volts.mean()) * np.hanning(len(volts)))) ** 2
    at = int(spectrum.argmax())
    share = float(spectrum[max(at - 2, 0) : at + 3].sum() / spectrum.sum())
    return "SINE" if share > _SINE_SHARE else "OTHER"


def _autoset_channel(state: ScopeState, name: str, volts: np.ndarray[tuple[int], np.dtype[np.float64]]) -> None:
    span = float(volts.max() - volts.min())
    scales = [scale for scale in _SCALES if 5 * scale >= span > 0] or [1.0]
    state.set(f"SELECT:{name}", 1)
    state.set(f"{name}:BANDWIDTH", 0)
    state.set(f"{name}:SCALE", scales[0])
    middle = float(volts.max() + volts.min()) / 2
    state.set(f"{name}:POSITION", round(-middle / scales[0] * LEVELS_PER_DIVISION) / LEVELS_PER_DIVISION)


def _lowest_frequency(volts: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    """Frequency in Hz of the middle crossings, 0 without a period."""
    above = volts > (volts.max() + volts.min()) / 2
    edges = np.flatnonzero(~above[:-1] & above[1:])
    if len(edges) < 2:
        return 0.0
    return float((len(edges) - 1) / (edges[-1] - edges[0]) * _AUTOSET_POINTS / _AUTOSET_LOOK)


def _refuse_view(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    raise Refusal(221)


SETUP_ACTIONS = {
    "SET": Action(answer("", whole_setup)),
    "*LRN": Action(answer("", whole_setup)),
    "*SAV": Action(order=save),
    "*RCL": Action(order=_recall),
    "SAVe:SETUp": Action(order=save),
    "RECAll:SETUp": Action(order=recall_setup),
    "*DDT": Action(answer("", lambda state: block(state.trigger_message).decode("latin-1")), _define_trigger),
    "*TRG": Action(order=_trigger),
    "AUTOSet": Action(order=_autoset),
    "AUTOSet:SIGNAL": Action(answer("AUTOSet:SIGNAL", lambda state: state.autoset_found)),
    "AUTOSet:VIEW": Action(answer("AUTOSet:VIEW", lambda state: "NONE"), _refuse_view),
    "*CAL": Action(answer("", lambda state: "0")),
    "CALibrate:INTERNAL": Action(order=_nothing),
    "CALibrate:ABOrt": Action(order=_nothing),
    "CALibrate:CONTINUE": Action(order=_nothing),
    "CALibrate:FACtory": Action(order=_nothing),
    "CALibrate:STATUS": Action(answer("CALibrate:STATUS", lambda state: "PASS")),
    "DIAg:RESUlt:FLAg": Action(answer("DIAg:RESUlt:FLAg", lambda state: "PASS")),
    "DIAg:RESUlt:LOG": Action(
        answer("DIAg:RESUlt:LOG", lambda state: quoted("pass-CPU, pass-ACQ1, pass-EXTENSION"))
    ),
    "ERRLOG:FIRST": Action(answer("ERRLOG:FIRST", lambda state: quoted(""))),
    "ERRLOG:NEXT": Action(answer("ERRLOG:NEXT", lambda state: quoted(""))),
}


# --------------------
# Identity, status registers, events and synchronisation: `*IDN?` to `*WAI`.
#
# Source: programmer manual 071-1075-04, chapters 2 and 3


_ALL = Words("ALL")
_OUT_OF_RANGE = 200  # *SRE and its like out of range: an execution error, p. 2-199


def tek_identity(identity: str) -> str:
    """The older `ID?` form of an answer to `*IDN?`, p. 2-142."""
    _, model, _, rest = (*identity.split(",", 3), "", "", "")[:4]
    return f"ID TEK/{model},{rest.replace(' ', ',', 1)}"


def _set_mask(name: str, kept: int = 255) -> Order:
    def order(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
        setattr(state.status, name, one_number(arguments, 0, 255, _OUT_OF_RANGE) & kept)

    return order


def _set_power_on_clear(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    state.status.clear_masks_at_power_on = one_number(arguments, -32767, 32767, _OUT_OF_RANGE) != 0


def _clear_status(state: ScopeState) -> None:
    state.status.clear()
    state.completion_wanted = False


def _report_completion(state: ScopeState) -> None:
    state.completion_wanted = True
    state.settle()


def _unlock(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """As LOCk NONe. (In remote with lockout, which no link here has, a real unit ignores it.)"""
    _ALL.read(one_argument(arguments))
    state.set("LOCK", "NONE")


def _event_with_text(state: ScopeState) -> str:
    code, text = state.status.next_event()
    return f"{code},{quoted(text)}"


STATUS_ACTIONS = {
    "*IDN": Action(answer("", lambda state: state.identity), ends_message=True),
    "ID": Action(answer("", lambda state: tek_identity(state.identity)), ends_message=True),
    "*RST": Action(order=plain(ScopeState.reset)),
    "FACtory": Action(order=plain(ScopeState.factory)),
    "*CLS": Action(order=plain(_clear_status)),
    "*ESR": Action(answer("", lambda state: str(state.status.read_esr()))),
    "*ESE": Action(answer("", lambda state: str(state.status.esr_mask)), _set_mask("esr_mask")),
    "*SRE": Action(answer("", lambda state: str(state.status.service_mask)), _set_mask("service_mask", ~64)),
    "*PSC": Action(answer("", lambda state: str(int(state.status.clear_masks_at_power_on))), _set_power_on_clear),
    "*STB": Action(answer("", lambda state: str(state.status_byte()))),
    "*TST": Action(answer("", lambda state: "0")),
    "DESE": Action(answer("DESE", lambda state: str(state.status.device_mask)), _set_mask("device_mask")),
    "EVENT": Action(answer("EVENT", lambda state: str(state.status.next_event()[0]))),
    "EVMsg": Action(answer("EVMsg", _event_with_text)),
    "ALLEv": Action(
        answer(
            "ALLEv", lambda state: ",".join(f"{code},{quoted(text)}" for code, text in state.status.all_events())
        )
    ),
    "EVQty": Action(answer("EVQty", lambda state: str(state.status.count()))),
    "BUSY": Action(answer("BUSY", lambda state: str(int(state.busy())))),
    "*OPC": Action(answer("", lambda state: "1"), plain(_report_completion), waits=lambda state: state.busy()),
    "*WAI": Action(order=plain(lambda state: None), waits=lambda state: state.busy()),
    "UNLock": Action(order=_unlock),
    "REM": Action(order=_nothing),
}


# --------------------
# HARDCopy: the picture of the screen goes out on the link, as a file without header or terminator.
#
# Source: programmer manual 071-1075-04, pp. 2-126 to 2-131


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


HARD_COPY_ACTIONS = {"HARDCopy": Action(order=_hard_copy, waits=lambda state: state.awaits_record())}
