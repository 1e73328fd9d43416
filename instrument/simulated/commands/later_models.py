"""Commands of B, C and TPS models: cursors on the waveform, batteries, and the printer at the USB port.

Source: programmer manual 071-1075-04, pp. 2-28 to 2-32, 2-79 to 2-83 and 2-171 ff. The words that the
battery answers are guesses.
"""

from __future__ import annotations

from collections.abc import Mapping

from instrument.facts import NO_DATA
from instrument.simulated.commands.action import Action, Order, Query, answer, no_argument
from instrument.simulated.front_end.traces import Trace
from instrument.simulated.panel.event_table import Refusal
from instrument.simulated.panel.formats import INVALID, nr3
from instrument.simulated.panel.models import Model
from instrument.simulated.panel.parsing import Argument
from instrument.simulated.state import ScopeState

_CURSORS_OFF, _SOURCE_OFF, _OFF_SCREEN = 2302, 2303, 2301
_DIGITS = 11
_BATTERIES = (1, 2)
_CHARGE = 100  # percent: the battery of a simulated instrument stays full
_MINUTES_LEFT = 480  # of both batteries together


def _displayed(state: ScopeState) -> Trace:
    """The waveform that the vertical bars stand on."""
    if state.panel.text("CURSOR:FUNCTION") != "VBARS":
        raise Refusal(_CURSORS_OFF)
    trace = state.trace(state.panel.text("CURSOR:SELECT:SOURCE"))
    if trace is None:
        raise Refusal(_SOURCE_OFF)
    return trace


def _time(state: ScopeState, number: int) -> float:
    """Where a bar stands, s."""
    position = state.panel.number(f"CURSOR:VBARS:POSITION{number}")
    hertz = state.panel.text("CURSOR:VBARS:UNITS") == "HERTZ"
    return 1 / position if hertz and position else position


def _height(state: ScopeState, number: int) -> float:
    """Volts of the waveform where a bar stands."""
    trace = _displayed(state)
    point = round((_time(state, number) - trace.xzero) / trace.xincr)
    if not 0 <= point < trace.points or trace.codes[point] == NO_DATA:
        raise Refusal(_OFF_SCREEN)
    return (float(trace.codes[point]) - trace.yoff) * trace.ymult + trace.yzero


def _heights(state: ScopeState) -> tuple[float, float]:
    return _height(state, 1), _height(state, 2)


def _slope(state: ScopeState) -> float:
    first, second = _heights(state)
    elapsed = _time(state, 2) - _time(state, 1)
    if not elapsed:
        raise Refusal(_OFF_SCREEN)
    return (second - first) / elapsed


def _difference(state: ScopeState) -> float:
    first, second = _heights(state)
    return second - first


def _distance(state: ScopeState) -> float:
    first, second = (state.panel.number(f"CURSOR:VBARS:POSITION{number}") for number in (1, 2))
    return second - first


def _bar_answer(leaf: str) -> Query:
    """9.9E37 and an event where the bars meet no waveform."""
    compute = {
        "HDELTa": _distance,
        "VDELTa": _difference,
        "HPOS1": lambda state: _height(state, 1),
        "HPOS2": lambda state: _height(state, 2),
        "SLOPE": _slope,
    }[leaf]

    def value(state: ScopeState) -> str:
        try:
            return nr3(compute(state), _DIGITS)
        except Refusal as refusal:
            state.status.post(refusal.event)
            return nr3(INVALID)

    return answer(f"CURSor:VBArs:{leaf}", value)


def _constant(header: str, text: str) -> Action:
    return Action(answer(header, lambda state: text))


def _printer_defaults() -> Order:
    def order(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
        no_argument(arguments)
        for row in state.rows_below("PICTBridge"):
            state.panel.values[row.header.upper()] = row.default

    return order


def actions(model: Model) -> Mapping[str, Action]:
    """Those that a model has."""
    table: dict[str, Action] = {}
    if model.letter_series:
        leaves = ("HDELTa", "VDELTa", "HPOS1", "HPOS2", *(("SLOPE",) if model.has_power_key else ()))
        table |= {f"CURSor:VBArs:{leaf}": Action(_bar_answer(leaf)) for leaf in leaves}
    if model.series in ("B", "C"):
        table["PICTBridge:DEF"] = Action(order=_printer_defaults())
    if model.series == "TPS":
        battery = {"GASgauge": str(_CHARGE), "STATUS": "FULLYCHARGED"}
        table |= {
            f"POWer:BATTERY{number}:{leaf}": _constant(f"POWer:BATTERY{number}:{leaf}", text)
            for number in _BATTERIES
            for leaf, text in battery.items()
        }
        table["POWer:AC:PRESENt"] = _constant("POWer:AC:PRESENt", "1")
        table["POWer:BATTERIES:TIME"] = _constant("POWer:BATTERIES:TIME", str(_MINUTES_LEFT))
    return table
