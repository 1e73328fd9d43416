"""Number and header forms against answers of real instruments."""

import pytest

from instrument.simulated.panel.parsing import StreamSplitter, block, nr3, parse_message


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0.0E0"),
        (0.0005, "5.0E-4"),
        (1, "1.0E0"),
        (2.22e-4, "2.22E-4"),
        (-11008, "-1.1008E4"),
        (3.852921, "3.852921E0"),
        (50, "5.0E1"),
        (3.125e-4, "3.125E-4"),
        (-169, "-1.69E2"),
        (32768, "3.2768E4"),
        (9.9e37, "9.9E37"),
    ],
)
def test_nr3_has_the_form_of_real_answers(value, text):
    assert nr3(value) == text


def test_nr3_keeps_the_digits_it_is_given():
    assert nr3(25252.5253, 9) == "2.52525253E4"
    assert nr3(2.4631931782, 11) == "2.4631931782E0"


def test_block_counts_its_bytes():
    assert block(bytes(500))[:5] == b"#3500"
    assert block(bytes(2500))[:6] == b"#42500"


@pytest.mark.parametrize("ending", [b"\n", b"\r", b"\r\n", b"\n\r"])
def test_every_terminator_ends_a_message_of_a_stream(ending):
    assert StreamSplitter().feed(b"*CLS" + ending + b"CH1?" + ending) == [b"*CLS", b"CH1?"]


def test_a_stream_may_cut_messages_anywhere():
    stream = b"DATA:SOURCE CH1\r\nCURVE #15\n\r;\n\n\nCH1?\n"
    whole = StreamSplitter().feed(stream)
    assert whole == [b"DATA:SOURCE CH1", b"CURVE #15\n\r;\n\n", b"CH1?"]
    splitter = StreamSplitter()
    assert [m for i in range(len(stream)) for m in splitter.feed(stream[i : i + 1])] == whole


@pytest.mark.parametrize("junk", [b"CURVE #9999999999abc\n", b"CURVE #9\n", b"CURVE #\n", b'REM "open\n', b"#5\n"])
def test_junk_with_a_hash_or_quote_does_not_swallow_the_next_message(junk):
    assert StreamSplitter().feed(junk + b"*IDN?\n")[-1] == b"*IDN?"


def test_semicolons_and_commas_inside_strings_and_blocks_do_not_split():
    commands = parse_message(b"*DDT \"A;B,C\";CURVE #13;,;;:REM 'it''s'")
    assert [c.header for c in commands] == ["*DDT", "CURVE", ":REM"]
    assert [a.text or a.data for c in commands for a in c.arguments] == ["A;B,C", b";,;", "it's"]
