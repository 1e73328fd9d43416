"""Drivers for the bench: the TDS2014 oscilloscope family, its files, and the rate table.

`TDS2014` gives records as `Waveform`; `read_waveform` reads the files that these scopes write.
"""

import importlib
from typing import TYPE_CHECKING, Any

from instrument.errors import (
    CommandError,
    DeviceError,
    ExecutionError,
    FileFormatError,
    InstrumentError,
    LinkError,
    NoTrigger,
    QueryError,
    ScopeEvent,
    SettingError,
    TransferError,
    WrongInstrument,
)

if TYPE_CHECKING:
    from instrument.dialogue.identify import Identity
    from instrument.dialogue.retry import ATTEMPTS, RECONNECT_FOR, Persistence, Tally
    from instrument.discovery import FoundResource, find_resources
    from instrument.rate_table import ManualRateTable, RateTable
    from instrument.tds2014.front_panel import ChannelSettings, FoundPanel
    from instrument.tds2014.knobs import MEASUREMENTS, Cursors, Measurement, ScreenPicture
    from instrument.tds2014.scope import TDS2014
    from instrument.tek_files import read_waveform
    from instrument.waveform import Preamble, Waveform

__all__ = [
    "ATTEMPTS",
    "MEASUREMENTS",
    "RECONNECT_FOR",
    "TDS2014",
    "ChannelSettings",
    "CommandError",
    "Cursors",
    "DeviceError",
    "ExecutionError",
    "FileFormatError",
    "FoundPanel",
    "FoundResource",
    "Identity",
    "InstrumentError",
    "LinkError",
    "ManualRateTable",
    "Measurement",
    "NoTrigger",
    "Persistence",
    "Preamble",
    "QueryError",
    "RateTable",
    "ScopeEvent",
    "ScreenPicture",
    "SettingError",
    "Tally",
    "TransferError",
    "Waveform",
    "WrongInstrument",
    "find_resources",
    "read_waveform",
]


# a name is imported when it is first used: most programs need few of them
_HOMES = {
    "instrument.dialogue.identify": ("Identity",),
    "instrument.dialogue.retry": ("ATTEMPTS", "RECONNECT_FOR", "Persistence", "Tally"),
    "instrument.discovery": ("FoundResource", "find_resources"),
    "instrument.rate_table": ("ManualRateTable", "RateTable"),
    "instrument.tds2014.front_panel": ("ChannelSettings", "FoundPanel"),
    "instrument.tds2014.knobs": ("MEASUREMENTS", "Cursors", "Measurement", "ScreenPicture"),
    "instrument.tds2014.scope": ("TDS2014",),
    "instrument.tek_files": ("read_waveform",),
    "instrument.waveform": ("Preamble", "Waveform"),
}


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            found = globals()[name] = getattr(importlib.import_module(home), name)
            return found
    raise AttributeError(f"module 'instrument' has no attribute {name!r}")
