"""Simulated hardware: an oscilloscope that a driver cannot tell from a real one, and a rate table.

A program message runs through `links` (`visa_library` in this process; `scope_server` on a socket or a
terminal; `hislip` on a network that knows messages; `serial_input`: what RS-232 loses; `exchange`: message
queues), `scope` (reads it and finds each command, with `panel.parsing` and `commands.command_tree`) and
`commands` (what each does to the `state`). The state has the `panel` (settings, their rules, status and
events) and a `front_end`, through which a signal runs: `frontend`, `trigger` and `video_trigger`,
`acquisition` (when), `digitizer` (codes) and `traces` (what is sent). `files` makes hard copies and holds the
files of the models that have a memory card. The gyro of `fibre_gyro` is served by `links.stream_server`, too.
"""

from instrument.simulated.clock import Clock, RealClock, VirtualClock
from instrument.simulated.controllers import SimulatedRateTable
from instrument.simulated.faults import Fault, Faults
from instrument.simulated.front_end.frontend import Signal
from instrument.simulated.links.hislip import HislipServer
from instrument.simulated.links.scope_servers import GpibAdapterServer, PtyServer, TcpServer
from instrument.simulated.links.visa_library import resource_manager
from instrument.simulated.scope import SimulatedTDS2014

__all__ = [
    "Clock",
    "Fault",
    "Faults",
    "GpibAdapterServer",
    "HislipServer",
    "PtyServer",
    "RealClock",
    "Signal",
    "SimulatedRateTable",
    "SimulatedTDS2014",
    "TcpServer",
    "VirtualClock",
    "resource_manager",
]
