"""Rate table, temperature chamber and power supply, each described by a template of its commands."""

from instrument.templates.controller import Controller
from instrument.templates.description import ControllerTemplate, parse_template
from instrument.templates.guard import Guard
from instrument.templates.rate_table import ControlledRateTable

__all__ = ["ControlledRateTable", "Controller", "ControllerTemplate", "Guard", "parse_template"]
