"""What can go wrong with an instrument, one exception class for each thing a caller can act on.

The text of every one is a clear sentence: what is wrong, where, and what to do next.
"""


class InstrumentError(Exception):
    """Base class of everything that this package raises about an instrument or its files."""


class LinkError(InstrumentError):
    """The instrument cannot be opened, the link is lost, or nothing answers at all."""


class WrongInstrument(InstrumentError):
    """Something answers, but it is not an oscilloscope of this family."""


class NoTrigger(InstrumentError):
    """The acquisition did not complete in time; the scope itself still answers."""


class TransferError(InstrumentError):
    """An answer was damaged on its way: wrong length, broken preamble, bytes lost or added.

    When it is raised the driver has already brought the link back into step, so the caller may ask again.
    """


class SettingError(InstrumentError):
    """The scope holds another value than the one asked for, or this model cannot take the value."""


class FileFormatError(InstrumentError):
    """The file is not one that a scope of this family, or its PC software, has written."""


class ScopeEvent(InstrumentError):
    """An entry of the scope's event queue.

    Attributes
    ----------
    code : int
        Event code (programmer manual 071-1075-04, tables 3-3 to 3-9).
    text : str
        Text that the scope sent with it; a command error also quotes the command.
    """

    def __init__(self, code: int, text: str, advice: str = "") -> None:
        self.code = code
        self.text = text
        sentence = f"the scope reports event {code}: {text}"
        super().__init__(f"{sentence}; {advice}" if advice else sentence)


class CommandError(ScopeEvent):
    """Events 100 to 199: the scope did not understand a command."""


class ExecutionError(ScopeEvent):
    """Events 200 to 299, 500 to 599 and from 2200 on: understood, but it cannot be done (fully) now."""


class DeviceError(ScopeEvent):
    """Events 300 to 399: trouble inside the scope, or on its serial line (361 to 363)."""


class QueryError(ScopeEvent):
    """Events 410 to 440: question and answer got out of step."""


class FrameFormatError(SettingError):
    """The description of the frames is wrong; the text names the entry, what is wrong there and what is right."""


class CommandRefused(LinkError):
    """The gyro answered that it will not do what it was told."""


class NoAcknowledgement(LinkError):
    """The gyro was told something several times and never said that it understood."""
