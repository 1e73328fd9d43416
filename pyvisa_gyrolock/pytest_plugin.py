"""A simulated oscilloscope as a pytest fixture, for programs that talk to a TDS1000, TDS2000 or TPS2000.

It comes with the distribution: a test asks for ``tds2014`` and gets a scope on a link. The marker ``tds2014`` says
which model, signal and link; the module imports nothing heavy until a test asks for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    import pyvisa

    from instrument.simulated import Faults, SimulatedTDS2014

LINKS = ("tcp", "hislip", "pty", "visa")
_LOOK, _PATIENCE = 1e-3, 2.0  # s


class ServedScope:
    """A simulated scope on a link."""

    def __init__(self, scope: SimulatedTDS2014, link: str, stack: ExitStack) -> None:
        from instrument.simulated import HislipServer, PtyServer, TcpServer, resource_manager

        self.scope, self.link = scope, link
        self._stack = stack
        self._manager: pyvisa.ResourceManager | None = None
        if link == "visa":
            self.resource_name = "GPIB0::1::INSTR"
            self._manager = resource_manager(scopes={self.resource_name: scope})
            stack.callback(self._manager.close)
            return
        servers = {"tcp": TcpServer, "hislip": HislipServer, "pty": PtyServer}
        if link not in servers:
            raise ValueError(f"there is no link {link!r}; choose one of {', '.join(LINKS)}")
        self.resource_name = stack.enter_context(servers[link](scope)).resource_name

    @property
    def faults(self) -> Faults:
        """What shall go wrong: ``faults.add(Fault("cut answer"))``."""
        return self.scope.faults

    @property
    def resource_manager(self) -> pyvisa.ResourceManager:
        """A PyVISA resource manager that knows the scope by its name: PyVISA-py, or the one in this process."""
        if self._manager is None:
            import pyvisa

            self._manager = pyvisa.ResourceManager("@py")
            self._stack.callback(self._manager.close)
        return self._manager

    def open(self, **attributes: Any) -> Any:
        """The scope as PyVISA opens it, with line feeds as its ends; it is closed with the test."""
        attributes = {"read_termination": "\n", "write_termination": "\n", "timeout": 5000, **attributes}
        opened = self.resource_manager.open_resource(self.resource_name, **attributes)
        self._stack.callback(opened.close)
        return opened

    def send(self, message: str) -> None:
        """Turn its knobs by a program message, before the program comes; back when a record shows them."""
        scope = self.scope
        with scope.lock:
            for step in scope.execute(message.encode("latin-1")):
                if step is None:
                    scope.clock.sleep(_LOOK)
            acquisition, patience = scope.acquisition, _PATIENCE
            while acquisition.running and not acquisition.acquisitions and patience > 0:
                if scope.panel.scanning:
                    break
                scope.clock.sleep(_LOOK)
                acquisition.update()
                patience -= _LOOK


def pytest_configure(config: pytest.Config) -> None:
    """Make the marker known."""
    config.addinivalue_line(
        "markers",
        "tds2014(signals=None, link='tcp', **options): of the fixture tds2014: signals (a function of times in s "
        "that gives volts, or a mapping of channel numbers to such functions), its link (tcp, hislip, pty, visa), "
        "and arguments of SimulatedTDS2014: model, noise_levels, seed, faults, identity",
    )


@pytest.fixture
def tds2014(request: pytest.FixtureRequest) -> Iterator[ServedScope]:
    """A simulated TDS2014 on a link of its own; unless the marker differs, with sines of 1 kHz at CH1 and CH2."""
    from instrument.simulated import SimulatedTDS2014
    from instrument.simulated.links.visa_library import demonstration_signals

    marker = request.node.get_closest_marker("tds2014")
    options = dict(marker.kwargs) if marker is not None else {}
    signals, link = options.pop("signals", None), options.pop("link", "tcp")
    inputs = demonstration_signals() if signals is None else {1: signals} if callable(signals) else signals
    with ExitStack() as stack:
        yield ServedScope(SimulatedTDS2014(inputs, **options), link, stack)
