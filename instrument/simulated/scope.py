"""The simulated oscilloscope: a program message goes in, an answer comes out, time passes on a clock."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache

from instrument.simulated.clock import Clock, RealClock
from instrument.simulated.commands.action import Action, all_actions, one_argument
from instrument.simulated.commands.command_tree import CommandTree, Node
from instrument.simulated.commands.reference import empty_reference
from instrument.simulated.commands.waveform import data_init
from instrument.simulated.faults import Faults
from instrument.simulated.files.mass_storage import MassStorage
from instrument.simulated.front_end.acquisition import Acquisition
from instrument.simulated.front_end.digitizer import Digitizer
from instrument.simulated.front_end.frontend import Signal
from instrument.simulated.front_end.math_waveform import combine, multiply, spectrum, visible_part
from instrument.simulated.front_end.traces import Trace, channel_trace
from instrument.simulated.panel import panel_rules
from instrument.simulated.panel.event_table import Guess, Refusal, status_bit
from instrument.simulated.panel.formats import Leaf, join_leaves
from instrument.simulated.panel.kinds import Value
from instrument.simulated.panel.math_expression import operands
from instrument.simulated.panel.models import Model, find_model
from instrument.simulated.panel.panel import Panel
from instrument.simulated.panel.parsing import Argument, Command, Malformed, parse_message
from instrument.simulated.panel.settings_table import Row, setting_rows
from instrument.simulated.panel.status import Status

MESSAGE_TIME = 0.02  # s, on a virtual clock (a guess: 20 to 100 ms on GPIB)


@lru_cache(maxsize=32)
def _command_set(model: Model) -> tuple[CommandTree, Mapping[str, Action]]:
    actions = all_actions(model)
    return CommandTree(setting_rows(model), actions), actions


class Picture(bytes):
    """An answer that no terminator follows."""


class SimulatedTDS2014:
    """A TDS2014, or another model of its family, with signals at its inputs.

    Parameters
    ----------
    signals : mapping of int to callable
        By channel number, a function of absolute times in s (n,) that gives volts (n,) at the BNC. Key 0 is
        the EXT TRIG input. A channel without a signal sees 0 V.
    model : str
        `"TDS2014"`, or another name in `models.MODELS`.
    clock : Clock, optional
        RealClock() if not given. On a VirtualClock waiting costs no time.
    noise_levels : float
        Standard deviation of the noise in converter levels (1/25 division).
    seed : int
        Seeds noise and trigger jitter. Same seed, messages and virtual times: same codes.
    faults : Faults, optional
        What shall go wrong.
    identity : str, optional
        Another answer to `*IDN?`.
    message_time : float, optional
        Time in s that carrying out a message takes at least. If not given, 20 ms on a virtual clock, so that a
        program that asks again and again sees time pass, and nothing on a real one.

    Notes
    -----
    Messages are exchanged through `exchange.MessageExchange`, the in-process VISA library, or a server. All
    methods are to be called with `lock` held when several threads use one instrument.
    """

    def __init__(
        self,
        signals: Mapping[int, Signal] | None = None,
        *,
        model: str = "TDS2014",
        clock: Clock | None = None,
        noise_levels: float = 0.4,
        seed: int = 0,
        faults: Faults | None = None,
        identity: str | None = None,
        message_time: float | None = None,
    ) -> None:
        self.model = find_model(model)
        self._identity = identity if identity is not None else self.model.identity
        self.clock: Clock = clock if clock is not None else RealClock()
        self.faults: Faults = faults if faults is not None else Faults()
        default_time = MESSAGE_TIME if self.clock.virtual else 0.0
        self._message_time = default_time if message_time is None else message_time
        self.lock = threading.RLock()
        self.panel = Panel(self.model)
        self.status: Status = Status()
        self.acquisition: Acquisition = Acquisition(self.panel, signals or {}, self.clock, self.faults, seed)
        self.digitizer = Digitizer(self.acquisition.signal, noise_levels, seed)
        self.references = {name: empty_reference(name) for name in self.model.reference_names}
        self.setups: dict[int, dict[str, Value]] = {}
        self.storage: MassStorage = MassStorage()  # of models that have one
        self.clock_offset: float = 0.0  # s that DATE and TIMe moved the clock
        self.trigger_message: bytes = b""  # *DDT
        self.picture: bytes = b""  # of a hard copy, on its way out
        self.completion_wanted = False  # *OPC was sent and waits for the end of the operation
        self.message_available = False
        self.powered = True
        self._tree, self._actions = _command_set(self.model)

    @property
    def identity(self) -> str:
        """What `*IDN?` answers."""
        return self.faults.identity or self._identity

    # Program messages

    def execute(self, message: bytes, *, stream: bool = False) -> Iterator[bytes | None]:
        """Carry out one program message; `stream` tells that it came without a message end.

        Yields
        ------
        None
            As often as the instrument has to wait; go on when the clock has moved.
        bytes
            At the end, the answer without terminator, if there is one.
        """
        self.clock.sleep(self._message_time)
        branch = self._tree.root
        leaves: list[list[Leaf]] = []
        identified = False
        unread = len(message)
        deadlocked = False
        for command in parse_message(message, stream=stream):
            unread -= len(command.source) + 1
            try:
                if isinstance(command, Malformed):
                    raise Refusal(command.event)
                node = self._find(command, branch)
                if not command.header.startswith("*"):
                    branch = node.parent or self._tree.root
                action = self._actions.get(node.action) if node.action else None
                while self._waits(command, action) or self._stops_too_early(command, node):
                    yield None
                if identified and command.query:
                    raise Refusal(440)
                self.settle()
                if command.query:
                    if hand := self.faults.hand(command.source.encode("latin-1")):
                        self.turn_knob(hand)
                    answer = self._answer(node, action, command)
                    identified = bool(action and action.ends_message)
                    if not deadlocked:
                        leaves.append(answer)
                    if not stream and unread > Guess.INPUT_BUFFER and self._fills_output(leaves):
                        deadlocked = True
                        leaves.clear()
                        raise Refusal(430)
                else:
                    self._carry_out(node, action, command.arguments)
            except Refusal as refusal:
                self.status.post(refusal.event, command.source)
                if status_bit(refusal.event) == Guess.DROPS_REST_OF_MESSAGE:
                    break
        if leaves:
            yield self._render(leaves)
        if self.picture:
            picture, self.picture = self.picture, b""
            yield Picture(picture)

    def _fills_output(self, answers: list[list[Leaf]]) -> bool:
        """True when the answers so far leave no room in the output queue: nobody can read or write (430)."""
        return sum(len(value) for leaves in answers for _, value in leaves) > Guess.OUTPUT_QUEUE

    def _find(self, command: Command, branch: Node) -> Node:
        """The node of a header: from the root if absolute, else from the branch of the command before."""
        root = self._tree.root
        from_root = command.absolute or command.header.startswith("*")
        node = (root if from_root else branch).find(command.header.lstrip(":"))
        if node is None or node is root:
            raise Refusal(Guess.UNKNOWN_HEADER)
        return node

    def _waits(self, command: Command, action: Action | None) -> bool:
        """True while a query (or an order that is no query) has to wait for the acquisition."""
        if action is None or action.waits is None or (action.query is not None and not command.query):
            return False
        return action.waits(self)

    def _stops_too_early(self, command: Command, node: Node) -> bool:
        """True for an order to stop before there ever was a record: a real unit has long been running by then."""
        stops = node.row is not None and node.row.header == "ACQuire:STATE" and not command.query
        return stops and self.acquisition.record is None and self.awaits_record()

    def _answer(self, node: Node, action: Action | None, command: Command) -> list[Leaf]:
        if command.arguments:
            raise Refusal(Guess.QUERY_WITH_ARGUMENT)
        if action is not None and action.query is not None:
            return action.query(self)
        rows = [node.row] if node.row is not None else self._tree.rows_below(node)
        if not rows:
            raise Refusal(Guess.COMMAND_HAS_NO_QUERY)
        return self.leaves(rows)

    def _carry_out(self, node: Node, action: Action | None, arguments: tuple[Argument, ...]) -> None:
        if action is not None and action.order is not None:
            action.order(self, arguments)
        elif node.row is not None:
            self.set(node.row.header.upper(), node.row.kind.read(one_argument(arguments)))
        else:
            raise Refusal(Guess.QUERY_HAS_NO_COMMAND)

    def rows_below(self, branch: str) -> list[Row]:
        """Settings of a branch, in the order of the table."""
        node = self._tree.root.find(branch)
        return self._tree.rows_below(node) if node is not None else []

    def leaves(self, rows: list[Row]) -> list[Leaf]:
        """Headers and values of settings."""
        verbose = self.panel.flag("VERBOSE")
        return [
            (tuple(row.header.split(":")), row.kind.write(self.panel.values[row.header.upper()], verbose))
            for row in rows
        ]

    def _render(self, answers: list[list[Leaf]]) -> bytes:
        header, verbose = self.panel.flag("HEADER"), self.panel.flag("VERBOSE")
        parts = (join_leaves(leaves, header=header, verbose=verbose) for leaves in answers)
        return ";".join(parts).encode("latin-1")

    # What commands do

    def turn_knob(self, command: str) -> None:
        """What somebody at the front panel does, as a program message; nothing while it is locked."""
        if self.panel.text("LOCK") == "NONE":
            for _ in self.execute(command.encode("latin-1")):
                pass

    def set(self, key: str, value: Value) -> None:
        """Change a setting as a command or a hand on the front panel would."""
        self.acquisition.update()
        if key == "ACQUIRE:STATE":
            if value:
                self.panel.values[key] = 1
                self.acquisition.restart()
            else:
                self.acquisition.stop()
            return
        before = dict(self.panel.values)
        panel_rules.store(self.panel, key, value)
        if self.panel.values != before and panel_rules.restarts(key):
            self.acquisition.restart()

    def busy(self) -> bool:
        """True while a single sequence is under way."""
        self.acquisition.update()
        return self.faults.stuck_busy or self.acquisition.single

    def awaits_record(self) -> bool:
        """True while the first record with the present channels is on its way (a guess: the unit waits)."""
        self.acquisition.update()
        return self.acquisition.awaited

    def settle(self) -> None:
        """Post the completion that *OPC asked for, once it is there."""
        if self.completion_wanted and not self.busy():
            self.completion_wanted = False
            self.status.post(402)

    def status_byte(self) -> int:
        """What `*STB?` and a serial poll give."""
        self.settle()
        return self.status.status_byte(message_available=self.message_available)

    def trace(self, name: str) -> Trace | None:
        """What stands on the screen under a name; None if it is not displayed."""
        if name not in self.panel.displayed:
            return None
        if name in self.references:
            return self.references[name]
        if name == "MATH":
            return self._math_trace()
        return self._channel_trace(name)

    def _channel_trace(self, name: str) -> Trace:
        record = self.acquisition.latest()
        channel = record.channels.get(name, self.panel.channel(name))
        codes = self.digitizer.codes(record, name)
        return channel_trace(record, name, codes, channel, self._unit(name))

    def _math_trace(self) -> Trace:
        expression = self.panel.text("MATH:DEFINE")
        sources = [self._channel_trace(name) for name in operands(expression)]
        if "*" in expression:
            vertical = "MATH:VERTICAL"
            scale, position = self.panel.number(f"{vertical}:SCALE"), self.panel.number(f"{vertical}:POSITION")
            return multiply(sources[0], sources[1], scale, position)
        if len(sources) == 2:
            return combine(expression, *sources)
        zoom = self.panel.number("MATH:FFT:VERTICAL:SCALE")
        position = self.panel.number("MATH:FFT:VERTICAL:POSITION")
        return spectrum(expression, sources[0], zoom, position, self.panel.number("MATH:FFT:HORIZONTAL:SCALE"))

    def screen_traces(self) -> dict[str, Trace]:
        """What the screen shows; of a spectrum only the part that is zoomed in."""
        traces = {name: self.trace(name) for name in self.model.waveform_names}
        shown = {name: trace for name, trace in traces.items() if trace is not None}
        if "MATH" in shown and shown["MATH"].xunit == "Hz":
            zoom, position = "MATH:FFT:HORIZONTAL:SCALE", "MATH:FFT:HORIZONTAL:POSITION"
            part = visible_part(self.panel.number(zoom), self.panel.number(position))
            shown["MATH"] = replace(shown["MATH"], codes=shown["MATH"].codes[part])
        return shown

    def _unit(self, name: str) -> str:
        ampere = self.model.letter_series and self.panel.text(f"{name}:YUNIT") == "A"
        return "A" if ampere else "Volts"

    def reset(self) -> None:
        """`*RST`: factory settings; header, masks, links and stored data stay."""
        self.panel.factory()
        self.acquisition.restart()

    def factory(self) -> None:
        """`FACtory`: `*RST`, and header, masks and DATa as at the factory."""
        self.reset()
        self.panel.values["HEADER"] = 1
        self.status.esr_mask, self.status.service_mask, self.status.device_mask = 0, 0, 255
        self.status.clear_masks_at_power_on = True
        self.completion_wanted = False
        data_init(self)

    # Power

    def power_off(self) -> None:
        """Switch off: links close and nothing answers."""
        self.powered = False

    def power_on(self) -> None:
        """Switch on again: settings are kept, events and records are not."""
        self.powered = True
        self.completion_wanted = False
        self.status.power_on()
        self.panel.values["ACQUIRE:STATE"] = 1
        self.acquisition.record = None
        self.acquisition.restart()
