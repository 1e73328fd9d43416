"""MEASUrement and CURSor queries.

Source: programmer manual 071-1075-04, pp. 2-75 to 2-83 and 2-159 to 2-170.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from instrument.simulated.commands.action import Action, Query, answer
from instrument.simulated.front_end.measurements import clipping_event, measure, phase, unit
from instrument.simulated.front_end.traces import Trace
from instrument.simulated.panel.event_table import Refusal
from instrument.simulated.panel.formats import INVALID, Leaf, nr3, quoted

if TYPE_CHECKING:
    from instrument.simulated.scope import SimulatedTDS2014

_DIGITS = 11


def _value(branch: str) -> Query:
    """The value of a measurement; 9.9E37 and an event where there is none."""
    key = branch.upper()

    def query(scope: SimulatedTDS2014) -> list[Leaf]:
        try:
            value = _measured(scope, scope.panel.text(f"{key}:TYPE"), _source(scope, key))
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
    if kind == "PHASE":
        value = _phase(scope, trace)
    elif kind == "CURSORRMS":
        value = measure("RMS", _between_cursors(scope, trace))
    else:
        value = measure(kind, trace)
    scope.status.post(clipping_event(trace))
    return value


def _source(scope: SimulatedTDS2014, key: str) -> str:
    """What a measurement looks at; later models call the one of IMMed SOURCE1."""
    values = scope.panel.values
    return str(values[f"{key}:SOURCE1" if f"{key}:SOURCE1" in values else f"{key}:SOURCE"])


def _phase(scope: SimulatedTDS2014, first: Trace) -> float:
    """Degrees by which the first source leads the second, -180 to 180."""
    second = scope.trace(scope.panel.text("MEASUREMENT:IMMED:SOURCE2"))
    if second is None:
        raise Refusal(2225)
    return phase(first, second)


def _between_cursors(scope: SimulatedTDS2014, trace: Trace) -> Trace:
    """The part of a trace between the vertical bars; event 2302 while they are off."""
    if scope.panel.text("CURSOR:FUNCTION") != "VBARS":
        raise Refusal(2302)
    times = sorted(scope.panel.number(f"CURSOR:VBARS:POSITION{n}") for n in (1, 2))
    first, last = (round((time - trace.xzero) / trace.xincr) for time in times)
    part = slice(max(first, 0), max(last, 0) + 1)
    return replace(trace, codes=trace.codes[part])


def _branch(branch: str) -> Query:
    """Type, unit and source."""
    path, key = tuple(branch.split(":")), branch.upper()

    def query(scope: SimulatedTDS2014) -> list[Leaf]:
        kind, *sources = scope.leaves(scope.rows_below(branch))
        units = quoted(unit(scope.panel.text(f"{key}:TYPE")))
        return [kind, ((*path, "UNIts"), units), *sources]

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
