"""The front panel as methods, each read back; setups, measurements, cursors and the picture of the screen."""

import io
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from instrument import scpi
from instrument.dialogue.identify import is_error, scope_event
from instrument.errors import ScopeEvent, SettingError, TransferError
from instrument.scpi import LEVELS_PER_DIVISION
from instrument.tds2014.front_panel import (
    Change,
    ChannelSettings,
    ScopeConnection,
    group_commands,
    is_on,
    one_of,
    optional,
    read_setup,
    write_setup,
)

_TRIGGER_SOURCES = ("EXT", "EXT5", "EXT10", "LINE", "AC LINE")


class Knobs:
    """Makes settings and reads them back; what is changed is remembered and put back on closing."""

    def __init__(self, session: ScopeConnection) -> None:
        self._session = session
        self._panel = session.panel

    def setup(
        self,
        *,
        channels: Mapping[str | int, Mapping[str, Any]] | None = None,
        timebase: Mapping[str, Any] | None = None,
        trigger: Mapping[str, Any] | None = None,
        acquisition: Mapping[str, Any] | None = None,
    ) -> None:
        """Set several groups at once; the keys are the arguments of the ``set_...`` methods.

        ``setup(channels={"CH1": {"scale": 0.5}}, timebase={"seconds_per_division": 5e-3})``
        """
        for channel, arguments in (channels or {}).items():
            self.set_channel(channel, **arguments)
        if timebase:
            self.set_timebase(**timebase)
        if trigger:
            self.set_trigger(**trigger)
        if acquisition:
            self.set_acquisition(**acquisition)

    def set_channel(
        self,
        channel: str | int,
        *,
        scale: float | None = None,
        position: float | None = None,
        coupling: str | None = None,
        probe: float | None = None,
        bandwidth_limit: bool | None = None,
        invert: bool | None = None,
        displayed: bool | None = True,
    ) -> ChannelSettings:
        """Set one channel and read it back; what is None stays as it is.

        Parameters
        ----------
        scale : float
            V/div at the probe tip, from 2 mV to 5 V in steps of 1-2-5, times the probe factor.
        position : float
            Divisions above the centre, in steps of 0.04.
        coupling : {"DC", "AC", "GND"}
        probe : float
            Attenuation factor of the probe.
        bandwidth_limit, invert, displayed : bool
            Only a displayed channel can be read.

        Raises
        ------
        SettingError
            If this model has no such channel, or the scope holds another value than the one asked for.
        """
        name = self._session.channel(channel)
        word = None if coupling is None else one_of("the coupling", coupling, ("DC", "AC", "GND"))
        # Changing a channel moves the trigger level, which is given in its volts.
        self._session.before_changing(name, "TRIGGER", "CURSOR")
        half_step = 0.5 / LEVELS_PER_DIVISION
        self._panel.change(
            *optional(f":SELECT:{name}", displayed),
            *optional(f":{name}:PROBE", probe),
            *optional(f":{name}:SCALE", scale, 0.0 if scale is None else 1e-3 * scale),
            *optional(f":{name}:POSITION", position, half_step),
            *optional(f":{name}:COUPLING", word),
            *optional(f":{name}:BANDWIDTH", bandwidth_limit),
            *optional(f":{name}:INVERT", invert),
        )
        return self.channel_settings(name)

    def channel_settings(self, channel: str | int) -> ChannelSettings:
        """Read how a channel is set now."""
        name = self._session.channel(channel)
        factor, scale, position, coupling, limit, invert, shown = self._panel.read(group_commands(name))
        return ChannelSettings(
            channel=name,
            scale=scpi.number(scale),
            position=scpi.number(position),
            coupling=coupling,
            probe=scpi.number(factor),
            bandwidth_limit=is_on(limit),
            invert=is_on(invert),
            displayed=is_on(shown),
        )

    def set_timebase(self, seconds_per_division: float, *, position: float | None = None) -> float:
        """Set the main time base; returns the s/div read back.

        Parameters
        ----------
        seconds_per_division : float
            In steps of 1-2.5-5.
        position : float, optional
            Time in s from the trigger to the centre of the record.
        """
        if not seconds_per_division > 0:
            raise SettingError(f"the time base cannot be {seconds_per_division} s/div; give a positive time")
        self._session.before_changing("HORIZONTAL", "CURSOR")
        answers = self._panel.change(
            Change(":HORIZONTAL:MAIN:SCALE", seconds_per_division, 1e-3 * seconds_per_division),
            # The trigger can stand on whole points only.
            *optional(":HORIZONTAL:MAIN:POSITION", position, seconds_per_division / LEVELS_PER_DIVISION),
        )
        return scpi.number(answers[0])

    def set_trigger(
        self,
        *,
        source: str | int | None = None,
        level: float | None = None,
        slope: str | None = None,
        coupling: str | None = None,
        mode: str | None = None,
        holdoff: float | None = None,
    ) -> None:
        """Set the edge trigger and read it back; what is None stays as it is.

        Parameters
        ----------
        source : str or int
            A channel, ``EXT``, ``EXT5`` (external over 5) or ``LINE`` (mains).
        level : float
            In V, at most 8 divisions from the centre of a channel.
        slope : {"RISE", "FALL"}
        coupling : {"DC", "AC", "HFREJ", "LFREJ", "NOISEREJ"}
        mode : {"AUTO", "NORMAL"}
            AUTO goes on without a trigger.
        holdoff : float
            Time in s, 500 ns to 10 s.
        """
        words = {
            ":TRIGGER:MAIN:EDGE:SOURCE": None if source is None else self._trigger_source(source),
            ":TRIGGER:MAIN:EDGE:SLOPE": slope and one_of("the trigger slope", slope, ("RISE", "FALL")),
            ":TRIGGER:MAIN:EDGE:COUPLING": coupling
            and one_of("the trigger coupling", coupling, ("DC", "AC", "HFREJ", "LFREJ", "NOISEREJ")),
            ":TRIGGER:MAIN:MODE": mode and one_of("the trigger mode", mode, ("AUTO", "NORMAL")),
        }
        self._session.before_changing("TRIGGER")
        self._panel.change(
            Change(":TRIGGER:MAIN:TYPE", "EDGE"),
            *(Change(command, word) for command, word in words.items() if word),
            *optional(":TRIGGER:MAIN:HOLDOFF:VALUE", holdoff, 0.0 if holdoff is None else 0.05 * holdoff),
        )
        if level is not None:
            self._panel.change(Change(":TRIGGER:MAIN:LEVEL", level, self._level_step()))

    def set_acquisition(self, *, mode: str = "SAMPLE", averages: int | None = None) -> None:
        """Set the acquisition mode: ``SAMPLE``, ``PEAKDETECT``, or ``AVERAGE`` of 4, 16, 64 or 128."""
        word = one_of("the acquisition mode", mode, ("SAMPLE", "PEAKDETECT", "AVERAGE"))
        self._session.before_changing("ACQUIRE")
        self._panel.change(Change(":ACQUIRE:MODE", word), *optional(":ACQUIRE:NUMAVG", averages))

    # ------------------------------------------------------------------ inside

    def _trigger_source(self, source: str | int) -> str:
        if isinstance(source, str) and source.strip().upper() in _TRIGGER_SOURCES:
            return source.strip().upper()
        return self._session.channel(source)

    def _level_step(self) -> float:
        """One converter level of the trigger's channel in V; an external input shows at most 16 V in 200."""
        (source,) = self._panel.read((":TRIGGER:MAIN:EDGE:SOURCE",))
        if source not in self._session.channels:
            return 16.0 / 200
        (scale,) = self._panel.read((f":{source}:SCALE",))
        return scpi.number(scale) / LEVELS_PER_DIVISION


# --------------------
# Whole setups: as a text, in the scope's ten memories, from the factory, or chosen by the scope itself.
#
# Programmer manual 071-1075-04, pp. 2-53, 2-186 to 2-198


MEMORIES = range(1, 11)  # numbers of the setup memories inside the scope

FACTORY = "FACTORY"

_AUTOSET_TIME = 10.0  # s: several acquisitions at different settings


class Setups:
    """All settings at once; what they change is put back on closing."""

    def __init__(self, session: ScopeConnection) -> None:
        self._session = session

    def read_setup(self) -> str:
        """All settings as a text that `write_setup` takes."""
        return read_setup(self._session.dialogue)

    def write_setup(self, setup: str) -> None:
        """Make all settings as in a text from `read_setup`; SettingError if one cannot be made."""
        self._session.before_changing_all()
        write_setup(self._session.dialogue, setup)

    def save_setup(self, memory: int) -> None:
        """Keep the present settings in memory 1 to 10 of the scope, over what was there."""
        self._session.dialogue.command(f":SAVE:SETUP {_memory(memory)}")

    def recall_setup(self, memory: int | str) -> None:
        """Make all settings as in memory 1 to 10, or as at the ``"FACTORY"``; put back on closing."""
        place = FACTORY if str(memory).upper() == FACTORY else str(_memory(memory))
        self._session.before_changing_all()
        self._session.dialogue.command(f":RECALL:SETUP {place}")
        self._session.dialogue.set_format()

    def autoset(self) -> None:
        """Let the scope choose scales, time base and trigger; put back on closing."""
        self._session.before_changing_all()
        _, events = self._session.dialogue.ask_with_events(":AUTOSET EXECUTE;*WAI", parts=0, wait=_AUTOSET_TIME)
        for event in events:
            if is_error(event):
                raise event


def _memory(number: int | str) -> int:
    if number not in MEMORIES:
        raise SettingError(f"there is no setup memory {number!r}; choose 1 to {MEMORIES[-1]}")
    return int(number)


# --------------------
# What the scope itself measures and computes: measurements, cursors, the math waveform, references.
#
# Programmer manual 071-1075-04, pp. 2-75 to 2-83, 2-148 and 2-159 to 2-170


MEASUREMENTS = (
    *("FREQUENCY", "PERIOD", "MEAN", "PK2PK", "CRMS", "MINIMUM", "MAXIMUM"),
    *("RISE", "FALL", "PWIDTH", "NWIDTH"),
)
"""Names of the measurements of this family."""

NO_VALUE = 9.9e37  # stands for a value that could not be measured
_CURSOR_PRECISION = 0.02  # of the largest position; cursors stand on pixels


@dataclass(frozen=True)
class Measurement:
    """One value that the scope measured.

    Attributes
    ----------
    kind, source : str
        For example ``FREQUENCY`` of ``CH1``.
    value : float
        In `unit`.
    unit : str
        ``Hz``, ``s``, ``V``.
    warnings : tuple of str
        What the scope says about it, such as a clipped record; mostly empty.
    """

    kind: str
    source: str
    value: float
    unit: str
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.kind} of {self.source}: {self.value:.6g} {self.unit}"


@dataclass(frozen=True)
class Cursors:
    """A pair of cursors as the scope holds it.

    Attributes
    ----------
    bars : str
        ``VBARS`` (times), ``HBARS`` (volts) or ``OFF``.
    source : str
        Waveform that they belong to.
    positions : tuple of float
        Of both, in `unit`; empty when off.
    difference : float
        Second minus first; 0 when off.
    unit : str
        ``s`` or what the scope calls it: ``VOLTS``, ``DECIBELS``...
    """

    bars: str
    source: str
    positions: tuple[float, ...] = ()
    difference: float = 0.0
    unit: str = ""


class Measurements:
    """The scope's MEASURE, CURSOR, MATH and REF menus."""

    def __init__(self, session: ScopeConnection) -> None:
        self._session = session
        self._panel = session.panel

    def measure(self, kind: str, channel: str | int) -> Measurement:
        """One of `MEASUREMENTS` on the record that the scope holds.

        Raises
        ------
        ExecutionError
            With the scope's event if there is no value: no period in the record, too small an amplitude...
        """
        word = one_of("the measurement", kind, MEASUREMENTS)
        self._panel.remember("MEASUREMENT")
        source, wait = self._session.source(channel), self._session.acquisition_time().longest
        branch = ":MEASUREMENT:IMMED"
        answers, events = self._session.dialogue.ask_with_events(
            f"{branch}:TYPE {word};SOURCE {source};{branch}:VALUE?;UNITS?", parts=2, wait=wait
        )
        value = scpi.number(answers[0])
        for event in events:
            if is_error(event):
                raise event
        if abs(value) >= NO_VALUE:
            raise scope_event(2200, f"{word} of {source} has no value", "look at the record: is the signal there?")
        return Measurement(word, source, value, scpi.unquote(answers[1]), tuple(event.text for event in events))

    def set_cursors(
        self, bars: str, *, source: str | int = "CH1", positions: tuple[float, float] | None = None
    ) -> Cursors:
        """Show cursors: ``VBARS`` at two times in s, ``HBARS`` at two values in V, or ``OFF``."""
        word = one_of("the cursors", bars, ("VBARS", "HBARS", "OFF"))
        name = self._session.source(source)
        self._panel.remember("CURSOR", "CURSOR KIND")
        self._panel.change(Change(":CURSOR:SELECT:SOURCE", name), Change(":CURSOR:FUNCTION", word))
        if word == "VBARS":
            self._panel.change(Change(":CURSOR:VBARS:UNITS", "SECONDS"))
        if positions is not None:
            if word == "OFF":
                raise SettingError("cursors that are off have no positions; choose VBARS or HBARS")
            tolerance = _CURSOR_PRECISION * max(abs(position) for position in positions)
            self._panel.change(
                *(
                    Change(f":CURSOR:{word}:POSITION{number}", position, tolerance)
                    for number, position in enumerate(positions, start=1)
                )
            )
        return self.cursors()

    def cursors(self) -> Cursors:
        """The cursors as they stand now."""
        bars, source = self._panel.read((":CURSOR:FUNCTION", ":CURSOR:SELECT:SOURCE"))
        if bars == "OFF":
            return Cursors(bars, source)
        branch = f":CURSOR:{bars}"
        first, second, difference, unit = self._panel.read(
            tuple(f"{branch}:{leaf}" for leaf in ("POSITION1", "POSITION2", "DELTA", "UNITS"))
        )
        unit = {"SECONDS": "s", "HERTZ": "Hz"}.get(unit, unit)
        return Cursors(bars, source, (scpi.number(first), scpi.number(second)), scpi.number(difference), unit)

    def set_math(self, expression: str, *, displayed: bool = True) -> None:
        """Define the math waveform, ``"CH1 - CH2"`` or ``"FFT(CH1, HANNING)"``; read it with ``fetch("MATH")``.

        Raises
        ------
        SettingError
            If the scope holds another expression afterwards.
        ExecutionError
            If this model cannot compute it.
        """
        if '"' in expression or ";" in expression:
            raise SettingError(f"{expression!r} is not a math expression; write for example CH1 - CH2 or FFT(CH1)")
        self._session.before_changing("MATH")
        on = "ON" if displayed else "OFF"
        message = f':MATH:DEFINE "{expression}";:SELECT:MATH {on};:MATH:DEFINE?;*ESR?'
        (held,) = self._session.dialogue.checked(message, parts=1)
        # The scope writes blanks of its own and names the window that was left out.
        if not _plain(scpi.unquote(held)).startswith(_plain(expression).rstrip(")")):
            raise SettingError(f"the math waveform was set to {expression} but the scope holds {held}")

    def save_reference(self, reference: str, source: str | int) -> None:
        """Store a displayed waveform in ``REFA``..., over what was there, and show it. It stays stored."""
        name = self._session.source(reference)
        if not name.startswith("REF"):
            raise SettingError(f"there is no reference {name}; choose REFA, REFB...")
        self._session.before_changing(name)
        self._session.dialogue.command(f":SAVE:WAVEFORM {self._session.source(source)},{name}")
        self._panel.change(Change(f":SELECT:{name}", True))


def _plain(expression: str) -> str:
    return expression.replace(" ", "").upper()


# --------------------
# The picture of the scope's screen: fetched as BMP, given as PNG


_PICTURE_TIME = 10.0  # s until the first byte: the scope draws the whole picture first


@dataclass(frozen=True)
class ScreenPicture:
    """A picture of the screen; a notebook shows it by itself.

    Attributes
    ----------
    png : bytes
        The picture as a PNG file.
    """

    png: bytes

    def save(self, path: str | Path) -> None:
        """Write the PNG file. OSError if that is not possible."""
        Path(path).write_bytes(self.png)

    def _repr_png_(self) -> bytes:
        return self.png


class Screen:
    """Has the scope draw its screen for us."""

    def __init__(self, session: ScopeConnection) -> None:
        self._session = session

    def screen(self) -> ScreenPicture:
        """Picture of the screen, as PNG. Over RS-232 it takes about 80 s at 9600 baud."""
        self._session.panel.remember("HARDCOPY")
        self._choose_port()
        return ScreenPicture(png_from_bmp(self._session.dialogue.picture(wait=_PICTURE_TIME)))

    def _choose_port(self) -> None:
        """Send pictures to our own link: first the word that fits it, then the others that this unit may know."""
        dialogue = self._session.dialogue
        words = ["GPIB", "USB"] if dialogue.link.on_bus else ["RS232"]
        if dialogue.link.name.upper().startswith("USB"):
            words.reverse()
        for word in words:
            try:
                dialogue.command(f":HARDCOPY:FORMAT BMP;PORT {word}")
            except ScopeEvent:
                if word == words[-1]:
                    raise
            else:
                return


def png_from_bmp(bmp: bytes) -> bytes:
    """Turn an uncompressed BMP file of 1, 4, 8 or 24 bits a pixel into a PNG file of the same pixels."""
    try:
        width, bits, compression = struct.unpack_from("<18xi4x2xHI16x", bmp)
    except struct.error:
        raise TransferError(f"a picture of {len(bmp)} bytes is too short to be one; ask again") from None
    if bmp[:2] != b"BM" or compression or bits not in (1, 4, 8, 24) or width <= 0:
        raise TransferError(f"the picture is no plain BMP ({bits} bits, compression {compression}); ask again")
    from PIL import Image  # takes 20 ms to import, and few sessions need a picture

    png = io.BytesIO()
    try:
        with Image.open(io.BytesIO(bmp), formats=["BMP"]) as picture:
            picture.save(png, "PNG")
    except (OSError, ValueError, Image.DecompressionBombError):
        raise TransferError("the picture is cut; ask again") from None
    return png.getvalue()
