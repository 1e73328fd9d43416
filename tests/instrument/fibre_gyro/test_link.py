"""The link over real pseudo-terminals and sockets: what arrives, what is missing, what is said of silence."""

import contextlib
import math
import os
import socket
import struct
import sys
import threading
import time
from itertools import groupby

import numpy as np
import pytest

from instrument import LinkError, SettingError
from instrument.fibre_gyro import CommandRefused, FibreGyroLink, NoAcknowledgement, parse_frame_format
from instrument.simulated.fibre_gyro import GyroFault, GyroFaults, PtyGyroServer, TcpGyroServer

if sys.platform != "win32":
    import tty

no_pty = pytest.mark.skipif(sys.platform == "win32", reason="this system has no pseudo-terminals")

TEXT = {
    "kind": "ascii",
    "output_rate_hz": 100.0,
    "header": "$",
    "fields": [{"name": "counter", "modulus": 65536}, {"name": "counts"}, {"name": "temperature"}],
    "checksum": {"kind": "xor8"},
    "commands": {"inject": "$INJ,{step}*{checksum}\r\n", "open_loop": "$OPEN\r\n", "step_scale": 16},
    "answers": {"accepted": "$ACK*{checksum}\r\n", "refused": "$NAK*{checksum}\r\n", "answer_time_s": 0.1},
}
BINARY = {
    "kind": "binary",
    "output_rate_hz": 200.0,
    "header": "55 AA",
    "fields": [
        {"name": "counter", "bytes": 1},
        {"name": "counts", "bytes": 4},
        {"name": "temperature", "bytes": 2, "scale": 0.01},
        {"name": "error", "bytes": 2, "byte_order": "big"},
    ],
    "checksum": {"kind": "crc16-modbus"},
    "commands": {"inject": "A5 {step:4} {checksum}", "hold_feedback": "A6 {checksum}", "step_scale": 16},
    "answers": {"accepted": "55 AC {step:4} {checksum}", "refused": "55 AD {checksum}", "answer_time_s": 0.1},
}


class Line:
    """Counts that tell which output they are: 10 per output, and the injected step times a million on top."""

    def __init__(self) -> None:
        self.made, self.step, self.refuses = 0, 0.0, False

    def samples(self, count):
        n = np.arange(self.made, self.made + count)
        self.made += count
        return {"counts": 10 * n + round(self.step * 1e6), "temperature": 20 + n % 7, "error": n % 100}

    def command(self, name, step):
        if self.refuses:
            raise ValueError("busy")
        self.step = step


@contextlib.contextmanager
def bench(entries, faults=None, *, server=PtyGyroServer, speed=1.0, **options):
    layout = parse_frame_format(entries)
    model = Line()
    with (
        server(model, layout, speed=speed, faults=faults) as served,
        FibreGyroLink(served.port, layout, speed=speed, **options) as link,
    ):
        yield link, model, served


def true_places(recording) -> np.ndarray:
    """Where each output belongs by its own counts, from the first one."""
    return (recording.counts - recording.counts[0]) / 10


@pytest.mark.parametrize("entries", [TEXT, BINARY], ids=["text", "binary"])
@pytest.mark.parametrize("server", [pytest.param(PtyGyroServer, marks=no_pty), TcpGyroServer])
def test_undisturbed(entries, server):
    with bench(entries, server=server, speed=math.inf) as (link, _, _):
        done = []
        recording = link.record(6.0, skip_s=1.0, progress=done.append)
    n = round(6.0 / recording.interval_s)
    assert len(recording.times) == n == len(recording.counts)  # the 8-bit counter wraps four times
    assert np.array_equal(recording.times, np.arange(n) * recording.interval_s)
    assert np.array_equal(true_places(recording), np.arange(n))
    assert np.array_equal(recording.temperature, 20 + (recording.counts / 10) % 7)
    assert recording.complete and recording.gaps == ()
    assert (recording.losses.good, recording.losses.missing, recording.losses.damaged) == (n, 0, 0)
    assert recording.duration_s == pytest.approx(6.0)
    assert recording.clock == "counter"
    assert done[-1] == pytest.approx(7.0) and done == sorted(done)
    if entries is BINARY:
        assert np.array_equal(recording.extra["error"], (recording.counts / 10) % 100)


@no_pty
@pytest.mark.parametrize("entries", [TEXT, BINARY], ids=["text", "binary"])
def test_no_damaged_frame_is_used_and_every_missing_one_is_reported(entries):
    faults = GyroFaults(seed=8)
    for kind in ("lost byte", "inserted byte", "flipped bit", "lost frame"):
        faults.add(GyroFault(kind, probability=0.01))
    # As fast as it is read: a computer that is busy for a tenth of a second is no silence of the gyro then.
    with bench(entries, faults, speed=math.inf) as (link, _, served):
        recording = link.record(20.0)
        happened = [number for number, _ in served.faults.happened]
    places = np.round(recording.times / recording.interval_s)
    assert np.array_equal(true_places(recording), places - places[0])
    inside = {n for n in happened if n - recording.counts[0] / 10 in range(len(places))}
    wanted = round(20.0 / recording.interval_s)
    assert recording.losses.good + recording.losses.missing == wanted
    assert len(inside) > 50
    # A slipped byte can take the next frame with it, and one in the line end can do no harm.
    assert 0.6 * len(inside) < recording.losses.missing < 2 * len(inside) + 5
    missing = np.setdiff1d(np.arange(wanted), places)
    told = [np.round(gap.start_s / recording.interval_s) + np.arange(gap.missing) for gap in recording.gaps]
    assert np.array_equal(np.concatenate(told), missing)
    assert all(gap.cause == "frames lost" for gap in recording.gaps)
    assert 0 < recording.losses.damaged < recording.losses.missing + 20
    assert sum(recording.losses.reasons.values()) == recording.losses.damaged
    assert link.losses.good == recording.losses.good


@no_pty
def test_silence_longer_than_a_wrap_of_the_counter():
    faults = GyroFaults(GyroFault("silence", number=300, amount=700))
    with bench(BINARY, faults, speed=5.0) as (link, _, _):  # 256 frames are 0.26 s of the host, 700 are 0.7 s
        recording = link.record(8.0)
    gaps = [gap.missing for gap in recording.gaps]
    assert gaps == [700]
    assert np.array_equal(true_places(recording), np.round(recording.times / recording.interval_s))


@no_pty
def test_counter_that_is_set_anew_costs_no_time():
    faults = GyroFaults(GyroFault("counter jump", number=150, amount=20_000))
    with bench(TEXT, faults, speed=2.0) as (link, _, _):
        recording = link.record(3.0)
    assert {gap.cause for gap in recording.gaps} <= {"counter jump"}
    error = true_places(recording) - np.round(recording.times / recording.interval_s)
    assert np.abs(error).max() < 20  # the host's clock stands in
    assert len(recording.times) > 270


@no_pty
@pytest.mark.parametrize("entries", [TEXT, BINARY], ids=["text", "binary"])
def test_injection_takes_effect_before_it_is_acknowledged(entries):
    with bench(entries) as (link, _, served):
        assert link.acknowledges
        assert link.inject(3.14159) == 50 / 16
        recording = link.record(0.1)
        assert np.all(np.abs(recording.counts - 3.125e6) < 1e5)
        assert link.inject(-2.0) == -2.0
        assert np.all(np.abs(link.record(0.1).counts + 2e6) < 1e5)
        # one that is answered late is sent again
        assert [one for one, _ in groupby(served.commands)] == [("inject", 3.125), ("inject", -2.0)]
        name = "open_loop" if entries is TEXT else "hold_feedback"
        getattr(link, name)()
        assert served.commands[-1] == (name, 0.0)


@no_pty
@pytest.mark.parametrize("kind", ["lost command", "lost answer"])
def test_command_is_repeated_until_it_is_acknowledged(kind):
    with bench(BINARY, GyroFaults(GyroFault(kind, number=0))) as (link, model, _):
        assert link.inject(1.0) == 1.0
        assert model.step == 1.0
        link.inject(2.0)
        assert link.record(0.05).counts[0] == pytest.approx(2e6, abs=1e5)


@no_pty
def test_refusal_and_no_answer_are_said():
    faults = GyroFaults()
    with bench(TEXT, faults) as (link, model, _):
        model.refuses = True
        with pytest.raises(CommandRefused, match=r"refused inject \(16\)"):
            link.inject(1.0)
        model.refuses = False
        faults.add(GyroFault("lost command", probability=0.999999))
        with pytest.raises(NoAcknowledgement, match="did not acknowledge inject in 3 attempts"):
            link.inject(1.0)
        assert model.step == 0.0
        faults.clear()
        link.inject(1.0)


@no_pty
def test_steps_and_commands_that_the_gyro_has_not():
    limited = TEXT | {"commands": TEXT["commands"] | {"largest_step": 100}}
    with bench(limited) as (link, _, served):
        for step in (100.1, -1e9, float("nan"), float("inf")):
            with pytest.raises(SettingError, match="cannot be injected, the gyro takes -100 to 100"):
                link.inject(step)
        with pytest.raises(SettingError, match="no command close_loop"):
            link.close_loop()
        with pytest.raises(SettingError, match="shorter than one output"):
            link.record(0.001)
        assert served.commands == []


@no_pty
def test_old_output_is_not_recorded():
    with bench(TEXT) as (link, model, _):
        link.record(0.1)
        time.sleep(0.6)  # at 100 Hz 60 frames wait in the terminal
        made = model.made
        assert link.record(0.1).counts[0] / 10 >= made - 3


@no_pty
def test_silent_gyro():
    master, slave = os.openpty()
    try:
        with FibreGyroLink(os.ttyname(slave), parse_frame_format(TEXT), longest_silence_s=0.2) as link:
            began = time.monotonic()
            with pytest.raises(LinkError, match=r"sent nothing for 0.2.* is the gyro on"):
                link.record(1.0)
            assert time.monotonic() - began < 5.0
            os.write(master, b"\x80\x00" * 500)
            with pytest.raises(LinkError, match=r"sent nothing"):  # that was before the recording
                link.record(1.0)
    finally:
        os.close(master)
        os.close(slave)


@no_pty
def test_rubbish_is_told_from_silence():
    master, slave = os.openpty()
    stop = threading.Event()

    def babble():
        while not stop.wait(0.01):
            os.write(master, b"\x80\x00\xfe")

    thread = threading.Thread(target=babble)
    thread.start()
    try:
        with (
            FibreGyroLink(os.ttyname(slave), parse_frame_format(BINARY), longest_silence_s=0.3) as link,
            pytest.raises(LinkError, match=r"bytes for .* not one good frame; compare baud rate \(115200\)"),
        ):
            link.record(1.0)
    finally:
        stop.set()
        thread.join()
        os.close(master)
        os.close(slave)


def test_gyro_that_stops_or_hangs_up():
    layout = parse_frame_format(BINARY)
    server = TcpGyroServer(Line(), layout, speed=10.0)
    with FibreGyroLink(server.port, layout, speed=10.0, longest_silence_s=0.2) as link:
        link.record(0.5)
        threading.Timer(0.1, server.close).start()
        with pytest.raises(LinkError, match="link is lost"):
            link.record(100.0)
    faults = GyroFaults(GyroFault("silence", number=100, amount=100_000))
    with (
        bench(BINARY, faults, server=TcpGyroServer, speed=10.0, longest_silence_s=0.2) as (link, _, _),
        pytest.raises(LinkError, match="stopped sending good frames"),
    ):
        link.record(100.0)


def test_port_that_is_not_there():
    with pytest.raises(LinkError, match="cannot open /dev/no-such-port"):
        FibreGyroLink("/dev/no-such-port", parse_frame_format(TEXT))
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(LinkError, match=r"cannot open socket://127\.0\.0\.1"):
        FibreGyroLink(f"socket://127.0.0.1:{port}", parse_frame_format(TEXT))


@pytest.mark.slow
def test_as_fast_as_it_is_read():
    with bench(BINARY, server=TcpGyroServer, speed=float("inf")) as (link, _, _):
        recording = link.record(60.0)
        assert link.inject(5.0) == 5.0
        after = link.record(1.0)
    assert len(recording.counts) == 12_000 and recording.complete
    assert after.counts[0] > 5e6


def test_over_loop_with_frames_by_hand():
    """No simulated gyro in between: bytes packed here come back through pySerial's loop."""
    layout = parse_frame_format(
        {
            "kind": "binary",
            "output_rate_hz": 100.0,
            "header": "EB 90",
            "byte_order": "big",
            "fields": [{"name": "counts", "bytes": 3}],
            "checksum": {"kind": "sum8-negated", "covers": "all"},
        }
    )
    with FibreGyroLink("loop://", layout) as link:

        def send():
            time.sleep(0.1)
            for n in range(12):
                body = b"\xeb\x90" + struct.pack(">i", -70_000 + n)[1:]
                link._port.write(body + bytes([-sum(body) % 256]))

        thread = threading.Thread(target=send)
        thread.start()
        recording = link.record(0.1)
        thread.join()
    assert recording.counts.tolist() == list(range(-70_000, -69_990))
    assert recording.clock == "frames"
    assert recording.temperature is None


@no_pty
def test_late_answer_is_not_taken_for_that_of_the_next_command():
    master, slave = os.openpty()
    tty.setraw(slave)

    def slow_gyro():
        os.read(master, 100)
        time.sleep(0.8)  # the link has asked again by then
        os.write(master, b"$ACK*49\r\n")
        os.read(master, 100)
        time.sleep(0.2)
        os.write(master, b"$ACK*49\r\n")

    thread = threading.Thread(target=slow_gyro)
    thread.start()
    try:
        with FibreGyroLink(os.ttyname(slave), parse_frame_format(TEXT)) as link:
            link.inject(1.0)
            with pytest.raises(NoAcknowledgement):  # this one is never answered
                link.inject(2.0)
    finally:
        thread.join()
        os.close(master)
        os.close(slave)
