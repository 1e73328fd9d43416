"""Simulated hardware: an oscilloscope that a driver cannot tell from a real one, and a rate table.

A program message runs through these files: `visa_library`, `tcp_server` or `pty_server` (links), `serial_input`
(what RS-232 loses), `exchange` (message queues), `parsing` and `command_tree` (which command), `commands` and the
`*_commands` files (what it does), `panel` and `panel_rules` (settings), `status` and `events` (what went wrong).
A signal runs through `frontend`, `trigger` and `video_trigger`, `acquisition` (when), `digitizer` (codes) and
`traces` (what is sent); `screen` and `picture_formats` make the hard copy, `mass_storage` and `waveform_file` the
files of the models that have a memory card.
"""

from instrument.simulated.clock import Clock, RealClock, VirtualClock
from instrument.simulated.faults import Fault, Faults
from instrument.simulated.front_end.frontend import Signal
from instrument.simulated.links.pty_server import PtyServer
from instrument.simulated.links.tcp_server import TcpServer
from instrument.simulated.links.visa_library import resource_manager
from instrument.simulated.rate_table import SimulatedRateTable
from instrument.simulated.scope import SimulatedTDS2014

__all__ = [
    "Clock",
    "Fault",
    "Faults",
    "PtyServer",
    "RealClock",
    "Signal",
    "SimulatedRateTable",
    "SimulatedTDS2014",
    "TcpServer",
    "VirtualClock",
    "resource_manager",
]
