"""MEASUrement and CURSor queries.

Source: programmer manual 071-1075-04, pp. 2-75 to 2-83 and 2-159 to 2-170.
"""

from __future__ import annotations

from dataclasses import replace

from instrument.simulated.commands.action import Action, Query, answer
from instrument.simulated.front_end.measurements import clipping_event, measure, phase, unit
from instrument.simulated.front_end.traces import Trace
from instrument.simulated.panel.event_table import Refusal
from instrument.simulated.panel.formats import INVALID, Leaf, nr3, quoted
from instrument.simulated.state import ScopeState

_DIGITS = 11
_DECIMALS = 10  # of a measured value: a TDS2024 answered 9.99999046E-2 and 1.400003433E-1 V, 4.0E-4 s
_ALL_DIGITS = 15


def _value(branch: str) -> Query:
    """The value of a measurement; 9.9E37 and an event where there is none."""
    key = branch.upper()

    def query(state: ScopeState) -> list[Leaf]:
        try:
            value = _measured(state, state.panel.text(f"{key}:TYPE"), _source(state, key))
        except Refusal as refusal:
            state.status.post(refusal.event)
            value = INVALID
        return [((*branch.split(":"), "VALue"), nr3(round(value, _DECIMALS), _ALL_DIGITS))]

    return query


def _measured(state: ScopeState, kind: str, source: str) -> float:
    if kind == "NONE":
        raise Refusal(2231)
    if state.panel.scanning or state.panel.text("DISPLAY:FORMAT") == "XY":
        raise Refusal(221)
    trace = state.trace(source)
    if trace is None or trace.yunit == "dB":
        raise Refusal(2225)
    if kind == "PHASE":
        value = _phase(state, trace)
    elif kind == "CURSORRMS":
        value = measure("RMS", _between_cursors(state, trace))
    else:
        value = measure(kind, trace)
    state.status.post(clipping_event(trace))
    return value


def _source(state: ScopeState, key: str) -> str:
    """What a measurement looks at; later models call the one of IMMed SOURCE1."""
    values = state.panel.values
    return str(values[f"{key}:SOURCE1" if f"{key}:SOURCE1" in values else f"{key}:SOURCE"])


def _phase(state: ScopeState, first: Trace) -> float:
    """Degrees by which the first source leads the second, -180 to 180."""
    second = state.trace(state.panel.text("MEASUREMENT:IMMED:SOURCE2"))
    if second is None:
        raise Refusal(2225)
    return phase(first, second)


def _between_cursors(state: ScopeState, trace: Trace) -> Trace:
    """The part of a trace between the vertical bars; event 2302 while they are off."""
    if state.panel.text("CURSOR:FUNCTION") != "VBARS":
        raise Refusal(2302)
    times = sorted(state.panel.number(f"CURSOR:VBARS:POSITION{n}") for n in (1, 2))
    first, last = (round((time - trace.xzero) / trace.xincr) for time in times)
    part = slice(max(first, 0), max(last, 0) + 1)
    return replace(trace, codes=trace.codes[part])


def _branch(branch: str) -> Query:
    """Type, unit and source."""
    path, key = tuple(branch.split(":")), branch.upper()

    def query(state: ScopeState) -> list[Leaf]:
        kind, *sources = state.leaves(state.rows_below(branch))
        units = quoted(unit(state.panel.text(f"{key}:TYPE")))
        return [kind, ((*path, "UNIts"), units), *sources]

    return query


def _units(branch: str) -> Query:
    key = f"{branch.upper()}:TYPE"
    return answer(f"{branch}:UNIts", lambda state: quoted(unit(state.panel.text(key))))


def _cursor_delta(branch: str) -> Query:
    def difference(state: ScopeState) -> str:
        first, second = (state.panel.number(f"CURSOR:{branch.upper()}:POSITION{n}") for n in (1, 2))
        return nr3(second - first, _DIGITS)

    return answer(f"CURSor:{branch}:DELTa", difference)


def _horizontal_bar_units(state: ScopeState) -> str:
    source = state.panel.text("CURSOR:SELECT:SOURCE")
    trace = state.trace(source)
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
