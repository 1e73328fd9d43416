"""Live: gyros with a clock of their own, several axes in a frame, outputs that are no counts, polls."""

import math
import sys
import threading
import time
import tomllib

import numpy as np
import pytest

from benchmarks.fibre_gyro.real_gyros import kvh_1750
from instrument import LinkError, SettingError
from instrument.fibre_gyro import FibreGyroLink, FrameFormatError, parse_frame_format
from instrument.simulated.fibre_gyro import GyroFault, GyroFaults, PtyGyroServer, TcpGyroServer
from station.settings import shipped_settings

no_pty = pytest.mark.skipif(sys.platform == "win32", reason="this system has no pseudo-terminals")
COUNTED = {
    "kind": "binary",
    "output_rate_hz": 400.0,
    "header": "EB 90",
    "fields": [{"name": "counter", "bytes": 2}, {"name": "counts", "bytes": 4}],
    "checksum": {"kind": "crc16-modbus"},
}


def shipped(file, name, **changes):
    table = tomllib.loads(shipped_settings(file).read_text(encoding="utf-8"))["formats"][name]
    return parse_frame_format({**table, **changes}, name)


class Line:
    """Outputs that tell which they are: 3, 2 and 1 times the number of the frame for X, Y and Z."""

    def __init__(self) -> None:
        self.made = 0

    def samples(self, count):
        n = np.arange(self.made, self.made + count)
        self.made += count
        return {
            "counts": 1.0 * n,
            "counts_x": 3.0 * n,
            "counts_y": 2.0 * n,
            "counts_z": 1.0 * n,
            "temperature": 20 + 0 * n,
        }

    def command(self, name, step):
        raise ValueError(name)


def test_a_clock_that_is_off_by_five_per_cent_is_measured_and_used():
    layout = parse_frame_format(COUNTED)
    with (
        TcpGyroServer(Line(), layout, speed=4.0, clock_ppm=50_000.0) as served,
        FibreGyroLink(served.port, layout, speed=4.0) as link,
    ):
        recording = link.record(8.0)
    clock = recording.host_clock
    assert clock.used and abs(clock.difference_ppm - 50_000) < 4 * clock.u_ppm
    assert recording.interval_s == clock.interval_s
    assert recording.duration_s == pytest.approx(8.0, rel=4e-6 * clock.u_ppm)  # of true time, not of the gyro's
    places = np.round(recording.times / clock.interval_s)
    assert np.allclose(recording.times, places * clock.interval_s)
    assert np.array_equal(recording.counts - recording.counts[0], places - places[0])
    assert places[-1] > 3300  # it goes on where the gyro's own 8 s, 3200 frames, were over


def test_a_clock_that_is_right_changes_nothing():
    layout = parse_frame_format(COUNTED)
    with TcpGyroServer(Line(), layout) as served, FibreGyroLink(served.port, layout) as link:
        recording = link.record(1.5)
    assert not recording.host_clock.used and recording.interval_s == 1 / 400
    with (
        TcpGyroServer(Line(), layout, speed=math.inf) as served,
        FibreGyroLink(served.port, layout, speed=math.inf) as link,
    ):
        assert link.record(1.5).host_clock is None  # frames that come as fast as they are read tell no time


def test_a_rate_that_no_clock_can_be_off_by_is_refused():
    layout = parse_frame_format(COUNTED)
    wrong = parse_frame_format(COUNTED | {"output_rate_hz": 200.0})
    with (
        TcpGyroServer(Line(), layout) as served,
        FibreGyroLink(served.port, wrong) as link,
        pytest.raises(
            FrameFormatError, match=r"sends \d+(\.\d+)? frames a second .* output_rate_hz .* is 200; correct it"
        ),
    ):
        link.record(2.0)


def test_three_axes_in_one_frame():
    layout = shipped("frames/three_axes", "three_axes")
    with (
        TcpGyroServer(Line(), layout, speed=math.inf) as served,
        FibreGyroLink(served.port, layout, speed=math.inf) as link,
    ):
        y = link.record(1.0, axis="Y")
        first = link.record(0.1)
        with pytest.raises(SettingError, match="hold the outputs counts_x, counts_y, counts_z, none of axis W"):
            link.record(0.1, axis="W")
    assert np.array_equal(y.counts, y.extra["counts_y"])
    assert np.array_equal(y.extra["counts_x"], 1.5 * y.counts)
    assert np.array_equal(y.extra["counts_z"], 0.5 * y.counts)
    assert np.array_equal(first.counts, first.extra["counts_x"])
    assert set(y.temperature) == {20.0} and "accel_z" in y.extra and y.clock == "counter"


def test_angles_of_real_bytes_become_counts_by_the_clock():
    """Frames packed by hand come back through pySerial's loop: radians a frame, by the rate of the frames."""
    layout = shipped("frames/kvh_1750", "kvh_1750")
    raw = [(n + 1, 10 * n, -n) for n in range(40)]  # 1e-10 rad
    with FibreGyroLink("loop://", layout, speed=math.inf) as link:
        with pytest.raises(SettingError, match="the output is in rad: say how many counts 1 deg/s is"):
            link.record(0.03)

        def send():
            time.sleep(0.1)
            link._port.write(b"".join(kvh_1750(n, one) for n, one in enumerate(raw)))

        thread = threading.Thread(target=send)
        thread.start()
        recording = link.record(0.03, axis="Z", counts_per_dps=250.0)
        thread.join()
    expected = [-n * 1e-10 * 180 / math.pi * 1000.0 * 250.0 for n in range(30)]
    assert recording.counts == pytest.approx(expected, rel=1e-6)
    assert recording.status.tolist() == [0x77] * 30


@no_pty
@pytest.mark.parametrize("name", ["polled_binary", "polled_text"])
def test_a_gyro_that_answers_polls(name):
    command = "A5 5A {start} 10 {checksum}" if name == "polled_binary" else "$RATE?\r\n"
    poll = {"command": command, "answer_time_s": 0.04}
    layout = shipped("frames/polled", name, output_rate_hz=40.0, poll=poll)
    faults = GyroFaults(GyroFault("lost frame", number=7), GyroFault("flipped bit", number=11))
    model = Line()
    with PtyGyroServer(model, layout, faults=faults) as served, FibreGyroLink(served.port, layout) as link:
        began = time.monotonic()
        seconds = 30 / layout.output_rate_hz
        recording = link.record(seconds, counts_per_dps=3600.0)
        took = time.monotonic() - began
    assert model.made <= 31  # it speaks only when it is asked
    assert recording.clock == "polls" and recording.host_clock is None
    places = np.round(recording.times / recording.interval_s).astype(int)
    assert len(places) >= 6  # a computer that is busy asks less often
    missing = sorted(set(range(30)) - set(places.tolist()))
    assert sum(gap.missing for gap in recording.gaps) == len(missing) >= 2
    assert np.all(np.diff(recording.counts) > 0)
    assert took > 0.9 * seconds


@no_pty
def test_a_gyro_that_is_asked_and_does_not_answer():
    layout = shipped("frames/polled", "polled_binary")
    faults = GyroFaults(GyroFault("silence", number=0, amount=10_000))
    with (
        PtyGyroServer(Line(), layout, faults=faults) as served,
        FibreGyroLink(served.port, layout, longest_silence_s=0.3) as link,
        pytest.raises(LinkError, match="sent nothing for"),
    ):
        link.record(1.0)


def test_doubts_stand_in_the_recording():
    """The gyro sends seven bits a byte; the description says eight."""
    right = {"kind": "binary", "output_rate_hz": 400.0, "header": "80", "checksum": {"kind": "xor8"}}
    sent = parse_frame_format({**right, "fields": [{"name": "counts", "bytes": 4, "data_bits": 7}]})
    read = parse_frame_format({**right, "fields": [{"name": "counts", "bytes": 4}]})
    with (
        TcpGyroServer(Line(), sent, speed=math.inf) as served,
        FibreGyroLink(served.port, read, speed=math.inf) as link,
    ):
        recording = link.record(2.0)
    assert len(recording.doubts) == 1 and "data_bits = 7" in recording.doubts[0]
