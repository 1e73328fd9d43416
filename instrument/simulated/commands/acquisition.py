"""Commands of acquisition, trigger and measurements, and those that only later models have.

Source: programmer manual 071-1075-04, pp. 2-45 to 2-52 and 2-221 to 2-239.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from instrument.scpi import NO_DATA
from instrument.simulated.commands.tree import Action, Query, answer, one_argument, plain
from instrument.simulated.front_end.traces import clipping_event, measure, phase, unit
from instrument.simulated.panel.events import Guess, Refusal
from instrument.simulated.panel.models import Model
from instrument.simulated.panel.panel import store
from instrument.simulated.panel.parsing import INVALID, Argument, Leaf, nr3, quoted
from instrument.simulated.panel.settings import Words
from instrument.simulated.state import ScopeState

_COUNTER_GATE = 0.25  # s, window of the trigger frequency counter
_COUNTER_POINTS = 1 << 16
_SLOWEST_COUNTED = 10.0  # Hz

_STATES = Words(
    "ARMed", "REAdy", "TRIgger", "AUTo", "SAVe", "SCAn"
)  # SAV was seen, the other short forms are guesses
_FORCE = Words("FORCe")
_SET_LEVEL = Words("SETLevel")


def _force_trigger(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    _FORCE.read(one_argument(arguments))
    if not state.acquisition.force_trigger() and Guess.TRIGGER_IGNORED:
        raise Refusal(Guess.TRIGGER_IGNORED)


def _level_to_half(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """TRIGger:MAIn SETLevel: the middle between the extremes of the trigger signal."""
    _SET_LEVEL.read(one_argument(arguments))
    if not state.acquisition.running:
        raise Refusal(221)
    state.acquisition.settle()
    volts = _recent_trigger_signal(state)
    middle = float(volts.max() + volts.min()) / 2
    store(state.panel, "TRIGGER:MAIN:LEVEL", float(f"{middle:.6e}"))


def _trigger_frequency(state: ScopeState) -> str:
    """Rising edges through the level in the counter's gate; below 10 Hz no number and event 2207."""
    if state.panel.text("TRIGGER:MAIN:TYPE") == "VIDEO":
        state.status.post(221)
        return nr3(INVALID)
    above = _recent_trigger_signal(state) >= state.panel.number("TRIGGER:MAIN:LEVEL")
    edges = np.flatnonzero(~above[:-1] & above[1:])
    if len(edges) < 2:
        state.status.post(2207)
        return nr3(INVALID)
    step = _COUNTER_GATE / _COUNTER_POINTS
    frequency = (len(edges) - 1) / (float(edges[-1] - edges[0]) * step)
    if frequency < _SLOWEST_COUNTED:
        state.status.post(2207)
        return nr3(INVALID)
    return nr3(frequency, 6)


def _recent_trigger_signal(state: ScopeState) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    times = state.clock.now() - _COUNTER_GATE * (1 - np.arange(_COUNTER_POINTS) / _COUNTER_POINTS)
    return np.asarray(state.acquisition.trigger_signal(state.panel.trigger(), times)).reshape(-1)


def _acquisitions(state: ScopeState) -> str:
    state.acquisition.update()
    return str(0 if state.panel.scanning else state.acquisition.acquisitions)


ACQUISITION_ACTIONS = {
    "ACQuire:NUMACq": Action(answer("ACQuire:NUMACq", _acquisitions)),
    "TRIGger": Action(order=_force_trigger),
    "TRIGger:STATE": Action(
        answer(
            "TRIGger:STATE", lambda state: _STATES.write(state.acquisition.state(), state.panel.flag("VERBOSE"))
        )
    ),
    "TRIGger:MAIn": Action(order=_level_to_half),
    "TRIGger:MAIn:FREQuency": Action(answer("TRIGger:MAIn:FREQuency", _trigger_frequency)),
}


# --------------------
# MEASUrement and CURSor queries.
#
# Source: programmer manual 071-1075-04, pp. 2-75 to 2-83 and 2-159 to 2-170


_MEASURED_DIGITS = 11
_DECIMALS = 10  # of a measured value: a TDS2024 answered 9.99999046E-2 and 1.400003433E-1 V, 4.0E-4 s
_ALL_DIGITS = 15


def _value(branch: str) -> Query:
    """The value of a measurement; 9.9E37 and an event where there is none."""
    key = branch.upper()

    def query(state: ScopeState) -> list[Leaf]:
        try:
            # later models call the source of IMMed SOURCE1
            source = f"{key}:SOURCE1" if f"{key}:SOURCE1" in state.panel.values else f"{key}:SOURCE"
            value = _measured(state, state.panel.text(f"{key}:TYPE"), state.panel.text(source))
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
        second = state.trace(state.panel.text("MEASUREMENT:IMMED:SOURCE2"))
        if second is None:
            raise Refusal(2225)
        value = phase(trace, second)
    elif kind == "CURSORRMS":
        if state.panel.text("CURSOR:FUNCTION") != "VBARS":
            raise Refusal(2302)
        times = sorted(state.panel.number(f"CURSOR:VBARS:POSITION{n}") for n in (1, 2))
        first, last = (round((time - trace.xzero) / trace.xincr) for time in times)
        part = slice(max(first, 0), max(last, 0) + 1)
        value = measure("RMS", replace(trace, codes=trace.codes[part]))
    else:
        value = measure(kind, trace)
    state.status.post(clipping_event(trace))
    return value


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
        return nr3(second - first, _MEASURED_DIGITS)

    return answer(f"CURSor:{branch}:DELTa", difference)


def _horizontal_bar_units(state: ScopeState) -> str:
    source = state.panel.text("CURSOR:SELECT:SOURCE")
    trace = state.trace(source)
    word = {"Volts": "VOLTs", "V": "VOLTs", "dB": "DECIBELs", "U": "UNKNOWN"}
    spelled = word.get(trace.yunit, "UNKNOWN") if trace is not None else "DIVs"
    return spelled.upper()


CURSOR_ACTIONS = {
    "CURSor:HBArs:DELTa": Action(_cursor_delta("HBArs")),
    "CURSor:HBArs:UNIts": Action(answer("CURSor:HBArs:UNIts", _horizontal_bar_units)),
    "CURSor:VBArs:DELTa": Action(_cursor_delta("VBArs")),
}


# --------------------
# Commands of B, C and TPS models: cursors on the waveform, batteries, and the printer at the USB port.
#
# Source: programmer manual 071-1075-04, pp. 2-28 to 2-32, 2-79 to 2-83 and 2-171 ff. The words that the
# battery answers are guesses


_CURSORS_OFF, _SOURCE_OFF, _OFF_SCREEN = 2302, 2303, 2301
_DIGITS = 11
_BATTERIES = (1, 2)
_CHARGE = 100  # percent: the battery of a simulated instrument stays full
_MINUTES_LEFT = 480  # of both batteries together


def _time(state: ScopeState, number: int) -> float:
    """Where a bar stands, s."""
    position = state.panel.number(f"CURSOR:VBARS:POSITION{number}")
    hertz = state.panel.text("CURSOR:VBARS:UNITS") == "HERTZ"
    return 1 / position if hertz and position else position


def _height(state: ScopeState, number: int) -> float:
    """Volts of the waveform where a bar stands."""
    if state.panel.text("CURSOR:FUNCTION") != "VBARS":
        raise Refusal(_CURSORS_OFF)
    trace = state.trace(state.panel.text("CURSOR:SELECT:SOURCE"))
    if trace is None:
        raise Refusal(_SOURCE_OFF)
    point = round((_time(state, number) - trace.xzero) / trace.xincr)
    if not 0 <= point < trace.points or trace.codes[point] == NO_DATA:
        raise Refusal(_OFF_SCREEN)
    return (float(trace.codes[point]) - trace.yoff) * trace.ymult + trace.yzero


def _slope(state: ScopeState) -> float:
    first, second = (_height(state, number) for number in (1, 2))
    elapsed = _time(state, 2) - _time(state, 1)
    if not elapsed:
        raise Refusal(_OFF_SCREEN)
    return (second - first) / elapsed


def _bar_answer(leaf: str) -> Query:
    """9.9E37 and an event where the bars meet no waveform."""
    compute = {
        "HDELTa": lambda state: (
            state.panel.number("CURSOR:VBARS:POSITION2") - state.panel.number("CURSOR:VBARS:POSITION1")
        ),
        "VDELTa": lambda state: _height(state, 2) - _height(state, 1),
        "HPOS1": lambda state: _height(state, 1),
        "HPOS2": lambda state: _height(state, 2),
        "SLOPE": _slope,
    }[leaf]
    return _or_invalid(f"CURSor:VBArs:{leaf}", compute)


# The power key of a TPS: what its queries are called below their first word, and how they compute, are guesses


_POWER = {
    "HARmonics": ("FREQuency", "RMS", "PERCent", "PHAse", "THDF", "THDR"),
    "POWerANALYSIS": ("TRUEpower", "APParentpower", "PFActor"),
    "SWLoss": ("TOTAL:POWer", "TOTAL:ENERGY"),
    "WAVEFORMANALYSIS": ("FREQuency", "RMS", "CFActor"),
}


def _volts(state: ScopeState, source: str) -> tuple[NDArray[np.float64], NDArray[np.floating]]:
    """A trace, and the turns of its fundamental that have passed."""
    trace = state.trace(source)
    if trace is None:
        raise Refusal(_SOURCE_OFF)
    volts = (trace.codes.astype(np.float64) - trace.yoff) * trace.ymult + trace.yzero
    return volts, np.arange(len(volts)) * trace.xincr * _measured(state, "FREQUENCY", source)


def _power(state: ScopeState, branch: str, leaf: str) -> float:
    """One number of the power key."""
    pair, key = branch in ("POWerANALYSIS", "SWLoss"), branch.upper()
    source = state.panel.text(f"{key}:SOURCE{'S' if pair else ''}")
    volts, turns = _volts(state, source[:3])
    frequency, rms = _measured(state, "FREQUENCY", source[:3]), float(np.sqrt(np.mean(volts**2)))
    if pair:
        amperes = _volts(state, source[3:])[0]
        watts, apparent = float(np.mean(volts * amperes)), rms * float(np.sqrt(np.mean(amperes**2)))
        seconds = float(turns[-1]) / frequency
        others = {"APParentpower": apparent, "PFActor": watts / apparent, "TOTAL:ENERGY": watts * seconds}
        return others.get(leaf, watts)
    if branch == "WAVEFORMANALYSIS":
        return {"FREQuency": frequency, "RMS": rms}.get(leaf, float(np.abs(volts).max()) / rms)
    whole = turns < max(np.floor(turns[-1]), 1)
    waves = np.exp(-2j * np.pi * np.arange(1, 51)[:, np.newaxis] * turns[whole])
    found, number = 2 * (waves @ volts[whole]) / whole.sum(), round(state.panel.number(f"{key}:SELECT"))
    sizes = np.abs(found)
    return {
        "FREQuency": number * frequency,
        "RMS": float(sizes[number - 1] / np.sqrt(2)),
        "PERCent": float(100 * sizes[number - 1] / sizes[0]),
        "PHAse": float(np.angle(found[number - 1], deg=True)),
        "THDF": float(100 * np.linalg.norm(sizes[1:]) / sizes[0]),
        "THDR": float(100 * np.linalg.norm(sizes[1:]) / np.linalg.norm(sizes)),
    }[leaf]


def _or_invalid(header: str, compute: Callable[[ScopeState], float]) -> Query:
    """9.9E37 and an event where there is no such number."""

    def value(state: ScopeState) -> str:
        try:
            return nr3(compute(state), _DIGITS)
        except Refusal as refusal:
            state.status.post(refusal.event)
            return nr3(INVALID)

    return answer(header, value)


def _constant(header: str, text: str) -> Action:
    return Action(answer(header, lambda state: text))


def _printer_defaults(state: ScopeState) -> None:
    for row in state.rows_below("PICTBridge"):
        state.panel.values[row.header.upper()] = row.default


def actions(model: Model) -> Mapping[str, Action]:
    """Those that a model has."""
    table: dict[str, Action] = {}
    for branch in ("IMMed", *(f"MEAS{number}" for number in range(1, model.measurements + 1))):
        branch = f"MEASUrement:{branch}"
        table[f"{branch}:VALue"] = Action(_value(branch), waits=lambda s: s.awaits_record())
        table |= {branch: Action(_branch(branch)), f"{branch}:UNIts": Action(_units(branch))}
    if model.has_power_key:
        for branch, leaf in ((branch, leaf) for branch, leaves in _POWER.items() for leaf in leaves):
            header = f"{branch}:{leaf}"
            table[header] = Action(_or_invalid(header, partial(_power, branch=branch, leaf=leaf)))
    if model.letter_series:
        leaves = ("HDELTa", "VDELTa", "HPOS1", "HPOS2", *(("SLOPE",) if model.has_power_key else ()))
        table |= {f"CURSor:VBArs:{leaf}": Action(_bar_answer(leaf)) for leaf in leaves}
    if model.series in ("B", "C"):
        table["PICTBridge:DEF"] = Action(order=plain(_printer_defaults))
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
