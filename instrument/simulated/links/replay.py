"""Serves what an instrument once answered: each message of a transcript gets the bytes that came then."""

import time
from collections import defaultdict, deque
from collections.abc import Sequence

from instrument.simulated.links.stream_server import LOOK_UP, Port, StreamServer
from instrument.text_files import TranscriptExchange


class ReplayServer(StreamServer):
    """Answers on a TCP port as the transcript says."""

    # A message is looked for among those that have not been asked yet, in their order; asked more often than it
    # was then, it gets the last answer again. A message that the transcript does not have gets none.

    def __init__(self, exchanges: Sequence[TranscriptExchange], host: str = "127.0.0.1", port: int = 0) -> None:
        super().__init__()
        self._answers: dict[bytes, deque[bytes]] = defaultdict(deque)
        for exchange in exchanges:
            self._answers[_plain(exchange.message)].append(exchange.answer)
        self.unknown: list[bytes] = []
        self._begun: dict[Port, bytearray] = {}
        self.host, self.port = self._listen(host, port)
        self._thread.start()

    @property
    def resource_name(self) -> str:
        """VISA resource name for clients on this computer."""
        return f"TCPIP0::{self.host}::{self.port}::SOCKET"

    def _add(self, port: Port) -> None:
        self._begun[port] = bytearray()
        super()._add(port)

    def _drop(self, port: Port) -> None:
        self._begun.pop(port, None)
        super()._drop(port)

    def _pause(self) -> float:
        return LOOK_UP

    def _serve(self, port: Port) -> None:
        now, begun = time.monotonic(), self._begun[port]
        begun += port.incoming.take(now)
        while b"\n" in begun:
            message, _, rest = bytes(begun).partition(b"\n")
            begun[:] = rest
            port.outgoing.put(self._answer(_plain(message)), now)
        self._send(port, now)

    def _answer(self, message: bytes) -> bytes:
        known = self._answers.get(message)
        if not known:
            if message:
                self.unknown.append(message)
            return b""
        return known.popleft() if len(known) > 1 else known[0]


def _plain(message: bytes) -> bytes:
    """A message without the ends that differ from link to link."""
    return message.strip(b"\r\n \t")
