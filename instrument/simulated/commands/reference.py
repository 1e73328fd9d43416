"""Writing references: CURVe, the set forms of WFMPre, and SAVe:WAVEform.

Source: programmer manual 071-1075-04, pp. 2-42, 2-84, 2-191 and 2-243 to 2-260.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from instrument.facts import NO_DATA, POINTS
from instrument.simulated.commands.action import Order, one_argument
from instrument.simulated.front_end.traces import Trace, Transfer, decode
from instrument.simulated.panel.event_table import Guess, Refusal
from instrument.simulated.panel.kinds import Text, Words, number
from instrument.simulated.panel.parsing import Argument

if TYPE_CHECKING:
    from instrument.simulated.scope import SimulatedTDS2014

_NOT_A_REFERENCE = 2241
_NUMBERS = {"XINcr": "xincr", "XZEro": "xzero", "YMUlt": "ymult", "YZEro": "yzero", "YOFf": "yoff"}
_STRINGS = {"XUNit": "xunit", "YUNit": "yunit", "WFId": "wfid"}
_POINT_FORMATS = Words("ENV", "Y")


def empty_reference(name: str) -> Trace:
    """A reference memory that was never written."""
    letter = name[-1]
    wfid = f"Ref{letter}, DC coupling, 1.0E0 V/div, 5.0E-4 s/div, {POINTS} points, Sample mode"
    codes = np.full(POINTS, NO_DATA, dtype=np.int8)
    return Trace(codes, wfid, "Y", 2e-6, -2.5e-3, "s", 0.04, 0.0, 0.0, "Volts")


def save_waveform(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    """SAVe:WAVEform <wfm>,REF<x>: copy what is displayed into a reference."""
    if len(arguments) != 2:
        raise Refusal(Guess.SURPLUS_ARGUMENT if len(arguments) > 2 else Guess.MISSING_ARGUMENT)
    source = Words(*scope.model.waveform_names).read(arguments[0])
    target = Words(*scope.model.reference_names).read(arguments[1])
    trace = scope.trace(source)
    if trace is None:
        raise Refusal(2245)
    head, _, rest = trace.wfid.partition(",")
    scope.references[target] = replace(trace, wfid=f"Ref{target[-1]},{rest}" if rest else head)


def write_curve(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    """CURVe <block or list>: write codes into DATa:DESTination from point STARt on."""
    if not arguments:
        raise Refusal(Guess.MISSING_ARGUMENT)
    transfer = Transfer.of(scope.panel)
    if arguments[0].data is not None:
        if len(arguments) > 1:
            raise Refusal(Guess.SURPLUS_ARGUMENT)
        new = decode(arguments[0].data, transfer)
    else:
        scale = 256 if transfer.width == 2 else 1
        values = np.array([number(argument) for argument in arguments]) / scale
        new = np.clip(np.trunc(values), -128, 127).astype(np.int8)
    name = scope.panel.text("DATA:DESTINATION")
    reference = scope.references[name]
    codes = np.full(POINTS, NO_DATA, dtype=np.int8)
    codes[: reference.points] = reference.codes
    room = POINTS - (transfer.start - 1)
    if len(new) > room:
        scope.status.post(532)
    codes[transfer.start - 1 : transfer.start - 1 + len(new)] = new[:room]
    scope.references[name] = replace(reference, codes=codes)


def preamble_orders(target: str = "") -> dict[str, Order]:
    """Set forms of the preamble of one waveform; without a name of the one DATa:DESTination names."""
    orders: dict[str, Order] = {"NR_Pt": _accepted, "PT_Off": _accepted}
    for header, attribute in {**_NUMBERS, **_STRINGS, "PT_Fmt": "pt_fmt"}.items():
        orders[header] = _field_order(target, header, attribute)
    return orders


def _field_order(target: str, header: str, attribute: str) -> Order:
    def order(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
        name = target or scope.panel.text("DATA:DESTINATION")
        if name not in scope.references:
            raise Refusal(_NOT_A_REFERENCE)
        argument = one_argument(arguments)
        value: Any
        if header in _NUMBERS:
            value = number(argument)
            if scope.panel.number("DATA:WIDTH") == 2:
                value *= {"YMUlt": 256, "YOFf": 1 / 256}.get(header, 1)
        else:
            value = (Text() if header in _STRINGS else _POINT_FORMATS).read(argument)
        scope.references[name] = replace(scope.references[name], **{attribute: value})

    return order


def _accepted(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
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
    def order(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
        scope.panel.values["DATA:WIDTH"] = 2 if number(one_argument(arguments)) > 1.5 * bits else 1

    return order


def _set_encoding(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    word = Words("ASCii", "BINary").read(one_argument(arguments))
    was_ascii = scope.panel.text("DATA:ENCDG") == "ASCII"
    if word == "ASCII":
        scope.panel.values["DATA:ENCDG"] = "ASCII"
    elif was_ascii:
        scope.panel.values["DATA:ENCDG"] = "RPBINARY"


def _set_format(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    word = Words("RI", "RP").read(one_argument(arguments))
    _set_binary(scope, word, Transfer.of(scope.panel).fields["BYT_Or"])


def _set_byte_order(scope: SimulatedTDS2014, arguments: tuple[Argument, ...]) -> None:
    word = Words("LSB", "MSB").read(one_argument(arguments))
    _set_binary(scope, Transfer.of(scope.panel).fields["BN_Fmt"], word)


def _set_binary(scope: SimulatedTDS2014, number_format: str, byte_order: str) -> None:
    if scope.panel.text("DATA:ENCDG") != "ASCII":
        swapped = "S" if byte_order == "LSB" else ""
        scope.panel.values["DATA:ENCDG"] = f"{swapped}{number_format}BINARY"
