"""Identity, status registers, events and synchronisation: `*IDN?` to `*WAI`.

Source: programmer manual 071-1075-04, chapters 2 and 3.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from instrument.simulated.commands.action import Action, answer, no_argument, one_number
from instrument.simulated.panel.formats import quoted
from instrument.simulated.panel.parsing import Argument

if TYPE_CHECKING:
    from instrument.simulated.scope import SimulatedTDS2014

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


def _set_esr_mask(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    scope.status.esr_mask = one_number(arguments, 0, 255, _OUT_OF_RANGE)


def _set_service_mask(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    scope.status.service_mask = one_number(arguments, 0, 255, _OUT_OF_RANGE) & ~64


def _set_device_mask(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    scope.status.device_mask = one_number(arguments, 0, 255, _OUT_OF_RANGE)


def _set_power_on_clear(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    scope.status.clear_masks_at_power_on = one_number(arguments, -32767, 32767, _OUT_OF_RANGE) != 0


def _clear_status(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    no_argument(arguments)
    scope.status.clear()
    scope.completion_wanted = False


def _report_completion(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    no_argument(arguments)
    scope.completion_wanted = True
    scope.settle()


def _nothing(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    no_argument(arguments)


def _ignored(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    """Accepted with any argument and without effect here."""


def _all_events(scope: SimulatedTDS2014) -> str:
    return ",".join(f"{code},{quoted(text)}" for code, text in scope.status.all_events())


def _event_with_text(scope: SimulatedTDS2014) -> str:
    code, text = scope.status.next_event()
    return f"{code},{quoted(text)}"


def _factory(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    no_argument(arguments)
    scope.factory()


def _reset(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    no_argument(arguments)
    scope.reset()


ACTIONS = {
    "*IDN": Action(answer("", lambda scope: scope.identity), ends_message=True),
    "ID": Action(answer("", lambda scope: tek_identity(scope.identity)), ends_message=True),
    "*RST": Action(order=_reset),
    "FACtory": Action(order=_factory),
    "*CLS": Action(order=_clear_status),
    "*ESR": Action(answer("", lambda scope: str(scope.status.read_esr()))),
    "*ESE": Action(answer("", lambda scope: str(scope.status.esr_mask)), _set_esr_mask),
    "*SRE": Action(answer("", lambda scope: str(scope.status.service_mask)), _set_service_mask),
    "*PSC": Action(answer("", lambda scope: str(int(scope.status.clear_masks_at_power_on))), _set_power_on_clear),
    "*STB": Action(answer("", lambda scope: str(scope.status_byte()))),
    "*TST": Action(answer("", lambda scope: "0")),
    "DESE": Action(answer("DESE", lambda scope: str(scope.status.device_mask)), _set_device_mask),
    "EVENT": Action(answer("EVENT", lambda scope: str(scope.status.next_event()[0]))),
    "EVMsg": Action(answer("EVMsg", _event_with_text)),
    "ALLEv": Action(answer("ALLEv", _all_events)),
    "EVQty": Action(answer("EVQty", lambda scope: str(scope.status.count()))),
    "BUSY": Action(answer("BUSY", lambda scope: str(int(scope.busy())))),
    "*OPC": Action(answer("", lambda scope: "1"), _report_completion, waits=lambda scope: scope.busy()),
    "*WAI": Action(order=_nothing, waits=lambda scope: scope.busy()),
    "UNLock": Action(order=_ignored),
    "REM": Action(order=_ignored),
}
