"""The oscilloscope as a PyMeasure instrument: channels with properties, records, and PyMeasure's own text methods.

>>> from instrument.adapters.pymeasure_scope import PyMeasureScope          # doctest: +SKIP
>>> scope = PyMeasureScope("GPIB0::1::INSTR")                               # doctest: +SKIP
>>> scope.ch_1.scale = 0.5                                                  # doctest: +SKIP
>>> volts = scope.ch_1.acquire().volts                                      # doctest: +SKIP
"""

from typing import Any

from pymeasure.adapters import Adapter
from pymeasure.instruments import Channel, Instrument

from instrument import TDS2014, Waveform


class DriverAdapter(Adapter):
    """PyMeasure's text goes through the driver, so that it stays in step and errors have its words."""

    def __init__(self, driver: TDS2014) -> None:
        super().__init__()
        self.driver = driver
        self.connection = driver
        self._question = ""

    def _write(self, command: str, **kwargs: Any) -> None:
        if command.rstrip().endswith("?"):
            self._question = command
        else:
            self.driver.write(command)

    def _read(self, **kwargs: Any) -> str:
        question, self._question = self._question, ""
        return self.driver.query(question)

    def flush_read_buffer(self) -> None:
        """Nothing is ever left over: the driver reads whole answers."""


def _setting(name: str, text: str) -> property:
    """A property of a channel that the driver sets and reads."""

    def read(channel: ScopeChannel) -> Any:
        return getattr(channel.driver.channel_settings(channel.id), name)

    def write(channel: ScopeChannel, value: Any) -> None:
        channel.driver.set_channel(channel.id, **{name: value})

    return property(read, write, doc=text)


class ScopeChannel(Channel):
    """One channel."""

    scale = _setting("scale", "V/div at the probe tip.")
    position = _setting("position", "Divisions above the centre.")
    coupling = _setting("coupling", "DC, AC or GND.")
    probe = _setting("probe", "Attenuation of the probe.")
    bandwidth_limit = _setting("bandwidth_limit", "Whether it is limited to 20 MHz.")
    invert = _setting("invert", "Whether it stands upside down.")
    displayed = _setting("displayed", "Whether it is on the screen.")

    @property
    def driver(self) -> TDS2014:
        """The driver beneath."""
        driver: TDS2014 = self.parent.driver
        return driver

    def acquire(self) -> Waveform:
        """One fresh record, as `TDS2014.acquire` gives it."""
        return self.driver.acquire(self.id)

    def measure(self, kind: str) -> float:
        """One of the scope's own measurements, such as ``FREQUENCY``."""
        return self.driver.measure(kind, self.id).value


class PyMeasureScope(Instrument):
    """A TDS1000, TDS2000 or TPS2000 in PyMeasure."""

    def __init__(self, scope: str | TDS2014, name: str = "Tektronix TDS2014", **options: Any) -> None:
        driver = TDS2014(scope, **options) if isinstance(scope, str) else scope
        super().__init__(DriverAdapter(driver), name, includeSCPI=False)
        self.driver = driver
        for number in range(1, len(driver.channels) + 1):
            self.add_child(ScopeChannel, number, collection="channels", prefix="ch_")

    @property
    def id(self) -> str:
        """The answer to ``*IDN?``."""
        return self.driver.id

    def check_errors(self) -> list[Any]:
        """Events that the scope has posted since the last call."""
        return list(self.driver.events())

    def shutdown(self) -> None:
        """Put the front panel back and close the link."""
        self.driver.close()
        super().shutdown()
