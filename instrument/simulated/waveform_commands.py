"""Waveform transfer: CURVe?, WFMPre?, WAVFrm? and DATa INIT.

Source: programmer manual 071-1075-04, pp. 2-84 to 2-91 and 2-240 to 2-260.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from instrument.simulated.actions import Action, Query, one_argument
from instrument.simulated.events import Refusal
from instrument.simulated.formats import Leaf
from instrument.simulated.kinds import Words
from instrument.simulated.parsing import Argument
from instrument.simulated.traces import (
    PREAMBLE_FIELDS,
    TRANSMISSION_FIELDS,
    Trace,
    Transfer,
    encode,
    preamble,
)

if TYPE_CHECKING:
    from instrument.simulated.scope import SimulatedTDS2014

# WFMPre:<wfm>? leaves out the transmission and answers in another order, p. 2-260
_NAMED_FIELDS = (
    "WFId", "PT_Fmt", "XINcr", "PT_Off", "XZEro", "XUNit", "YMUlt", "YZEro", "YOFf", "YUNit", "NR_Pt",
)  # fmt: skip
_ABSENT_FIELDS = ("XMUlt", "XOFf", "ZMUlt", "ZOFf", "ZUNit", "ZZEro")  # p. 2-259
_NOT_DISPLAYED = 2244
_INIT = Words("INIT")
_DATA_DEFAULTS = ("ENCDG", "DESTINATION", "SOURCE", "START", "STOP", "WIDTH")


def _source(scope: SimulatedTDS2014) -> Trace | None:
    return scope.trace(scope.panel.text("DATA:SOURCE"))


def curve(scope: SimulatedTDS2014) -> list[Leaf]:
    """The codes of DATa:SOUrce from START to STOP."""
    trace = _source(scope)
    if trace is None:
        raise Refusal(_NOT_DISPLAYED)
    transfer = Transfer.of(scope.panel)
    if transfer.swapped:
        scope.status.post(530)
    return [(("CURVe",), encode(trace, transfer).decode("latin-1"))]


def whole_preamble(scope: SimulatedTDS2014) -> list[Leaf]:
    """The 16 fields, or the five of the transmission if the source is not displayed."""
    fields = preamble(_source(scope), Transfer.of(scope.panel))
    return [(("WFMPre", name), fields[name]) for name in PREAMBLE_FIELDS if name in fields]


def waveform(scope: SimulatedTDS2014) -> list[Leaf]:
    """Preamble and curve of the same record; only the transmission fields without a source."""
    leaves = whole_preamble(scope)
    return leaves + curve(scope) if len(leaves) > len(TRANSMISSION_FIELDS) else leaves


def _field(name: str) -> Query:
    def query(scope: SimulatedTDS2014) -> list[Leaf]:
        fields = preamble(_source(scope), Transfer.of(scope.panel))
        if name not in fields:
            raise Refusal(_NOT_DISPLAYED)
        return [(("WFMPre", name), fields[name])]

    return query


def _absent(scope: SimulatedTDS2014) -> list[Leaf]:
    raise Refusal(100)


def _ignored(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    """The set form of a field that this family does not have."""


def _preamble_of(source: str) -> Query:
    def query(scope: SimulatedTDS2014) -> list[Leaf]:
        trace = scope.trace(source)
        if trace is None:
            raise Refusal(_NOT_DISPLAYED)
        fields = preamble(trace, Transfer.of(scope.panel))
        return [(("WFMPre", source, name), fields[name]) for name in _NAMED_FIELDS]

    return query


def _data_init(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    _INIT.read(one_argument(arguments))
    data_init(scope)


def data_init(scope: SimulatedTDS2014) -> None:
    """DATa settings as at the factory."""
    for leaf in _DATA_DEFAULTS:
        row = scope.panel.rows[f"DATA:{leaf}"]
        scope.panel.values[f"DATA:{leaf}"] = row.default


def actions(channels: tuple[str, ...], references: tuple[str, ...]) -> Mapping[str, Action]:
    """The waveform commands of a model with these channels and references."""
    awaited = scope_awaits_record
    return {
        "CURVe": Action(curve, waits=awaited),
        "WAVFrm": Action(waveform, waits=awaited),
        "WFMPre": Action(whole_preamble, waits=awaited),
        **{f"WFMPre:{name}": Action(_field(name), waits=awaited) for name in PREAMBLE_FIELDS},
        **{f"WFMPre:{name}": Action(_absent, _ignored) for name in _ABSENT_FIELDS},
        **{
            f"WFMPre:{name}": Action(_preamble_of(name), waits=awaited)
            for name in (*channels, "MATH", *references)
        },
        "DATa": Action(order=_data_init),
    }


def scope_awaits_record(scope: SimulatedTDS2014) -> bool:
    """True while the first record with the present channels is still on its way (a guess: the unit waits)."""
    scope.acquisition.update()
    return scope.acquisition.awaited
