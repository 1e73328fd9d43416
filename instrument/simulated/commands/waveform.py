"""Waveform transfer: CURVe?, WFMPre?, WAVFrm? and DATa INIT; reference memories.

Source: programmer manual 071-1075-04, pp. 2-84 to 2-91 and 2-240 to 2-260.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from instrument.scpi import NO_DATA, POINTS
from instrument.simulated.commands.tree import Action, Order, Query, one_argument
from instrument.simulated.front_end.traces import (
    PREAMBLE_FIELDS,
    TRANSMISSION_FIELDS,
    Trace,
    Transfer,
    decode,
    encode,
    preamble,
)
from instrument.simulated.panel.events import Guess, Refusal
from instrument.simulated.panel.models import Model
from instrument.simulated.panel.parsing import Argument, Leaf
from instrument.simulated.panel.settings import Text, Words, number
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


# --------------------
# Writing references: CURVe, the set forms of WFMPre, and SAVe:WAVEform.
#
# Source: programmer manual 071-1075-04, pp. 2-42, 2-84, 2-191 and 2-243 to 2-260


_NOT_A_REFERENCE = 2241
_NUMBERS = {"XINcr": "xincr", "XZEro": "xzero", "YMUlt": "ymult", "YZEro": "yzero", "YOFf": "yoff"}
_STRINGS = {"XUNit": "xunit", "YUNit": "yunit", "WFId": "wfid"}
_POINT_FORMATS = Words("ENV", "Y")


def save_waveform(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """SAVe:WAVEform <wfm>,REF<x>: copy what is displayed into a reference."""
    if len(arguments) != 2:
        raise Refusal(Guess.SURPLUS_ARGUMENT if len(arguments) > 2 else Guess.MISSING_ARGUMENT)
    source = Words(*state.model.waveform_names).read(arguments[0])
    target = Words(*state.model.reference_names).read(arguments[1])
    trace = state.trace(source)
    if trace is None:
        raise Refusal(2245)
    head, _, rest = trace.wfid.partition(",")
    state.references[target] = replace(trace, wfid=f"Ref{target[-1]},{rest}" if rest else head)


def write_curve(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """CURVe <block or list>: write codes into DATa:DESTination from point STARt on."""
    if not arguments:
        raise Refusal(Guess.MISSING_ARGUMENT)
    transfer = Transfer.of(state.panel)
    if arguments[0].data is not None:
        if len(arguments) > 1:
            raise Refusal(Guess.SURPLUS_ARGUMENT)
        new = decode(arguments[0].data, transfer)
    else:
        scale = 256 if transfer.width == 2 else 1
        values = np.array([number(argument) for argument in arguments]) / scale
        new = np.clip(np.trunc(values), -128, 127).astype(np.int8)
    name = state.panel.text("DATA:DESTINATION")
    reference = state.references[name]
    codes = np.full(POINTS, NO_DATA, dtype=np.int8)
    codes[: reference.points] = reference.codes
    room = POINTS - (transfer.start - 1)
    if len(new) > room:
        state.status.post(532)
    codes[transfer.start - 1 : transfer.start - 1 + len(new)] = new[:room]
    state.references[name] = replace(reference, codes=codes)


def preamble_orders(target: str = "") -> dict[str, Order]:
    """Set forms of the preamble of one waveform; without a name of the one DATa:DESTination names."""
    orders: dict[str, Order] = {"NR_Pt": _accepted, "PT_Off": _accepted}
    for header, attribute in {**_NUMBERS, **_STRINGS, "PT_Fmt": "pt_fmt"}.items():
        orders[header] = _field_order(target, header, attribute)
    return orders


def _field_order(target: str, header: str, attribute: str) -> Order:
    def order(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
        name = target or state.panel.text("DATA:DESTINATION")
        if name not in state.references:
            raise Refusal(_NOT_A_REFERENCE)
        argument = one_argument(arguments)
        value: Any
        if header in _NUMBERS:
            value = number(argument)
            if state.panel.number("DATA:WIDTH") == 2:
                value *= {"YMUlt": 256, "YOFf": 1 / 256}.get(header, 1)
        else:
            value = (Text() if header in _STRINGS else _POINT_FORMATS).read(argument)
        state.references[name] = replace(state.references[name], **{attribute: value})

    return order


def _accepted(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    number(one_argument(arguments))


def transmission_orders() -> dict[str, Order]:
    """Set forms of the first five fields: they change the DATa settings."""
    return {
        "BYT_Nr": _set_width(1),
        "BIT_Nr": _set_width(8),
        "ENCdg": _set_encoding,
        "BN_Fmt": _set_format,
        "BYT_Or": _set_byte_order,
    }


def _set_width(bits: int) -> Order:
    def order(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
        state.panel.values["DATA:WIDTH"] = 2 if number(one_argument(arguments)) > 1.5 * bits else 1

    return order


def _set_encoding(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    word = Words("ASCii", "BINary").read(one_argument(arguments))
    was_ascii = state.panel.text("DATA:ENCDG") == "ASCII"
    if word == "ASCII":
        state.panel.values["DATA:ENCDG"] = "ASCII"
    elif was_ascii:
        state.panel.values["DATA:ENCDG"] = "RPBINARY"


def _set_format(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    word = Words("RI", "RP").read(one_argument(arguments))
    _set_binary(state, word, Transfer.of(state.panel).fields["BYT_Or"])


def _set_byte_order(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    word = Words("LSB", "MSB").read(one_argument(arguments))
    _set_binary(state, Transfer.of(state.panel).fields["BN_Fmt"], word)


def _set_binary(state: ScopeState, number_format: str, byte_order: str) -> None:
    if state.panel.text("DATA:ENCDG") != "ASCII":
        swapped = "S" if byte_order == "LSB" else ""
        state.panel.values["DATA:ENCDG"] = f"{swapped}{number_format}BINARY"
