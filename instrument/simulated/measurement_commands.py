"""MEASUrement and CURSor queries.

Source: programmer manual 071-1075-04, pp. 2-75 to 2-83 and 2-159 to 2-170.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from instrument.simulated.actions import Action, Query, answer
from instrument.simulated.events import Refusal
from instrument.simulated.formats import INVALID, Leaf, nr3, quoted
from instrument.simulated.measurements import clipping_event, measure, unit

if TYPE_CHECKING:
    from instrument.simulated.scope import SimulatedTDS2014

_DIGITS = 11


def _value(branch: str) -> Query:
    """The value of a measurement; 9.9E37 and an event where there is none."""
    key = branch.upper()

    def query(scope: SimulatedTDS2014) -> list[Leaf]:
        try:
            value = _measured(scope, scope.panel.text(f"{key}:TYPE"), scope.panel.text(f"{key}:SOURCE"))
        except Refusal as refusal:
            scope.status.post(refusal.event)
            value = INVALID
        return [((*branch.split(":"), "VALue"), nr3(value, _DIGITS))]

    return query


def _measured(scope: SimulatedTDS2014, kind: str, source: str) -> float:
    if kind == "NONE":
        raise Refusal(2231)
    if scope.panel.scanning or scope.panel.text("DISPLAY:FORMAT") == "XY":
        raise Refusal(221)
    trace = scope.trace(source)
    if trace is None or trace.yunit == "dB":
        raise Refusal(2225)
    value = measure(kind, trace)
    scope.status.post(clipping_event(trace))
    return value


def _branch(branch: str) -> Query:
    """Type, unit and source."""
    path, key = tuple(branch.split(":")), branch.upper()

    def query(scope: SimulatedTDS2014) -> list[Leaf]:
        kind, source = (row for row in scope.rows_below(branch))
        (_, word), (_, name) = scope.leaves([kind, source])
        return [
            ((*path, "TYPe"), word),
            ((*path, "UNIts"), quoted(unit(scope.panel.text(f"{key}:TYPE")))),
            ((*path, "SOUrce"), name),
        ]

    return query


def _units(branch: str) -> Query:
    key = f"{branch.upper()}:TYPE"
    return answer(f"{branch}:UNIts", lambda scope: quoted(unit(scope.panel.text(key))))


def _cursor_delta(branch: str) -> Query:
    def difference(scope: SimulatedTDS2014) -> str:
        first, second = (scope.panel.number(f"CURSOR:{branch.upper()}:POSITION{n}") for n in (1, 2))
        return nr3(second - first, _DIGITS)

    return answer(f"CURSor:{branch}:DELTa", difference)


def _horizontal_bar_units(scope: SimulatedTDS2014) -> str:
    source = scope.panel.text("CURSOR:SELECT:SOURCE")
    trace = scope.trace(source)
    word = {"Volts": "VOLTs", "V": "VOLTs", "dB": "DECIBELs", "U": "UNKNOWN"}
    spelled = word.get(trace.yunit, "UNKNOWN") if trace is not None else "DIVs"
    return spelled.upper()


_BRANCHES = ("MEASUrement:IMMed", *(f"MEASUrement:MEAS{number}" for number in range(1, 6)))

ACTIONS = {
    **{f"{branch}:VALue": Action(_value(branch), waits=lambda s: s.awaits_record()) for branch in _BRANCHES},
    **{branch: Action(_branch(branch)) for branch in _BRANCHES},
    **{f"{branch}:UNIts": Action(_units(branch)) for branch in _BRANCHES},
    "CURSor:HBArs:DELTa": Action(_cursor_delta("HBArs")),
    "CURSor:HBArs:UNIts": Action(answer("CURSor:HBArs:UNIts", _horizontal_bar_units)),
    "CURSor:VBArs:DELTa": Action(_cursor_delta("VBArs")),
}
