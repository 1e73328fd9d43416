from .dialogue.identify import Identity as Identity
from .dialogue.retry import (
    ATTEMPTS as ATTEMPTS,
    RECONNECT_FOR as RECONNECT_FOR,
    Persistence as Persistence,
    Tally as Tally,
)
from .discovery import FoundResource as FoundResource, find_resources as find_resources
from .errors import (
    CommandError as CommandError,
    DeviceError as DeviceError,
    ExecutionError as ExecutionError,
    FileFormatError as FileFormatError,
    InstrumentError as InstrumentError,
    LinkError as LinkError,
    NoTrigger as NoTrigger,
    QueryError as QueryError,
    ScopeEvent as ScopeEvent,
    SettingError as SettingError,
    TransferError as TransferError,
    WrongInstrument as WrongInstrument,
)
from .rate_table import ManualRateTable as ManualRateTable, RateTable as RateTable
from .tds2014.front_panel import ChannelSettings as ChannelSettings, FoundPanel as FoundPanel
from .tds2014.knobs import (
    MEASUREMENTS as MEASUREMENTS,
    Cursors as Cursors,
    Measurement as Measurement,
    ScreenPicture as ScreenPicture,
)
from .tds2014.scope import TDS2014 as TDS2014
from .tek_files import read_waveform as read_waveform
from .waveform import Preamble as Preamble, Waveform as Waveform
