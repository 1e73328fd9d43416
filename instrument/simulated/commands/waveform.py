"""Waveform transfer: CURVe?, WFMPre?, WAVFrm? and DATa INIT.

Source: programmer manual 071-1075-04, pp. 2-84 to 2-91 and 2-240 to 2-260.
"""

from __future__ import annotations

from collections.abc import Mapping

from instrument.simulated.commands.action import Action, Query, one_argument
from instrument.simulated.commands.reference import (
    preamble_orders,
    save_waveform,
    transmission_orders,
    write_curve,
)
from instrument.simulated.front_end.traces import (
    PREAMBLE_FIELDS,
    TRANSMISSION_FIELDS,
    Trace,
    Transfer,
    encode,
    preamble,
)
from instrument.simulated.panel.event_table import Refusal
from instrument.simulated.panel.formats import Leaf
from instrument.simulated.panel.kinds import Words
from instrument.simulated.panel.models import Model
from instrument.simulated.panel.parsing import Argument
from instrument.simulated.state import ScopeState

# WFMPre:<wfm>? leaves out the transmission and answers in another order, p. 2-260
_NAMED_FIELDS = (
    "WFId", "PT_Fmt", "XINcr", "PT_Off", "XZEro", "XUNit", "YMUlt", "YZEro", "YOFf", "YUNit", "NR_Pt",
)  # fmt: skip
_ABSENT_FIELDS = ("XMUlt", "XOFf", "ZMUlt", "ZOFf", "ZUNit", "ZZEro")  # p. 2-259
_NOT_DISPLAYED = 2244
_INIT = Words("INIT")


def _source(state: ScopeState) -> Trace | None:
    return state.trace(state.panel.text("DATA:SOURCE"))


def curve(state: ScopeState) -> list[Leaf]:
    """The codes of DATa:SOUrce from START to STOP."""
    trace = _source(state)
    if trace is None:
        raise Refusal(_NOT_DISPLAYED)
    transfer = Transfer.of(state.panel)
    if transfer.swapped:
        state.status.post(530)
    return [(("CURVe",), encode(trace, transfer).decode("latin-1"))]


def whole_preamble(state: ScopeState) -> list[Leaf]:
    """The 16 fields, or the five of the transmission if the source is not displayed."""
    fields = preamble(_source(state), Transfer.of(state.panel))
    return [(("WFMPre", name), fields[name]) for name in PREAMBLE_FIELDS if name in fields]


def waveform(state: ScopeState) -> list[Leaf]:
    """Preamble and curve of the same record; only the transmission fields without a source."""
    leaves = whole_preamble(state)
    return leaves + curve(state) if len(leaves) > len(TRANSMISSION_FIELDS) else leaves


def _field(name: str) -> Query:
    def query(state: ScopeState) -> list[Leaf]:
        fields = preamble(_source(state), Transfer.of(state.panel))
        if name not in fields:
            raise Refusal(_NOT_DISPLAYED)
        return [(("WFMPre", name), fields[name])]

    return query


def _absent(state: ScopeState) -> list[Leaf]:
    raise Refusal(100)


def _ignored(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """The set form of a field that this family does not have."""


def _preamble_of(source: str) -> Query:
    def query(state: ScopeState) -> list[Leaf]:
        trace = state.trace(source)
        if trace is None:
            raise Refusal(_NOT_DISPLAYED)
        fields = preamble(trace, Transfer.of(state.panel))
        return [(("WFMPre", source, name), fields[name]) for name in _NAMED_FIELDS]

    return query


def _named_field(source: str, name: str) -> Query:
    whole = _preamble_of(source)
    at = _NAMED_FIELDS.index(name)
    return lambda state: [whole(state)[at]]


def _data_init(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    _INIT.read(one_argument(arguments))
    state.data_init()


def _awaited(state: ScopeState) -> bool:
    return state.awaits_record()


def actions(model: Model) -> Mapping[str, Action]:
    """The waveform commands of a model."""
    orders = {**preamble_orders(), **transmission_orders()}
    table = {
        "CURVe": Action(curve, write_curve, waits=_awaited),
        "WAVFrm": Action(waveform, waits=_awaited),
        "WFMPre": Action(whole_preamble, waits=_awaited),
        "DATa": Action(order=_data_init),
        "SAVe:WAVEform": Action(order=save_waveform, waits=_awaited),
        **{f"WFMPre:{name}": Action(_field(name), orders[name], _awaited) for name in PREAMBLE_FIELDS},
        **{f"WFMPre:{name}": Action(_absent, _ignored) for name in _ABSENT_FIELDS},
    }
    for source in model.waveform_names:
        table[f"WFMPre:{source}"] = Action(_preamble_of(source), waits=_awaited)
        own = preamble_orders(source)
        for name in _NAMED_FIELDS:
            query = _named_field(source, name)
            table[f"WFMPre:{source}:{name}"] = Action(query, own[name], _awaited)
    return table
