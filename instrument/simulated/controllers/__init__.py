"""Simulated controllers beside the scope: rate table, temperature chamber, power supply, on lines of text."""

from instrument.simulated.controllers.chamber import SimulatedChamber
from instrument.simulated.controllers.line_server import LineDevice, LineServer
from instrument.simulated.controllers.power_supply import SimulatedPowerSupply
from instrument.simulated.controllers.rate_table import RateTableController

__all__ = ["LineDevice", "LineServer", "RateTableController", "SimulatedChamber", "SimulatedPowerSupply"]
