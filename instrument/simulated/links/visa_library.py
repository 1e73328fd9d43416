"""Simulated instruments behind PyVISA's own interface, in this process: no driver, no socket.

GPIB, USB and other INSTR names carry whole messages. ASRL and SOCKET names carry a stream: LF or CR ends a
message, and a read ends at the termination character, at its count, or in a time-out. On a virtual clock the
bytes of an ASRL answer take ten bits each at RS232:BAUd.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyvisa
from pyvisa import attributes, constants, rname
from pyvisa.constants import (
    ControlFlow,
    EventMechanism,
    EventType,
    InterfaceType,
    ResourceAttribute,
    SerialTermination,
    StatusCode,
)
from pyvisa.highlevel import VisaLibraryBase
from pyvisa.typing import VISARMSession, VISASession
from pyvisa.util import LibraryPath

from instrument.simulated.front_end.frontend import Floats, Signal
from instrument.simulated.links.exchange import XOFF, XON, MessageExchange
from instrument.simulated.scope import SimulatedTDS2014

DEFAULT_NAMES = ("GPIB0::1::INSTR", "USB0::0x0699::0x0368::C010101::INSTR")
_BREAK = SerialTermination.termination_break
_LONGEST_STOP = 60.0  # s that a stopped program waits which has no time-out
_LIBRARY_NUMBERS = itertools.count(1)


def demonstration_signals() -> dict[int, Signal]:
    """Two sines of 1 kHz, a quarter of a period apart, that fill half the screen with factory settings."""
    # They have 0.2 V at the BNC: the factory settings expect a 10X probe, and show 2 V at 1 V/div.

    def sine(times: Floats) -> Floats:
        return np.asarray(0.2 * np.sin(2 * math.pi * 1000.0 * times), dtype=np.float64)

    return {1: sine, 2: lambda times: sine(times - 0.25e-3)}


def resource_manager(
    signals: Mapping[int, Signal] | Signal | None = None,
    *,
    scopes: Mapping[str, SimulatedTDS2014] | None = None,
    **scope_options: Any,
) -> pyvisa.ResourceManager:
    """A PyVISA resource manager whose instruments are simulated.

    Parameters
    ----------
    signals : mapping of int to callable, or callable, optional
        Signals of one TDS2014 by channel, or the one of channel 1; see SimulatedTDS2014. Without it channel 1
        shows a sine of 1 kHz, and channel 2 has one a quarter of a period later. The instrument answers on a GPIB
        and on a USB name.
    scopes : mapping of str to SimulatedTDS2014, optional
        Instruments by resource name, in place of that one.
    **scope_options
        Further arguments of SimulatedTDS2014.

    Examples
    --------
    >>> manager = resource_manager()
    >>> scope = manager.open_resource("GPIB0::1::INSTR")
    >>> scope.query("*IDN?")
    'TEKTRONIX,TDS 2014,0,CF:91.1CT FV:v4.12 TDS2CM:CMV:v1.04\\n'
    >>> manager.close()
    """
    if scopes is None:
        inputs = {1: signals} if callable(signals) else signals
        scope = SimulatedTDS2014(demonstration_signals() if inputs is None else inputs, **scope_options)
        scopes = dict.fromkeys(DEFAULT_NAMES, scope)
    # PyVISA shares the library of a path: each has one of its own
    library = SimulatedVisaLibrary(LibraryPath(f"gyrolock-simulated-{next(_LIBRARY_NUMBERS)}", "simulated"))
    library.connect(scopes)
    return pyvisa.ResourceManager(library)


@dataclass
class _Session:
    """One opened resource."""

    name: str
    exchange: MessageExchange
    stream: bool
    serial: bool
    attributes: dict[int, Any]
    received: bytearray = field(default_factory=bytearray)
    under_way: bytearray = field(default_factory=bytearray)  # on a serial line of a virtual clock
    free_at: float = 0.0  # clock time in s from which on the next byte is on the line
    waits_for_service: bool = False
    sending_stopped: bool = False  # the computer's own XON/XOFF, set off by a byte in the data

    @property
    def obeys_xoff(self) -> bool:
        """True when the program asked for XON/XOFF on its side of the line."""
        flow = self.attributes.get(ResourceAttribute.asrl_flow_control, 0)
        return self.serial and bool(flow & ControlFlow.xon_xoff)

    def arrive(self, data: bytes) -> None:
        """Bytes reach the computer, which obeys and removes XON and XOFF where it was told to."""
        if self.obeys_xoff:
            for byte in data:
                if byte in (XON, XOFF):
                    self.sending_stopped = byte == XOFF
            data = data.translate(None, bytes((XON, XOFF)))
        self.received += data

    @property
    def byte_time(self) -> float:
        """Time in s that a byte takes on the serial line: start bit, 8 data bits, stop bit."""
        return 10 / self.exchange.scope.panel.number("RS232:BAUD")

    def seconds(self) -> float:
        """Time-out in s."""
        milliseconds = self.attributes[ResourceAttribute.timeout_value]
        return math.inf if milliseconds == constants.VI_TMO_INFINITE else milliseconds / 1000

    def ending_byte(self) -> int | None:
        """The byte that ends a read, if any."""
        at_end = self.attributes.get(ResourceAttribute.asrl_end_in) == SerialTermination.termination_char
        if self.attributes[ResourceAttribute.termchar_enabled] or (self.serial and at_end):
            return int(self.attributes[ResourceAttribute.termchar])
        return None


class SimulatedVisaLibrary(VisaLibraryBase):
    """The part of VISA that message-based programs use."""

    in_this_program = True
    """No other program can reach its instruments."""

    @staticmethod
    def get_library_paths() -> tuple[LibraryPath, ...]:
        """One name, so that PyVISA can make a library without a file."""
        return (LibraryPath("gyrolock-simulated", "simulated"),)

    def _init(self) -> None:
        self._instruments: dict[str, SimulatedTDS2014] = {}
        self._exchanges: dict[str, MessageExchange] = {}
        self._sessions: dict[int, _Session] = {}
        self._numbers = itertools.count(1)

    def connect(self, scopes: Mapping[str, SimulatedTDS2014]) -> None:
        """Put instruments on the bus."""
        self._instruments = dict(scopes)

    # Sessions

    def open_default_resource_manager(self) -> tuple[VISARMSession, StatusCode]:
        """Open the resource manager."""
        return VISARMSession(next(self._numbers)), self.handle_return_value(None, StatusCode.success)

    def list_resources(self, session: VISARMSession, query: str = "?*::INSTR") -> tuple[str, ...]:
        """Names of the instruments that are switched on."""
        present = (name for name, scope in self._instruments.items() if scope.powered)
        return tuple(rname.filter(present, query))

    def open(
        self,
        session: VISARMSession,
        resource_name: str,
        access_mode: constants.AccessModes = constants.AccessModes.no_lock,
        open_timeout: int = constants.VI_TMO_IMMEDIATE,
    ) -> tuple[VISASession, StatusCode]:
        """Open an instrument by its name."""
        try:
            name = rname.to_canonical_name(resource_name)
        except rname.InvalidResourceName:
            self.handle_return_value(None, StatusCode.error_invalid_resource_name)
            raise
        scope = self._find(name)
        if scope is None or not scope.powered:
            self.handle_return_value(None, StatusCode.error_resource_not_found)
            raise LookupError(name)
        parsed = rname.ResourceName.from_string(name)
        serial = parsed.interface_type_const == InterfaceType.asrl
        stream = serial or parsed.resource_class == "SOCKET"
        if name not in self._exchanges or self._exchanges[name].closed:
            self._exchanges[name] = MessageExchange(scope, message_ends=not stream, serial=serial)
        handle = VISASession(next(self._numbers))
        self._sessions[handle] = _Session(
            name, self._exchanges[name], stream, serial, _attributes(name, parsed, serial)
        )
        return handle, self.handle_return_value(handle, StatusCode.success)

    def _find(self, canonical_name: str) -> SimulatedTDS2014 | None:
        for name, scope in self._instruments.items():
            if rname.to_canonical_name(name).upper() == canonical_name.upper():
                return scope
        return None

    def close(self, session: Any) -> StatusCode:
        """Close a session; answers that nobody has read are lost."""
        closed = self._sessions.pop(session, None)  # the context of an event has none
        if closed is not None and closed.stream:
            closed.exchange.clear()
        return self.handle_return_value(None, StatusCode.success)

    # Bytes

    def write(self, session: VISASession, data: bytes) -> tuple[int, StatusCode]:
        """Send bytes; where messages have ends this is one message."""
        opened = self._sessions[session]
        self._check_power(session, opened)
        if opened.sending_stopped:
            opened.exchange.scope.clock.sleep(min(opened.seconds(), _LONGEST_STOP))
            self.handle_return_value(session, StatusCode.error_timeout)
        opened.exchange.receive(bytes(data))
        opened.exchange.pump()
        if opened.serial and opened.attributes.get(ResourceAttribute.asrl_end_out) == _BREAK:
            self._send_break(opened)
        return len(data), self.handle_return_value(session, StatusCode.success)

    def _send_break(self, opened: _Session) -> None:
        opened.received.clear()
        opened.under_way.clear()
        opened.sending_stopped = False
        opened.exchange.break_signal()

    def read(self, session: VISASession, count: int) -> tuple[bytes, StatusCode]:
        """Read up to `count` bytes of an answer."""
        opened = self._sessions[session]
        data, status = _read_stream(opened, count) if opened.stream else _read_message(opened, count)
        if status < 0:
            self._check_power(session, opened)
        return data, self.handle_return_value(session, status)

    def _check_power(self, session: VISASession, opened: _Session) -> None:
        """Raise what a lost instrument causes on its kind of link."""
        if opened.exchange.scope.powered and not opened.exchange.closed:
            return
        gpib = opened.attributes[ResourceAttribute.interface_type] == InterfaceType.gpib
        lost = StatusCode.error_no_listeners if gpib else StatusCode.error_connection_lost
        self.handle_return_value(session, lost)

    def clear(self, session: VISASession) -> StatusCode:
        """Device clear."""
        opened = self._sessions[session]
        self._check_power(session, opened)
        opened.received.clear()
        opened.under_way.clear()
        opened.exchange.clear()
        return self.handle_return_value(session, StatusCode.success)

    def flush(self, session: VISASession, mask: constants.BufferOperation) -> StatusCode:
        """Throw away bytes that were received."""
        opened = self._sessions[session]
        if opened.stream:
            while opened.exchange.take() is not None:
                pass
        opened.received.clear()
        opened.under_way.clear()
        return self.handle_return_value(session, StatusCode.success)

    def read_stb(self, session: VISASession) -> tuple[int, StatusCode]:
        """Serial poll."""
        opened = self._sessions[session]
        self._check_power(session, opened)
        opened.exchange.pump()  # the instrument works on while it is polled
        return opened.exchange.serial_poll(), self.handle_return_value(session, StatusCode.success)

    def assert_trigger(self, session: VISASession, protocol: constants.TriggerProtocol) -> StatusCode:
        """Group execute trigger: the same as *TRG."""
        self.write(session, b"*TRG")
        return self.handle_return_value(session, StatusCode.success)

    def gpib_control_ren(self, session: VISASession, mode: constants.RENLineOperation) -> StatusCode:
        """Remote enable: accepted without effect."""
        return self.handle_return_value(session, StatusCode.success)

    # Attributes and events

    def get_attribute(self, session: Any, attribute: Any) -> tuple[Any, StatusCode]:
        """Value of an attribute of the session."""
        opened = self._sessions.get(session)
        if opened is None:
            raise pyvisa.errors.InvalidSession
        if attribute == ResourceAttribute.asrl_avalaible_number:
            opened.exchange.pump()
            while (answer := opened.exchange.take()) is not None:
                opened.arrive(answer)
            return len(opened.received), self.handle_return_value(session, StatusCode.success)
        if attribute not in opened.attributes:
            default = getattr(attributes.AttributesByID.get(attribute), "default", attributes.NotAvailable)
            if default is attributes.NotAvailable:
                self.handle_return_value(session, StatusCode.error_nonsupported_attribute)
            opened.attributes[attribute] = default
        return opened.attributes[attribute], self.handle_return_value(session, StatusCode.success)

    def set_attribute(self, session: Any, attribute: Any, attribute_state: Any) -> StatusCode:
        """Set an attribute of the session; the break state of a serial line sends a break."""
        opened = self._sessions[session]
        opened.attributes[attribute] = attribute_state
        if opened.serial and attribute == ResourceAttribute.asrl_break_state and attribute_state:
            self._send_break(opened)
        return self.handle_return_value(session, StatusCode.success)

    def enable_event(self, session: Any, event_type: Any, mechanism: Any, context: None = None) -> StatusCode:
        """Wait for service requests from now on; they are queued, no handler is called."""
        if event_type != EventType.service_request:
            return self.handle_return_value(session, StatusCode.error_invalid_event)
        if mechanism != EventMechanism.queue:
            return self.handle_return_value(session, StatusCode.error_nonsupported_mechanism)
        opened = self._sessions[session]
        if opened.stream:  # RS-232 has no service request
            return self.handle_return_value(session, StatusCode.error_invalid_event)
        opened.waits_for_service = True
        return self.handle_return_value(session, StatusCode.success)

    def wait_on_event(self, session: Any, in_event_type: Any, timeout: int) -> tuple[Any, Any, StatusCode]:
        """Wait until the instrument requests service, `timeout` ms of its clock at most."""
        opened = self._sessions[session]
        if not opened.waits_for_service:
            self.handle_return_value(session, StatusCode.error_not_enabled)
        self._check_power(session, opened)
        seconds = math.inf if timeout == constants.VI_TMO_INFINITE else timeout / 1000
        if not opened.exchange.wait_for_service(seconds):
            self.handle_return_value(session, StatusCode.error_timeout)
        context = next(self._numbers)
        return EventType.service_request, context, self.handle_return_value(session, StatusCode.success)

    def disable_event(self, session: Any, event_type: Any, mechanism: Any) -> StatusCode:
        """Wait for nothing any more."""
        if session in self._sessions:
            self._sessions[session].waits_for_service = False
        return self.handle_return_value(None, StatusCode.success)

    def discard_events(self, session: Any, event_type: Any, mechanism: Any) -> StatusCode:
        """Forget a request that nobody has waited for; the status byte still tells it."""
        if session in self._sessions:
            self._sessions[session].exchange.requests_service()
        return self.handle_return_value(None, StatusCode.success)


def _attributes(name: str, parsed: rname.ResourceName, serial: bool) -> dict[int, Any]:
    """Attributes of a fresh session."""
    return {
        ResourceAttribute.timeout_value: 2000,
        ResourceAttribute.termchar: 0x0A,
        ResourceAttribute.termchar_enabled: False,
        ResourceAttribute.suppress_end_enabled: False,
        ResourceAttribute.send_end_enabled: True,
        ResourceAttribute.interface_type: parsed.interface_type_const,
        ResourceAttribute.resource_class: parsed.resource_class,
        ResourceAttribute.resource_name: name,
        ResourceAttribute.interface_number: int(board)
        if (board := getattr(parsed, "board", "0")).isdigit()
        else 0,
        **({ResourceAttribute.asrl_end_in: SerialTermination.termination_char} if serial else {}),
    }


def _read_stream(opened: _Session, count: int) -> tuple[bytes, StatusCode]:
    clock = opened.exchange.scope.clock
    deadline = clock.now() + opened.seconds()
    ending = opened.ending_byte()
    while True:
        arrived = min(int((clock.now() - opened.free_at) / opened.byte_time), len(opened.under_way))
        if arrived > 0:
            opened.free_at += arrived * opened.byte_time
            opened.arrive(_cut(opened.under_way, arrived))
        at = opened.received.find(ending) if ending is not None else -1
        if 0 <= at < count:
            return _cut(opened.received, at + 1), StatusCode.success_termination_character_read
        if len(opened.received) >= count:
            return _cut(opened.received, count), StatusCode.success_max_count_read
        if opened.under_way:
            if clock.now() >= deadline:
                opened.received.clear()
                return b"", StatusCode.error_timeout
            at = opened.under_way.find(ending) if ending is not None else -1
            wanted = min(count - len(opened.received), len(opened.under_way))
            arrives = opened.free_at + (wanted if at < 0 else min(wanted, at + 1)) * opened.byte_time
            clock.sleep(min(deadline, arrives) - clock.now() + 1e-9)
            continue
        answer = opened.exchange.wait_for_answer(deadline - clock.now())
        if answer is None:
            opened.received.clear()
            return b"", StatusCode.error_timeout
        if opened.serial and clock.virtual:
            opened.free_at = clock.now()
            opened.under_way += answer
        else:
            opened.arrive(answer)


def _read_message(opened: _Session, count: int) -> tuple[bytes, StatusCode]:
    answer = opened.exchange.wait_for_answer(opened.seconds())
    if answer is None:
        return b"", StatusCode.error_timeout
    ending = opened.ending_byte()
    at = answer.find(ending, 0, count) if ending is not None else -1
    taken = min(count, len(answer)) if at < 0 else at + 1
    if taken < len(answer):
        opened.exchange.put_back(answer[taken:])
    if at >= 0:
        return answer[:taken], StatusCode.success_termination_character_read
    more = taken < len(answer)
    return answer[:taken], StatusCode.success_max_count_read if more else StatusCode.success


def _cut(buffer: bytearray, count: int) -> bytes:
    data = bytes(buffer[:count])
    del buffer[:count]
    return data
