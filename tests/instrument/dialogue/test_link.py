"""Time limits, streams read by length, and what a link does when the other side misbehaves."""

import os
import sys

import pytest

from instrument import TDS2014, LinkError, TransferError
from instrument.dialogue.link import BITS_PER_BYTE, LINE_MARGIN, Link
from instrument.simulated import SimulatedTDS2014, resource_manager

on_unix = pytest.mark.skipif(sys.platform == "win32", reason="there are no ptys on Windows")


@on_unix
def test_line_time_follows_baud_rate_and_bytes(peer, manager):
    name = peer({}.get).name
    with Link(name, manager, baud_rate=300) as link:
        assert link.line_time(2507) == pytest.approx(2507 * BITS_PER_BYTE / 300 * LINE_MARGIN)
        assert not link.framed
    with Link(name, manager) as link:
        # Twice the bytes, twice the time; 9600 baud is the factory setting.
        assert link.line_time(5014) == pytest.approx(2 * link.line_time(2507))
        assert link.line_time(960) == pytest.approx(LINE_MARGIN)


@on_unix
def test_block_with_every_byte_is_read_by_its_length_and_leaves_nothing(peer, manager):
    data = bytes(range(256)) * 4 + b"\n\n#\n"
    block = b"#4%04d" % len(data) + data + b"\n"
    one = peer({b"BLOCK?": b'1;"#";' + block, b"NEXT?": b"2.5E0\n"}.get)
    with Link(one.name, manager, baud_rate=19200) as link:
        for _ in range(2):
            link.write("BLOCK?")
            assert link.read_blocks(longest=5000) == ([('1;"#";', data)], "")
            link.write("NEXT?")
            assert link.read_text() == "2.5E0"


@on_unix
def test_late_bytes_are_drained(peer, manager):
    one = peer({b"CURVE?": b"#10" + b"old\n" * 300, b"NEXT?": b"1\n"}.get)
    with Link(one.name, manager) as link:
        link.write("CURVE?")
        assert len(link.drain()) == 1203
        link.write("NEXT?")
        assert link.read_text() == "1"


@on_unix
def test_answer_that_does_not_end(peer, manager, impatient):
    one = peer({b"A?": b"12", b"B?": b"x" * 8000}.get)
    with Link(one.name, manager, baud_rate=19200) as link:
        link.write("A?")
        with pytest.raises(TransferError, match=r"about 1 bytes in [1-9]\.\d s came and no more"):
            link.read_text()
        link.write("B?")
        with pytest.raises(TransferError, match="without an end"):
            link.read_text(longest=100)


@on_unix
def test_clear_learns_from_dcl_that_a_break_works(peer, manager):
    # A pty carries no break, but the line feed in front of it arrives, so this peer can answer it.
    one = peer({b"": b"DCL\n"}.get)
    with Link(one.name, manager) as link:
        assert not link.can_clear
        link.clear()
        assert link.can_clear
    mute = peer({}.get)
    with Link(mute.name, manager) as link:
        link.clear()
        assert not link.can_clear


def test_framed_link_needs_no_patience_for_its_baud_rate():
    name = "GPIB0::1::INSTR"
    visa = resource_manager(scopes={name: SimulatedTDS2014()})
    with Link(name, visa) as link:
        assert link.framed
        assert link.can_clear
        link.write("*IDN?")
        assert link.read_text().startswith("TEKTRONIX,TDS 2014")
    visa.close()


@pytest.mark.slow
@pytest.mark.parametrize("line_end", ["CR", "CRLF", "LFCR", "LF"])
@on_unix
def test_scope_with_any_line_end_setting(line_end, manager, impatient):
    from instrument.simulated import PtyServer

    scope = SimulatedTDS2014({})
    list(scope.execute(f"RS232:TRANSMIT:TERMINATOR {line_end}".encode()))
    with PtyServer(scope) as server, TDS2014(server.resource_name, resource_manager=manager) as driver:
        first = driver.acquire("CH1")
        assert driver.fetch("CH1") == first


@on_unix
def test_serial_line_that_goes_away(manager, impatient):
    import tty

    master, slave = os.openpty()
    tty.setraw(slave)
    name = f"ASRL{os.ttyname(slave)}::INSTR"
    with Link(name, manager) as link:
        os.close(slave)
        os.close(master)
        with pytest.raises(LinkError, match=r"lost|failed"):
            link.read_text()


@on_unix
def test_soft_flagging_is_switched_off_and_on_again(manager, impatient):
    from instrument.simulated import PtyServer

    scope = SimulatedTDS2014({})
    list(scope.execute(b"RS232:SOFTFLAGGING ON"))

    def flagging():
        return b"".join(answer or b"" for answer in scope.execute(b":HEADER OFF;:RS232:SOFTF?;HARDF?"))

    assert flagging() == b"1;0"
    with PtyServer(scope) as server:
        with TDS2014(server.resource_name, resource_manager=manager) as driver:
            assert driver.query("RS232:SOFTF?") == "0"
            driver.acquire(1)
        # The last command has no answer to wait for: ask over the line, behind it.
        with Link(server.resource_name, manager) as link:
            link.write("RS232:SOFTF?;HARDF?")
            assert link.read_text() == "1;0"
