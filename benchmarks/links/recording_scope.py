"""A simulated scope that remembers every record it has shown, so that a saved one can be told right or wrong."""

from __future__ import annotations

import hashlib

from instrument.simulated import SimulatedTDS2014
from instrument.simulated.front_end.traces import Trace


class RecordingScope(SimulatedTDS2014):
    """Knows the acquisition that codes are of.

    Use :meth:`watch` for a scope that is made elsewhere.
    """

    @classmethod
    def watch(cls, scope: SimulatedTDS2014) -> RecordingScope:
        """Let a scope remember from now on."""
        scope.__class__ = cls
        assert isinstance(scope, cls)
        scope.hands = 0
        scope.forget()
        return scope

    def turn_knob(self, command: str) -> None:
        """What somebody at the front panel does; counted while it is not locked."""
        self.hands += self.panel.text("LOCK") == "NONE"
        super().turn_knob(command)

    def trace(self, name: str) -> Trace | None:
        """What stands on the screen, as of any simulated scope."""
        shown = super().trace(name)
        if shown is not None and self.acquisition.record is not None:
            number = self.acquisition.record.number
            self._shown[_key(shown.codes.tobytes())] = number, shown.ymult, shown.xincr
        return shown

    def acquisition_of(self, codes: bytes, ymult: float, xincr: float) -> int | None:
        """Number of the acquisition that showed these codes with these scales; None if there is none."""
        number, *scales = self._shown.get(_key(codes), (None, 0.0, 0.0))
        right = all(abs(got / held - 1) < 1e-8 for got, held in zip((ymult, xincr), scales, strict=True) if held)
        return number if right else None

    def forget(self) -> None:
        """Drop what was shown so far."""
        self._shown: dict[bytes, tuple[int, float, float]] = {}


def _key(codes: bytes) -> bytes:
    return hashlib.blake2b(codes, digest_size=12).digest()
