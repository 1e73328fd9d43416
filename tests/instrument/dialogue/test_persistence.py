"""A program that nobody watches, on a link that spoils messages each way, is pulled, hangs or is switched off."""

import contextlib
import socket
import sys
import threading
import time

import numpy as np
import pytest

from benchmarks.links.fault_proxy import KINDS, FaultProxy
from benchmarks.links.recording_scope import RecordingScope
from instrument import TDS2014, LinkError, Persistence, SettingError, TransferError, WrongInstrument
from instrument.dialogue.link import Link
from instrument.simulated import Fault, PtyServer, SimulatedTDS2014, TcpServer, VirtualClock

on_unix = pytest.mark.skipif(sys.platform == "win32", reason="there are no ptys on Windows")


def drifting(times):
    return 0.8 * np.sin(2 * np.pi * 997.13 * times)


@pytest.fixture
def shown():
    """A scope on a virtual clock that remembers what it has shown; every acquisition differs."""
    return RecordingScope.watch(SimulatedTDS2014({1: drifting}, clock=VirtualClock(), seed=3))


@pytest.fixture
def quick(monkeypatch):
    """Faults are waited out for a tenth of the time: the scope is on this computer."""
    monkeypatch.setattr("instrument.dialogue.link.ANSWER_TIME", 0.3)
    monkeypatch.setattr("instrument.dialogue.link.PAUSE_TIME", 0.05)


def panel_of(scope):
    with scope.lock:
        return b"".join(answer or b"" for answer in scope.execute(b":HEADER ON;:SET?")), scope.status.esr_mask


def persistent(name, manager, **changes):
    wanted = {"attempts": 20, "reconnect_for": 20.0, **changes}
    # A fast line: what an answer may take follows from it.
    return TDS2014(name, resource_manager=manager, baud_rate=115_200, persistence=Persistence(**wanted))


def set_up(driver):
    driver.set_channel("CH1", probe=1, scale=0.5, position=0.4)
    driver.set_timebase(2.5e-4)
    driver.set_trigger(source="CH1", level=0.1, slope="RISE")


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [KINDS[:1] + KINDS[6:8], KINDS[1:5], (KINDS[5], KINDS[8])])
def test_every_kind_of_fault_each_way(shown, manager, quick, kinds):
    shown.status.esr_mask = 5
    before = panel_of(shown)
    with TcpServer(shown) as server, FaultProxy(server.port, 0.1, seed=5, kinds=kinds, late=0.4) as proxy:
        with persistent(proxy.resource_name, manager) as driver:
            set_up(driver)
            waveforms = [driver.acquire("CH1") for _ in range(4)]
        assert proxy.happened.total() > 2
    taken_from = [
        shown.acquisition_of(one.codes.tobytes(), one.preamble.ymult, one.preamble.xincr) for one in waveforms
    ]
    assert None not in taken_from
    assert taken_from == sorted(set(taken_from))  # none is an old one
    assert all(one.preamble.ymult == pytest.approx(0.5 / 25) for one in waveforms)
    assert driver.link_faults.repeated > 0
    assert panel_of(shown) == before
    assert driver.front_panel_is_back


def test_an_answer_that_comes_twice_is_not_taken_for_the_next_one(shown, manager, quick):
    with TcpServer(shown) as server, persistent(server.resource_name, manager) as driver:
        first = driver.acquire("CH1")
        shown.faults.add(Fault("repeated answer", answer=1))
        second, third = driver.acquire("CH1"), driver.acquire("CH1")
    assert len({one.codes.tobytes() for one in (first, second, third)}) == 3


def test_a_byte_changed_inside_a_curve_is_seen(shown, manager, quick):
    with TcpServer(shown) as server, persistent(server.resource_name, manager) as driver:
        driver.acquire("CH1")
        for at in (300, 1500, 3000, 4500):
            shown.faults.add(Fault("changed byte", answer=1, bytes_sent=at))
            waveform = driver.acquire("CH1")
            assert shown.acquisition_of(waveform.codes.tobytes(), *scales(waveform)) is not None
        assert driver.link_faults.repeated == 4


def scales(waveform):
    return waveform.preamble.ymult, waveform.preamble.xincr


def test_a_question_of_which_only_the_mark_arrives_is_asked_again(shown, manager, quick):
    class CutOnce(RecordingScope):
        cut = 0

        def execute(self, message, **how):
            if b":SET?" in message and not self.cut:
                self.cut += 1
                message = message[: message.index(b":SET?")].rstrip(b";")
            return super().execute(message, **how)

    with TcpServer(CutOnce.watch(shown)) as server, persistent(server.resource_name, manager) as driver:
        setup = driver.read_setup()
        assert shown.cut == 1 and driver.link_faults.repeated == 1
        assert setup == driver.read_setup() and "CH1:" in setup


def test_a_request_that_never_arrives_gives_no_old_record(shown, manager, quick):
    # Without persistence too: the scope then holds the record of the last request.
    with TcpServer(shown) as server, TDS2014(server.resource_name, resource_manager=manager) as driver:
        driver.acquire("CH1")
        shown.faults.add(Fault("lost message", answer=1))
        with pytest.raises(TransferError, match="acquires nothing"):
            driver.acquire("CH1")


class SpoilingOnce(RecordingScope):
    """Takes one command in another form that is right as well, as damage on the way may give it."""

    spoil: tuple[bytes, bytes] | None = None
    spoiled = 0

    def execute(self, message, **how):
        if self.spoil is not None and self.spoil[0] in message:
            message = message.replace(*self.spoil, 1)
            self.spoil = None
            self.spoiled += 1
        return super().execute(message, **how)


@pytest.mark.parametrize("persistence", [{}, {"attempts": 1, "reconnect_for": 0.0}])
@pytest.mark.parametrize(
    "spoil",
    [
        (b":ACQUIRE:STATE 1", b":ACQUIRE:STATE 0"),
        (b":ACQUIRE:NUMAVG 16", b":ACQUIRE:NUMAVG 64"),
        (b":TRIGGER:MAIN:EDGE:SLOPE FALL", b":TRIGGER:MAIN:EDGE:SLOPE RISE"),
        (b":CH1:SCALE 2.0E-1", b":CH1:SCALE 5.0E-1"),
        (b":DATA:STOP 2400", b":DATA:STOP 2500"),
    ],
)
def test_a_right_but_other_value_is_not_left_on_the_front_panel(shown, manager, quick, spoil, persistence):
    scope = SpoilingOnce.watch(shown)
    list(scope.execute(b":DATA:STOP 2400;:CH1:SCALE 0.2;:TRIGGER:MAIN:EDGE:SLOPE FALL"))
    before, running = panel_of(scope), list(scope.execute(b":ACQUIRE:STATE?"))
    with TcpServer(scope) as server:
        with persistent(server.resource_name, manager, **persistence) as driver:
            set_up(driver)
            driver.acquire("CH1")
            scope.spoil = spoil
        assert scope.spoiled == 1
    assert panel_of(scope) == before
    assert list(scope.execute(b":ACQUIRE:STATE?")) == running


def test_what_does_not_come_back_is_named(shown, manager, quick):
    class Stuck(RecordingScope):
        def execute(self, message, **how):
            return super().execute(message.replace(b":CH1:SCALE 1.0E0", b":CH1:SCALE 5.0E-1"), **how)

    with (
        TcpServer(Stuck.watch(shown)) as server,
        pytest.raises(SettingError, match=r"CH1:SCALE was found at 1\.0E0 and is 5\.0E-1 after it was put back"),
        TDS2014(server.resource_name, resource_manager=manager) as driver,
    ):
        driver.set_channel("CH1", scale=0.5)


def test_switched_off_and_on_with_other_settings(shown, manager, quick):
    told = []
    before = panel_of(shown)
    with TcpServer(shown) as server, persistent(server.resource_name, manager, tell=told.append) as driver:
        set_up(driver)
        driver.acquire("CH1")
        shown.power_off()
        threading.Timer(1.0, lambda: (shown.reset(), shown.power_on())).start()
        waveform = driver.acquire("CH1")
        assert scales(waveform) == pytest.approx((0.5 / 25, 1e-6))
        assert driver.link_faults.reconnected == 1
        assert driver.link_faults.set_again >= 4
    assert "trying to connect again" in told[0]
    assert "answers again" in told[-1]
    assert panel_of(shown) == before


def test_cable_pulled_and_plugged_in(shown, manager, quick):
    with TcpServer(shown) as server, persistent(server.resource_name, manager) as driver:
        set_up(driver)
        shown.faults.unplugged = True
        threading.Timer(1.5, lambda: setattr(shown.faults, "unplugged", False)).start()
        driver.acquire("CH1")
        assert driver.link_faults.repeated >= 1


def test_a_scope_that_hangs(shown, manager, quick):
    with TcpServer(shown) as server, persistent(server.resource_name, manager) as driver:
        first = driver.acquire("CH1")
        shown.faults.hung = True
        threading.Timer(1.5, lambda: setattr(shown.faults, "hung", False)).start()
        # Everything that was asked meanwhile is answered then, at once.
        assert driver.acquire("CH1") != first


def test_another_scope_on_the_line_is_not_taken_for_this_one(shown, manager, quick):
    with (
        TcpServer(shown) as server,
        pytest.raises(WrongInstrument, match="another instrument answers"),
        persistent(server.resource_name, manager) as driver,
    ):
        driver.acquire("CH1")
        shown.faults.identity = "TEKTRONIX,TDS 2024,0,CF:91.1CT FV:v4.12 TDS2CM:CMV:v1.04"
        shown.faults.add(Fault("link closed", answer=1))
        driver.acquire("CH1")


def test_a_scope_that_does_not_come_back_is_given_up_once(shown, manager, quick):
    with TcpServer(shown) as server:
        driver = persistent(server.resource_name, manager, reconnect_for=1.0)
        set_up(driver)
        shown.power_off()
        with pytest.raises(LinkError, match=r"could not be reached again in \d+ s"):
            driver.acquire("CH1")
        asked = driver.link_faults.repeated
        with pytest.raises(LinkError):
            driver.close()
        assert driver.link_faults.repeated == asked
        assert not driver.front_panel_is_back


def test_what_the_scope_refuses_is_still_refused(shown, manager, quick):
    with TcpServer(shown) as server, persistent(server.resource_name, manager) as driver:
        with pytest.raises(SettingError, match=r"HORIZONTAL:MAIN:SCALE was set to 3\.0E2"):
            driver.set_timebase(300.0)
        assert driver.link_faults.repeated == 1  # once more, in case it was the line


@on_unix
def test_on_a_serial_line(shown, manager, quick):
    before = panel_of(shown)
    kinds = (
        "lost byte",
        "changed byte",
        "repeated answer",
        "garbage",
        "lost answer",
        "cut answer",
        "framing error",
    )
    with PtyServer(shown) as server, persistent(server.resource_name, manager) as driver:
        set_up(driver)
        for number, kind in enumerate(kinds):
            shown.faults.add(Fault(kind, answer=1 + number % 2))
            waveform = driver.acquire("CH1")
            assert shown.acquisition_of(waveform.codes.tobytes(), *scales(waveform)) is not None
        assert driver.link_faults.repeated >= len(kinds) - 1
    assert panel_of(shown) == before


class NotedClock:
    """The computer's clock; it notes for how long somebody slept by it."""

    def __init__(self) -> None:
        self.longest = 0.0

    now = staticmethod(time.monotonic)

    def sleep(self, seconds: float) -> None:
        self.longest = max(self.longest, seconds)
        time.sleep(seconds)


@on_unix
def test_a_line_that_keeps_the_order_is_not_waited_for_in_the_end(shown, manager):
    clock = NotedClock()
    with PtyServer(shown) as server:
        with persistent(server.resource_name, manager, answer_time=20.0, clock=clock) as driver:
            for _ in range(3):
                driver.acquire("CH1")
            shown.faults.add(Fault("lost answer", answer=1))
            driver.acquire("CH1")
            assert driver.link_faults.repeated
            clock.longest = 0.0
        assert clock.longest < 5.0
        assert driver.front_panel_is_back


# ---------------------------------------------------------------------- time


@pytest.fixture
def trickle():
    """A peer that answers with one byte each 50 ms, for as long as it is asked to."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        ended = threading.Event()

        def send() -> None:
            client, _ = listener.accept()
            with client, contextlib.suppress(OSError):
                while not ended.wait(0.05):
                    client.sendall(b"7")

        thread = threading.Thread(target=send)
        thread.start()
        yield f"TCPIP0::127.0.0.1::{listener.getsockname()[1]}::SOCKET"
        ended.set()
        thread.join()


def test_an_answer_that_trickles_in_ends(trickle, manager, quick):
    with Link(trickle, manager, baud_rate=19_200) as link:
        asked = time.monotonic()
        with pytest.raises(TransferError, match=r"about \d+ bytes in (\d\.\d) s came") as caught:
            link.read_text()
        waited = float(str(caught.value).split(" bytes in ")[1].split()[0])
        # What the message says is what was waited; the first byte came before it.
        assert waited == pytest.approx(time.monotonic() - asked, abs=0.5)


@pytest.mark.slow
def test_a_peer_that_trickles_is_no_scope(trickle, manager, quick):
    with pytest.raises((LinkError, TransferError, WrongInstrument)):
        TDS2014(trickle, resource_manager=manager, baud_rate=115_200)
