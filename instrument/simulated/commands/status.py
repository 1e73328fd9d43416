"""Identity, status registers, events and synchronisation: `*IDN?` to `*WAI`.

Source: programmer manual 071-1075-04, chapters 2 and 3.
"""

from __future__ import annotations

from instrument.simulated.commands.action import Action, answer, no_argument, one_argument, one_number
from instrument.simulated.panel.formats import quoted
from instrument.simulated.panel.kinds import Words
from instrument.simulated.panel.parsing import Argument
from instrument.simulated.state import ScopeState

_ALL = Words("ALL")
_OUT_OF_RANGE = 200  # *SRE and its like out of range: an execution error, p. 2-199


def tek_identity(identity: str) -> str:
    """The older `ID?` form of an answer to `*IDN?`, p. 2-142.

    Examples
    --------
    >>> tek_identity("TEKTRONIX,TDS 2014,0,CF:91.1CT FV:v4.12 TDS2CM:CMV:v1.04")
    'ID TEK/TDS 2014,CF:91.1CT,FV:v4.12 TDS2CM:CMV:v1.04'
    """
    _, model, _, rest = (*identity.split(",", 3), "", "", "")[:4]
    return f"ID TEK/{model},{rest.replace(' ', ',', 1)}"


def _set_esr_mask(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    state.status.esr_mask = one_number(arguments, 0, 255, _OUT_OF_RANGE)


def _set_service_mask(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    state.status.service_mask = one_number(arguments, 0, 255, _OUT_OF_RANGE) & ~64


def _set_device_mask(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    state.status.device_mask = one_number(arguments, 0, 255, _OUT_OF_RANGE)


def _set_power_on_clear(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    state.status.clear_masks_at_power_on = one_number(arguments, -32767, 32767, _OUT_OF_RANGE) != 0


def _clear_status(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    no_argument(arguments)
    state.status.clear()
    state.completion_wanted = False


def _report_completion(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    no_argument(arguments)
    state.completion_wanted = True
    state.settle()


def _nothing(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    no_argument(arguments)


def _ignored(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """Accepted with any argument and without effect here."""


def _unlock(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """As LOCk NONe. (In remote with lockout, which no link here has, a real unit ignores it.)"""
    _ALL.read(one_argument(arguments))
    state.set("LOCK", "NONE")


def _all_events(state: ScopeState) -> str:
    return ",".join(f"{code},{quoted(text)}" for code, text in state.status.all_events())


def _event_with_text(state: ScopeState) -> str:
    code, text = state.status.next_event()
    return f"{code},{quoted(text)}"


def _factory(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    no_argument(arguments)
    state.factory()


def _reset(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    no_argument(arguments)
    state.reset()


ACTIONS = {
    "*IDN": Action(answer("", lambda state: state.identity), ends_message=True),
    "ID": Action(answer("", lambda state: tek_identity(state.identity)), ends_message=True),
    "*RST": Action(order=_reset),
    "FACtory": Action(order=_factory),
    "*CLS": Action(order=_clear_status),
    "*ESR": Action(answer("", lambda state: str(state.status.read_esr()))),
    "*ESE": Action(answer("", lambda state: str(state.status.esr_mask)), _set_esr_mask),
    "*SRE": Action(answer("", lambda state: str(state.status.service_mask)), _set_service_mask),
    "*PSC": Action(answer("", lambda state: str(int(state.status.clear_masks_at_power_on))), _set_power_on_clear),
    "*STB": Action(answer("", lambda state: str(state.status_byte()))),
    "*TST": Action(answer("", lambda state: "0")),
    "DESE": Action(answer("DESE", lambda state: str(state.status.device_mask)), _set_device_mask),
    "EVENT": Action(answer("EVENT", lambda state: str(state.status.next_event()[0]))),
    "EVMsg": Action(answer("EVMsg", _event_with_text)),
    "ALLEv": Action(answer("ALLEv", _all_events)),
    "EVQty": Action(answer("EVQty", lambda state: str(state.status.count()))),
    "BUSY": Action(answer("BUSY", lambda state: str(int(state.busy())))),
    "*OPC": Action(answer("", lambda state: "1"), _report_completion, waits=lambda state: state.busy()),
    "*WAI": Action(order=_nothing, waits=lambda state: state.busy()),
    "UNLock": Action(order=_unlock),
    "REM": Action(order=_ignored),
}
