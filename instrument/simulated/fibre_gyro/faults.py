"""What can happen to the frames and commands of a simulated fibre gyro, on demand."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Literal

import numpy as np

FrameFaultKind = Literal["lost byte", "inserted byte", "flipped bit", "lost frame", "counter jump", "silence"]
CommandFaultKind = Literal["lost command", "lost answer", "refusal"]

_COMMAND_KINDS = ("lost command", "lost answer", "refusal")


@dataclass(frozen=True)
class GyroFault:
    """One fault and the frames, or commands, that it meets."""

    # "lost byte", "inserted byte", "flipped bit" at a random place of the frame; "lost frame": it is not sent;
    # "counter jump": the counter goes on from somewhere else, nothing is lost; "silence": the gyro measures on but
    # nothing of it is sent. "lost command", "lost answer", "refusal" meet a command instead.
    kind: FrameFaultKind | CommandFaultKind
    # number of the frame, or command, counted from 0 since the server began. None: any.
    number: int | None = None
    # chance that one that fits is hit. A fault with a number, or with probability 1, happens once.
    probability: float = 1.0
    # bytes, bits or frames that are lost, inserted or flipped; ticks that the counter jumps; frames of silence
    amount: int = 1


class GyroFaults:
    """The faults of one simulated gyro; `add` them at any time, also while it is served."""

    def __init__(self, *faults: GyroFault, seed: int = 0) -> None:
        self._armed = list(faults)
        self._rng = np.random.default_rng(seed)
        self._lock = threading.Lock()
        self.happened: list[tuple[int, GyroFault]] = []

    def add(self, fault: GyroFault) -> GyroFaults:
        """Arm one more fault; returns itself."""
        with self._lock:
            self._armed.append(fault)
        return self

    def clear(self) -> None:
        """Disarm every fault that has not happened yet."""
        with self._lock:
            self._armed.clear()

    def hits_frame(self, number: int) -> list[GyroFault]:
        """What happens to a frame."""
        return self._hits(number, commands=False)

    def hits_command(self, number: int) -> list[GyroFault]:
        """What happens to a command."""
        return self._hits(number, commands=True)

    def spoil(self, data: bytes, fault: GyroFault) -> bytes:
        """A frame with bytes lost or inserted or bits flipped."""
        damaged = bytearray(data)
        for _ in range(min(fault.amount, len(data))):
            at = int(self._rng.integers(len(damaged)))
            if fault.kind == "lost byte":
                del damaged[at]
            elif fault.kind == "inserted byte":
                damaged.insert(at, int(self._rng.integers(256)))
            elif fault.kind == "flipped bit":
                damaged[at] ^= 1 << int(self._rng.integers(8))
        return bytes(damaged)

    def _hits(self, number: int, *, commands: bool) -> list[GyroFault]:
        with self._lock:
            met = [
                fault
                for fault in self._armed
                if (fault.kind in _COMMAND_KINDS) == commands
                and fault.number in (None, number)
                and (fault.probability >= 1 or self._rng.random() < fault.probability)
            ]
            for fault in met:
                self.happened.append((number, fault))
                if fault.number is not None or fault.probability >= 1:
                    self._armed.remove(fault)
            return met
