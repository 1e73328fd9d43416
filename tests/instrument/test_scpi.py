"""Numbers, strings and blocks on the wire, against the forms that the programmer manual prints."""

import math

import pytest
from hypothesis import given, strategies as st

from instrument import scpi
from instrument.errors import TransferError


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0.0E0"),
        (5e-4, "5.0E-4"),
        (1.0, "1.0E0"),
        (2.22e-4, "2.22E-4"),
        (-11008.0, "-1.1008E4"),
        (3.852921, "3.852921E0"),
        (25252.5253, "2.52525253E4"),
        (50.0, "5.0E1"),
    ],
)
def test_nr3_as_the_scope_writes_it(value, text):
    assert scpi.nr3(value) == text
    assert scpi.number(text) == value


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_nr3_reads_back_to_the_same_float(value):
    assert scpi.number(scpi.nr3(value)) == value


@pytest.mark.parametrize("text", ["", "nan", "inf", "1_0", "1.0E", "two", "1.0E999", "--1", '"1"'])
def test_not_a_number(text):
    with pytest.raises(TransferError, match="number"):
        scpi.number(text)


def test_whole_numbers():
    assert scpi.integer("2500") == 2500
    assert scpi.integer("5.0E1") == 50
    with pytest.raises(TransferError, match="whole"):
        scpi.integer("2.5")


def test_parts_are_not_split_inside_strings():
    assert scpi.split_parts('1;"a;b";2') == ["1", '"a;b"', "2"]
    assert scpi.split_parts('113,"Undefined, header; FOO",0,""', ",") == [
        "113",
        '"Undefined, header; FOO"',
        "0",
        '""',
    ]


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        (":CH1:COUPLING DC", (":CH1:COUPLING", "DC")),
        ('YUNIT "Volts"', ("YUNIT", '"Volts"')),
        ("ON", ("", "ON")),
        ("-1.69E2", ("", "-1.69E2")),
        ('"Ch1, DC coupling"', ("", '"Ch1, DC coupling"')),
    ],
)
def test_headers(part, expected):
    assert scpi.split_header(part) == expected


def test_quotes():
    assert scpi.unquote('"s"') == "s"
    assert scpi.unquote('"say ""no"""') == 'say "no"'
    assert scpi.unquote("BARE") == "BARE"


@given(
    st.binary(max_size=600),
    st.sampled_from([b"", b"\n", b"\r\n"]),
    st.sampled_from(["", "1;2;", ":CURVE ", '"#";']),
)
def test_block_of_any_bytes_comes_back(data, end, prefix):
    digits = str(len(data)).encode()
    message = prefix.encode() + b"#%d" % len(digits) + digits + data + end
    assert scpi.split_block(message, longest=600, terminated=bool(end)) == (prefix, data)


@given(st.binary(min_size=1, max_size=300), st.data())
def test_block_is_read_by_length_however_it_is_cut(data, draw):
    message = b"1;#3%03d" % len(data) + data + b"\n"
    cut = draw.draw(st.integers(1, len(message)))
    missing = scpi.bytes_missing(message[:cut], longest=300)
    assert (missing == 0) == (cut == len(message))
    assert missing <= len(message) - cut
    if cut >= 7:  # the length is known: the count must be exact
        assert missing == len(message) - cut


@pytest.mark.parametrize(
    ("message", "problem"),
    [
        (b"#42500abc\n", "cut"),
        (b"#13abcd\n", "follow"),
        (b"#13ab\n", "no line end follows"),
        (b"#0abc", "instead of"),
        (b"#x", "instead of"),
        (b"#2 3abc", "length"),
        (b"#49999", "claims"),
        (b"#", "cut"),
        (b"#42", "length"),
        (b"\x80;#13abc\n", "not text"),
    ],
)
def test_damaged_blocks_are_refused(message, problem):
    with pytest.raises(TransferError, match=problem):
        scpi.split_block(message, longest=5000)


def test_implausible_length_is_refused_before_waiting_for_it():
    with pytest.raises(TransferError, match="999999999"):
        scpi.bytes_missing(b"1;#9999999999", longest=5000)


def test_nr3_never_writes_what_is_not_nr3():
    for exponent in range(-12, 13):
        text = scpi.nr3(math.pi * 10.0**exponent)
        mantissa, power = text.split("E")
        assert 1 <= abs(float(mantissa)) < 10
        assert int(power) == exponent
