"""Simulated controllers behind a link: rate table, temperature chamber and power supply."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from instrument.simulated import Clock
from instrument.simulated.controllers import (
    LineDevice,
    LineServer,
    RateTableController,
    SimulatedChamber,
    SimulatedPowerSupply,
)
from instrument.simulated.rate_table import SimulatedRateTable
from station.errors import UsageError


@contextmanager
def serve_controllers(table: SimulatedRateTable, clock: Clock, *, terminals: bool) -> Iterator[dict[str, str]]:
    """Serve the controllers of a simulated bench, each on a link of its own.

    Parameters
    ----------
    table : SimulatedRateTable
        That under the gyro.
    terminals : bool
        Whether on serial terminals; otherwise on free TCP ports.

    Yields
    ------
    dict
        VISA names by the names that they have in the settings.

    Raises
    ------
    UsageError
        The system has no such link.
    """
    devices: dict[str, LineDevice] = {
        "rate_table": RateTableController(table),
        "chamber": SimulatedChamber(clock),
        "power_supply": SimulatedPowerSupply(),
    }
    with ExitStack() as stack:
        try:
            servers = {
                name: stack.enter_context(LineServer(device, tcp_port=None if terminals else 0))
                for name, device in devices.items()
            }
        except OSError as problem:
            raise UsageError(f"the simulated controllers cannot be served: {problem}") from None
        yield {name: server.resource_name for name, server in servers.items()}
