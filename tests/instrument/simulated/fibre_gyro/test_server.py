"""The simulated gyro on its own: the bytes that it sends, and the commands that it understands."""

import binascii
import os
import socket
import struct
import sys
import threading
import time

import numpy as np
import pytest
import serial

from benchmarks.fibre_gyro.frames import layout_of
from benchmarks.fibre_gyro.real_gyros import REAL_GYROS, raw_outputs, temperature_of
from instrument.fibre_gyro import parse_frame_format
from instrument.simulated.fibre_gyro import (
    CommandReader,
    GyroFault,
    GyroFaults,
    PtyGyroServer,
    TcpGyroServer,
    encode_frame,
)

BINARY = parse_frame_format(
    {
        "kind": "binary",
        "output_rate_hz": 50.0,
        "header": "7E",
        "byte_order": "big",
        "ending": "0D",
        "fields": [
            {"name": "counter", "bytes": 2, "per_frame": 20},
            {"name": "counts", "bytes": 3},
            {"name": "temperature", "bytes": 2, "scale": 0.5, "offset": -40},
            {"name": "status", "bytes": 1, "good_mask": 255, "good_value": 3},
        ],
        "checksum": {"kind": "crc16-xmodem", "covers": "after header"},
        "commands": {"inject": "A5 {step:2} {checksum}", "close_loop": "A6 {checksum}", "step_scale": 4},
        "answers": {"accepted": "06", "refused": "15"},
    }
)


def by_hand(counter: int, counts: int, half_degrees: int) -> bytes:
    body = struct.pack(">H", counter) + struct.pack(">i", counts)[1:] + struct.pack(">hB", half_degrees, 3)
    return b"\x7e" + body + struct.pack(">H", binascii.crc_hqx(body, 0)) + b"\x0d"


class Steady:
    def __init__(self, counts=-1234.0):
        self.counts, self.made, self.told = counts, 0, []

    def samples(self, count):
        self.made += count
        return {"counts": np.full(count, self.counts), "temperature": np.full(count, 25.0)}

    def command(self, name, step):
        if step < 0:
            raise ValueError("never")
        self.told.append((name, step))


def until_made(model: Steady, count: int) -> None:
    deadline = time.monotonic() + 60
    while model.made < count:
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize("gyro", REAL_GYROS, ids=lambda gyro: gyro.name)
def test_frames_of_real_gyros_are_those_packed_by_hand(gyro):
    layout = layout_of(gyro)
    for n, raw in enumerate(raw_outputs(gyro, 12, np.random.default_rng(3)), start=240):
        _, values = gyro.values(n, raw)
        named = dict(zip(layout.names, values, strict=True))
        sixteenths = temperature_of(n - n % 4)
        named |= {"magnetic_x": 0.21, "magnetic_y": -0.05, "magnetic_z": 0.44, "source_ma": 93}
        if layout.turning is not None:
            named |= {"temperature": sixteenths / 16, "status": named.get("status", 1)}
        made, packed = encode_frame(layout, n, named), gyro.pack(n, raw)
        if gyro.name == "ascii_lines":  # a word and leading zeros that only the real gyro sends
            assert made.split(b",")[1:2] == [b"%d" % n] and made.endswith(b"\r\n")
        elif gyro.name == "three_axes":  # two temperatures that nobody reads
            assert made[:34] == packed[:34] and len(made) == len(packed)
        else:
            assert made == packed


def test_frame_is_what_the_format_says():
    assert encode_frame(BINARY, 65_536 + 40, {"counts": -1234, "temperature": 25.0}) == by_hand(40, -1234, 130)
    with pytest.raises(ValueError, match="does not fit into the 3 bytes of counts"):
        encode_frame(BINARY, 0, {"counts": 2**23})


@pytest.mark.skipif(sys.platform == "win32", reason="this system has no pseudo-terminals")
def test_bytes_on_the_terminal_come_at_the_output_rate():
    with PtyGyroServer(Steady(), BINARY) as server, serial.Serial(server.port, timeout=30.0) as port:
        began, data, took = time.monotonic(), b"", list[float]()
        for _ in range(8):
            data += port.read(12 * 25)
            took.append(time.monotonic() - began)
    start = struct.unpack(">H", data[1:3])[0] // 20
    assert data == b"".join(by_hand(20 * (start + n), -1234, 130) for n in range(200))
    # 25 frames at 50 Hz; a busy machine may keep us waiting for some of them, not for all
    pace = np.array(took) / np.arange(1, 9)
    assert pace.min() > 0.4 and (pace < 0.8).any()


def test_commands_are_carried_out_and_answered():
    model = Steady()
    with TcpGyroServer(model, BINARY, speed=0.01) as server:  # a frame in two seconds: the line is quiet
        host, port = server.port.removeprefix("socket://").split(":")
        with socket.create_connection((host, int(port)), timeout=2.0) as client:
            for number, answer in ((10, b"\x06"), (-3, b"\x15")):
                body = b"\xa5" + struct.pack(">h", number)
                message = body + struct.pack(">H", binascii.crc_hqx(body, 0))
                client.sendall(message[:2])
                client.sendall(message[2:])
                reply = client.recv(1)
                while reply[0] not in (0x06, 0x15):
                    reply = client.recv(1)
                assert reply == answer
            client.sendall(b"\xa5\x00\x04\x00\x00")  # wrong checksum: as if nothing had come
            body = b"\xa6"
            client.sendall(b"\xa5" + body + struct.pack(">H", binascii.crc_hqx(body, 0)))
            client.settimeout(30.0)
            while client.recv(1) != b"\x06":
                pass
    assert model.told == [("inject", 2.5), ("close_loop", 0.0)]
    assert server.commands == model.told


def test_command_reader_on_random_bytes():
    rng = np.random.default_rng(2)
    reader = CommandReader(BINARY)
    body = b"\xa5" + struct.pack(">h", 7)
    message = body + struct.pack(">H", binascii.crc_hqx(body, 0))
    found = []
    for _ in range(200):
        found += reader.feed(rng.bytes(int(rng.integers(50))) + message)
    assert len([one for one in found if one == ("inject", 7)]) == 200
    assert len(found) < 210


def test_faults_do_what_they_say():
    faults = GyroFaults(seed=1)
    frame = by_hand(1, 2, 3)
    assert len(faults.spoil(frame, GyroFault("lost byte", amount=2))) == 10
    assert len(faults.spoil(frame, GyroFault("inserted byte"))) == 13
    flipped = faults.spoil(frame, GyroFault("flipped bit"))
    assert sum((a ^ b).bit_count() for a, b in zip(frame, flipped, strict=True)) == 1
    once = GyroFault("lost frame")
    faults.add(once)
    assert faults.hits_frame(5) == [once]
    assert faults.hits_frame(6) == []
    faults.add(GyroFault("refusal", number=1))
    assert faults.hits_command(0) == [] and faults.hits_frame(1) == []
    assert len(faults.hits_command(1)) == 1
    assert [number for number, _ in faults.happened] == [5, 1]


def test_model_that_fails_is_not_a_silent_gyro():
    asked = threading.Event()

    class Broken(Steady):
        def samples(self, count):
            asked.set()
            raise ZeroDivisionError("model")

    server = TcpGyroServer(Broken(), BINARY)
    assert asked.wait(30.0)
    with pytest.raises(ZeroDivisionError):
        server.close()
    server.close()


def test_clients_come_and_go():
    model = Steady()
    with TcpGyroServer(model, BINARY, speed=100.0) as server:
        host, port = server.port.removeprefix("socket://").split(":")
        for _ in range(3):
            with socket.create_connection((host, int(port)), timeout=2.0) as client:
                assert b"\x7e" in client.recv(4096)
        until_made(model, model.made + 1)  # a gyro measures on whether anybody listens or not


@pytest.mark.skipif(sys.platform == "win32", reason="this system has no pseudo-terminals")
def test_nobody_listens_for_long():
    model = Steady()
    with PtyGyroServer(model, BINARY, speed=200.0) as server:
        until_made(model, 4000)
        assert server.unsent < 10_000
        descriptor = os.open(server.port, os.O_RDWR | os.O_NOCTTY)
        assert os.read(descriptor, 12)[0] == 0x7E
        os.close(descriptor)
    with pytest.raises(ValueError, match="must be positive"):
        PtyGyroServer(model, BINARY, speed=0.0)
