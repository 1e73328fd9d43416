"""The oscilloscope as an ophyd-async device for Bluesky: triggered, it takes a record of each of its channels.

>>> from bluesky import RunEngine, plans                                    # doctest: +SKIP
>>> from instrument.adapters.ophyd_scope import OphydScope                  # doctest: +SKIP
>>> scope = OphydScope("GPIB0::1::INSTR", channels=("CH1",), name="scope")  # doctest: +SKIP
>>> RunEngine()(plans.count([scope], num=5))                                # doctest: +SKIP
"""

import asyncio
import time
from collections.abc import Sequence
from typing import Any

from bluesky.protocols import Reading
from event_model import DataKey
from ophyd_async.core import AsyncStatus, Device

from instrument import TDS2014, Waveform
from instrument.scpi import POINTS

_SCALES = ("sample_interval_s", "first_sample_s")


class OphydScope(Device):
    """A TDS1000, TDS2000 or TPS2000 in Bluesky."""

    def __init__(
        self, resource_name: str, *, channels: Sequence[str] = ("CH1",), name: str = "scope", **options: Any
    ) -> None:
        self.driver = TDS2014(resource_name, **options)
        self._channels = tuple(channels)
        self._records: tuple[Waveform, ...] = ()
        self._taken_at = 0.0
        super().__init__(name=name)

    @property
    def hints(self) -> dict[str, Any]:
        """What a live table shows."""
        return {"fields": [self._key(channel) for channel in self._channels]}

    @AsyncStatus.wrap
    async def stage(self) -> None:
        """Forget records of before."""
        self._records = ()

    @AsyncStatus.wrap
    async def unstage(self) -> None:
        """Nothing is left running."""

    @AsyncStatus.wrap
    async def trigger(self) -> None:
        """Take a record of every channel, of the same acquisition."""
        self._records = await self.driver.acquire_async(self._channels)
        self._taken_at = time.time()

    async def read(self) -> dict[str, Reading[Any]]:
        """Volts of the last record and when its samples were taken."""
        if not self._records:
            await self.trigger()
        found: dict[str, Reading[Any]] = {}
        for channel, record in zip(self._channels, self._records, strict=True):
            scales = (record.sample_interval, float(record.times[0]))
            found[self._key(channel)] = Reading(value=record.volts, timestamp=self._taken_at)
            for scale, value in zip(_SCALES, scales, strict=True):
                found[self._key(channel, scale)] = Reading(value=value, timestamp=self._taken_at)
        return found

    async def describe(self) -> dict[str, DataKey]:
        """Shapes and units of what `read` gives."""
        source = f"tds2014://{self.driver.resource_name}"
        described: dict[str, DataKey] = {}
        for channel in self._channels:
            described[self._key(channel)] = DataKey(
                source=f"{source}/{channel}", dtype="array", dtype_numpy="<f8", shape=[POINTS], units="V"
            )
            for scale in _SCALES:
                described[self._key(channel, scale)] = DataKey(
                    source=f"{source}/{channel}", dtype="number", dtype_numpy="<f8", shape=[], units="s"
                )
        return described

    async def read_configuration(self) -> dict[str, Reading[Any]]:
        """How the channels are set."""
        now, found = time.time(), {}
        for channel in self._channels:
            settings = await asyncio.to_thread(self.driver.channel_settings, channel)
            found[self._key(channel, "scale")] = Reading(value=settings.scale, timestamp=now)
            found[self._key(channel, "position")] = Reading(value=settings.position, timestamp=now)
        return found

    async def describe_configuration(self) -> dict[str, DataKey]:
        """Units of what `read_configuration` gives."""
        source = f"tds2014://{self.driver.resource_name}"
        return {
            self._key(channel, knob): DataKey(source=f"{source}/{channel}", dtype="number", shape=[], units=unit)
            for channel in self._channels
            for knob, unit in (("scale", "V/div"), ("position", "div"))
        }

    def close(self) -> None:
        """Put the front panel back, and close the link."""
        self.driver.close()

    def _key(self, channel: str, what: str = "") -> str:
        return "-".join(filter(None, (self.name, channel, what)))
