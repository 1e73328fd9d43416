"""The event queue as exceptions of the right class."""

import pytest

from instrument.dialogue.identify import is_error, parse_events
from instrument.errors import TransferError


def test_events_as_the_manual_prints_them():
    # 071-1075-04, p. 2-36: an answer to ALLEv? with the header on.
    answer = ':ALLEV 2225,"Measurement error, No waveform to measure; ",420,"Query UNTERMINATED; "'
    first, second = parse_events(answer)
    assert (first.code, first.text) == (2225, "Measurement error, No waveform to measure")
    assert (second.code, second.text) == (420, "Query UNTERMINATED")
    assert type(first).__name__ == "ExecutionError"
    assert type(second).__name__ == "QueryError"


def test_event_classes():
    names = {
        113: "CommandError",
        222: "ExecutionError",
        363: "DeviceError",
        410: "QueryError",
        401: "ScopeEvent",
        532: "ExecutionError",
        2244: "ExecutionError",
    }
    for code, name in names.items():
        (event,) = parse_events(f'{code},"text; "')
        assert type(event).__name__ == name
        assert str(code) in str(event)
    assert parse_events('0,"No events to report : queue empty"') == []
    assert [is_error(e) for e in parse_events('401,"Power on; ",532,"Curve data too long; ",113,"x; "')] == [
        False,
        False,
        True,
    ]
    with pytest.raises(TransferError, match="event list"):
        parse_events("113")
