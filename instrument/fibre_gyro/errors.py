"""What can go wrong with a fibre gyro's link beyond what any instrument can do."""

from __future__ import annotations

from instrument.errors import LinkError, SettingError


class FrameFormatError(SettingError):
    """The description of the frames is wrong; the text names the entry, what is wrong there and what is right."""


class CommandRefused(LinkError):
    """The gyro answered that it will not do what it was told."""


class NoAcknowledgement(LinkError):
    """The gyro was told something several times and never said that it understood."""
