"""Lines to and from a controller through PyVISA: GPIB, USB, RS-232 and TCP."""

from __future__ import annotations

import time
from contextlib import suppress

import pyvisa
from pyvisa import constants
from pyvisa.constants import InterfaceType, StatusCode
from pyvisa.resources import MessageBasedResource, SerialInstrument

from instrument.errors import LinkError, TransferError
from instrument.in_use import claim
from instrument.templates.description import LinkSection

_PARITY = {"none": constants.Parity.none, "even": constants.Parity.even, "odd": constants.Parity.odd}
_STOP = {1: constants.StopBits.one, 2: constants.StopBits.two}
_LATE_MS = 30
"""Longest silence between two bytes of an answer that comes too late."""

_LONGEST = 4096  # bytes of an answer


class Lines:
    """A link that carries lines; a context manager."""

    def __init__(
        self, resource_name: str, link: LinkSection, resource_manager: pyvisa.ResourceManager | None = None
    ) -> None:
        self.name = resource_name
        self._link, self._manager = link, resource_manager
        self._resource: MessageBasedResource | None = None
        self._claim = claim(resource_name)
        try:
            self.open()
        except BaseException:
            self._claim.release()
            raise

    def __enter__(self) -> Lines:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self) -> None:
        """Open the link, or open it again; other programs are kept from it meanwhile."""
        self._hang_up()
        try:
            manager = self._manager or pyvisa.ResourceManager()
            resource = manager.open_resource(self.name)
        except (pyvisa.Error, OSError, ValueError, AttributeError) as error:
            raise LinkError(
                f"{self.name} cannot be opened ({_why(error)}); is it switched on and connected?"
            ) from None
        if not isinstance(resource, MessageBasedResource):
            resource.close()
            raise LinkError(f"{self.name} takes no messages; see `gyrolock list`")
        self._resource = resource
        try:
            self._configure(resource)
        except (pyvisa.Error, OSError, ValueError) as error:
            self._hang_up()
            raise LinkError(f"{self.name} cannot be set up ({_why(error)})") from None

    def close(self) -> None:
        """Close the link; never raises."""
        self._hang_up()
        self._claim.release()

    def _hang_up(self) -> None:
        if self._resource is not None:
            with suppress(pyvisa.Error, OSError):
                self._resource.close()
            self._resource = None

    def send(self, line: str) -> None:
        """Send one line; its end is added here. LinkError if it cannot be sent."""
        try:
            self._opened.write_raw((line + self._link.line_end).encode("ascii"))
        except UnicodeEncodeError:
            raise TransferError(f"{line!r} cannot be sent to {self.name}: it is not ASCII") from None
        except (pyvisa.Error, OSError, ValueError) as error:
            raise LinkError(f"{self.name} takes no data ({_why(error)})") from None
        if self._link.pause_s:
            time.sleep(self._link.pause_s)

    def read(self) -> str:
        """Read one line, without its end."""
        end, found = self._link.answer_end.encode("ascii"), b""
        until = time.monotonic() + self._link.answer_s
        while not found.endswith(end):
            left = until - time.monotonic()
            if left <= 0 or len(found) > _LONGEST:
                raise TransferError(
                    f"{self.name} gave no whole answer within {self._link.answer_s:g} s: {found[:60]!r}"
                )
            found += self._some(max(1, int(1000 * left)))
        try:
            return found[: -len(end)].decode("ascii").strip()
        except UnicodeDecodeError:
            raise TransferError(f"{self.name} answered what is no text: {found[:60]!r}") from None

    def drain(self) -> None:
        """Throw away what comes late, so that the next answer is that of the next question."""
        with suppress(TransferError):
            while self._some(_LATE_MS):
                pass

    @property
    def _opened(self) -> MessageBasedResource:
        if self._resource is None:
            raise LinkError(f"{self.name} is not open")
        return self._resource

    def _some(self, patience_ms: int) -> bytes:
        """At least one byte, as many as are there up to the end of a line; none if the time is over."""
        resource = self._opened
        try:
            resource.timeout = patience_ms
            with resource.ignore_warning(StatusCode.success_max_count_read, StatusCode.success_device_not_present):
                return bytes(resource.visalib.read(resource.session, 1 if self._streamed else _LONGEST)[0])
        except pyvisa.VisaIOError as error:
            if error.error_code == StatusCode.error_timeout:
                return b""
            raise LinkError(f"the link to {self.name} is lost ({_why(error)})") from None
        except (pyvisa.Error, OSError, ValueError) as error:
            raise LinkError(f"the link to {self.name} is lost ({_why(error)})") from None

    @property
    def _streamed(self) -> bool:
        """Whether nothing but its end tells where an answer ends."""
        serial = self._opened.interface_type == InterfaceType.asrl
        return serial or self.name.upper().rstrip().endswith("SOCKET")

    def _configure(self, resource: MessageBasedResource) -> None:
        if isinstance(resource, SerialInstrument):
            resource.baud_rate = self._link.baud_rate
            resource.data_bits = self._link.data_bits
            resource.parity = _PARITY[self._link.parity]
            resource.stop_bits = _STOP[self._link.stop_bits]
        resource.read_termination = None
        if self._streamed:
            with suppress(pyvisa.Error, NotImplementedError):
                resource.set_visa_attribute(constants.ResourceAttribute.termchar_enabled, False)


def _why(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
