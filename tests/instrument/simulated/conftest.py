"""A small client that talks to the simulated instrument as GPIB would: whole messages, virtual time."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest

from instrument.simulated import Faults, SimulatedTDS2014, VirtualClock
from instrument.simulated.links.exchange import MessageExchange


def sine(times: np.ndarray) -> np.ndarray:
    """1 kHz, 2 V amplitude."""
    return 2.0 * np.sin(2 * np.pi * 1000.0 * times)


class Bench:
    """A scope on a virtual clock with one message link."""

    def __init__(self, signals: Mapping[int, Callable] | None = None, **options) -> None:
        self.clock = VirtualClock()
        self.scope = SimulatedTDS2014(signals or {}, clock=self.clock, **options)
        self.link = MessageExchange(self.scope, message_ends=True)

    def write(self, message: str | bytes) -> None:
        self.link.receive(message.encode("latin-1") if isinstance(message, str) else message)
        self.link.pump()

    def read(self, timeout: float = 5.0) -> bytes | None:
        return self.link.wait_for_answer(timeout)

    def ask_raw(self, message: str | bytes, timeout: float = 5.0) -> bytes | None:
        self.write(message)
        return self.read(timeout)

    def ask(self, message: str, timeout: float = 5.0) -> str | None:
        answer = self.ask_raw(message, timeout)
        if answer is None:
            return None
        assert answer.endswith(b"\n")
        return answer[:-1].decode("latin-1")

    def events(self) -> list[int]:
        """Codes of all events since the last call."""
        self.ask("*ESR?")
        codes = []
        while code := int(self.ask("EVENT?").split()[-1]):
            codes.append(code)
        return codes

    def single(self) -> None:
        """Take one record and wait for it."""
        self.write("ACQUIRE:STOPAFTER SEQUENCE;STATE RUN")
        assert self.ask("*OPC?", timeout=1000.0) == "1"

    def codes(self) -> np.ndarray:
        """One-byte codes of the present DATa:SOUrce."""
        answer = self.ask_raw("HEADER OFF;:DATA:ENCDG RIBINARY;WIDTH 1;:CURVE?", timeout=1000.0)
        assert answer.startswith(b"#42500") and answer.endswith(b"\n")
        return np.frombuffer(answer[6:-1], dtype=np.int8)


@pytest.fixture
def bench() -> Bench:
    """A TDS2014 with a sine on channel 1, 1:1 probe, 1 V/div, no noise."""
    made = Bench({1: sine}, noise_levels=0.0)
    made.write("CH1:PROBE 1;SCALE 1")
    assert made.events() == [401]
    return made


@pytest.fixture
def fresh() -> Bench:
    """A TDS2014 as the factory leaves it, with a sine on channel 1."""
    return Bench({1: sine}, noise_levels=0.0)


@pytest.fixture
def make_bench() -> type[Bench]:
    """Make a bench with other signals or options."""
    return Bench


@pytest.fixture
def faulty_bench() -> Bench:
    """A bench with an object for faults."""
    return Bench({1: sine}, noise_levels=0.0, faults=Faults(seed=1))
