"""The simulated oscilloscope: a program message goes in, an answer comes out, time passes on a clock."""

from collections.abc import Iterator, Mapping
from functools import lru_cache

from instrument.simulated.commands import acquisition, files, setup_status, waveform
from instrument.simulated.commands.tree import Action, CommandTree, Node, one_argument
from instrument.simulated.panel.events import Guess, Refusal, status_bit
from instrument.simulated.panel.models import Model
from instrument.simulated.panel.parsing import Argument, Command, Leaf, Malformed, join_leaves, parse_message
from instrument.simulated.panel.settings import setting_rows
from instrument.simulated.state import ScopeState


class Picture(bytes):
    """An answer that no terminator follows."""


class _UnknownHeader(Refusal):
    """Its own command is lost, the rest of the message is not: setups of other models are to be recalled."""


class SimulatedTDS2014(ScopeState):
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

    @property
    def _tree(self) -> CommandTree:
        return command_set(self.model)[0]

    @property
    def _actions(self) -> Mapping[str, Action]:
        return command_set(self.model)[1]

    def execute(self, message: bytes, *, stream: bool = False) -> Iterator[bytes | None]:
        """Carry out one program message; `stream` tells that it came without a message end."""
        self.clock.sleep(self.message_time)
        self.message_clock.hold()  # a busy computer makes no difference to what happens within a message
        try:
            yield from self._execute(message, stream)
        finally:
            self.message_clock.release()

    def _execute(self, message: bytes, stream: bool) -> Iterator[bytes | None]:
        branch = self._tree.root
        answers: list[str] = []
        identified = False
        unread = len(message)
        deadlocked, queued = False, 0
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
                    yield from self._time_passes()
                if identified and command.query:
                    raise Refusal(440)
                self.settle()
                if command.query:
                    if hand := self.faults.hand(command.source.encode("latin-1")):
                        self.turn_knob(hand)
                    answer = self._answer(node, action, command)
                    identified = bool(action and action.ends_message)
                    if deadlocked:
                        continue
                    answers.append(
                        join_leaves(answer, header=self.panel.flag("HEADER"), verbose=self.panel.flag("VERBOSE"))
                    )
                    queued += sum(len(value) for _, value in answer)
                    if not stream and unread > Guess.INPUT_BUFFER and queued > Guess.OUTPUT_QUEUE:
                        deadlocked = True  # nobody can read or write any more
                        answers.clear()
                        raise Refusal(430)
                else:
                    for step in self._carry_out(node, action, command.arguments):
                        if step is None:
                            yield from self._time_passes()
            except Refusal as refusal:
                self.status.post(refusal.event, command.source)
                if isinstance(refusal, _UnknownHeader):
                    branch = self._branch_behind(command, branch)
                elif status_bit(refusal.event) == Guess.DROPS_REST_OF_MESSAGE:
                    break
        if answers:
            yield ";".join(answers).encode("latin-1")
        if self.picture:
            picture, self.picture = self.picture, b""
            yield Picture(picture)

    def _time_passes(self) -> Iterator[None]:
        """Wait for the clock to move."""
        self.message_clock.release()
        try:
            yield None
        finally:
            self.message_clock.hold()

    def _branch_behind(self, command: Command | Malformed, branch: Node) -> Node:
        """Where relative headers stand behind an unknown one: in its branch, which may be unknown, too."""
        path = command.source.split(" ")[0].rstrip("?").upper().rpartition(":")[0]
        if not path.strip(":"):
            return self._tree.root if path or command.source.startswith(":") else branch
        start = self._tree.root if path.startswith(":") else branch
        return start.find(path.lstrip(":")) or Node()

    def _find(self, command: Command, branch: Node) -> Node:
        """The node of a header: from the root if absolute, else from the branch of the command before."""
        root = self._tree.root
        from_root = command.absolute or command.header.startswith("*")
        node = (root if from_root else branch).find(command.header.lstrip(":"))
        if node is None or node is root:
            raise _UnknownHeader(Guess.UNKNOWN_HEADER)
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

    def _carry_out(
        self, node: Node, action: Action | None, arguments: tuple[Argument, ...]
    ) -> Iterator[bytes | None]:
        """Act; gives the steps of an order that holds a message of its own (a recalled setup, *TRG)."""
        if action is not None and action.order is not None:
            return action.order(self, arguments) or iter(())
        elif node.row is not None:
            self.set(node.row.header.upper(), node.row.kind.read(one_argument(arguments)))
        else:
            raise Refusal(Guess.QUERY_HAS_NO_COMMAND)
        return iter(())

    def turn_knob(self, command: str) -> None:
        """What somebody at the front panel does, as a program message; nothing while it is locked."""
        if self.panel.text("LOCK") == "NONE":
            for step in self.execute(command.encode("latin-1")):
                if step is None:  # it would have to wait, and no knob does
                    break


# --------------------
# All commands of a model: the tree of their headers and what they do


@lru_cache(maxsize=32)
def command_set(model: Model) -> tuple[CommandTree, Mapping[str, Action]]:
    """The headers of a model, and by its header every action that is more than a stored setting."""
    actions = {
        **setup_status.STATUS_ACTIONS,
        **acquisition.ACQUISITION_ACTIONS,
        **setup_status.SETUP_ACTIONS,
        **acquisition.CURSOR_ACTIONS,
        **setup_status.HARD_COPY_ACTIONS,
        **waveform.actions(model),
        **acquisition.actions(model),
        **(files.ACTIONS if model.has_storage else {}),
    }
    return CommandTree(setting_rows(model), actions), actions
