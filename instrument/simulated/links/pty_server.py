"""The simulated instrument behind a serial port: a pseudo-terminal that programs open like a real one.

A pseudo-terminal has no modem lines and carries no break, so RTS/CTS flagging always looks ready and the
break that makes a real unit answer `DCL` does not arrive; call `break_signal` in its place. XON and XOFF work on
both sides when RS232:SOFTFlagging is on and the program opens the port with them.
"""

from __future__ import annotations

import os

from instrument.simulated.links.exchange import MessageExchange
from instrument.simulated.links.stream_server import Line, Port, StreamServer
from instrument.simulated.scope import SimulatedTDS2014


class PtyServer(StreamServer):
    """Serves an instrument on a pseudo-terminal until it is closed.

    Parameters
    ----------
    scope : SimulatedTDS2014
        The instrument.
    baud_rate : float, optional
        Bytes take their time on the line, 10 bits each, in both directions. Without it they are there at once.

    Raises
    ------
    OSError
        If this system has no pseudo-terminals (Windows).
    """

    def __init__(self, scope: SimulatedTDS2014, baud_rate: float | None = None) -> None:
        try:
            import tty
        except ImportError:
            raise OSError("this system has no pseudo-terminals; serve the instrument on TCP instead") from None
        master, self._slave = os.openpty()  # the slave end stays open, so that clients may come and go
        self.device = os.ttyname(self._slave)
        tty.setraw(self._slave)  # no echo, no line editing, no characters with a meaning of their own
        os.set_blocking(master, False)
        super().__init__(scope)
        self._add(
            Port(
                descriptor=master,
                exchange=MessageExchange(scope, message_ends=False, serial=True),
                receive=lambda count: os.read(master, count),
                send=lambda data: os.write(master, data),
                close=lambda: os.close(master),
                incoming=Line(baud_rate),
                outgoing=Line(baud_rate),
            )
        )
        self._thread.start()

    @property
    def resource_name(self) -> str:
        """VISA resource name."""
        return f"ASRL{self.device}::INSTR"

    def _released(self) -> None:
        os.close(self._slave)
