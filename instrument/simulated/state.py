"""The state of the simulated oscilloscope: everything that a command reads or changes, and what its parts do."""

import fnmatch
import re
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import replace

from instrument.simulated.clock import Clock, HeldClock, RealClock
from instrument.simulated.faults import Faults
from instrument.simulated.front_end.acquisition import AcquisitionSystem, Digitizer
from instrument.simulated.front_end.frontend import Signal
from instrument.simulated.front_end.traces import (
    Trace,
    channel_trace,
    combine,
    empty_reference,
    multiply,
    spectrum,
    visible_part,
)
from instrument.simulated.panel.events import Guess, Refusal, Status
from instrument.simulated.panel.models import find_model
from instrument.simulated.panel.panel import RESTARTING, Panel, restarts, store
from instrument.simulated.panel.parsing import Leaf
from instrument.simulated.panel.settings import Row, Value, operands

MESSAGE_TIME = 0.02  # s, on a virtual clock (a guess: 20 to 100 ms on GPIB)
_DATA_SETTINGS = ("ENCDG", "DESTINATION", "SOURCE", "START", "STOP", "WIDTH")


class ScopeState(ABC):
    """What the commands act on; the parameters are those of `scope.SimulatedTDS2014`."""

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
        if identity is not None:
            self.model = replace(self.model, identity=identity)
        self._identity = self.model.identity
        self.clock: Clock = clock if clock is not None else RealClock()
        self.faults: Faults = faults if faults is not None else Faults()
        default_time = MESSAGE_TIME if self.clock.virtual else 0.0
        self.message_time = default_time if message_time is None else message_time
        self.lock = threading.RLock()
        self.panel = Panel(self.model)
        self.status: Status = Status()
        self.message_clock = HeldClock(self.clock)
        self.acquisition: AcquisitionSystem = AcquisitionSystem(
            self.panel, signals or {}, self.message_clock, self.faults, seed
        )
        self.digitizer = Digitizer(self.acquisition.signal, noise_levels, seed)
        self.references = {name: empty_reference(name) for name in self.model.reference_names}
        self.setups: dict[int, dict[str, Value]] = {}
        self.storage: MassStorage = MassStorage()  # of models that have one
        self.clock_offset: float = 0.0  # s that DATE and TIMe moved the clock
        self.trigger_message: bytes = b""  # *DDT
        self.picture: bytes = b""  # of a hard copy, on its way out
        self.autoset_found: str = "NONE"  # the kind of signal that the last autoset saw
        self.completion_wanted = False  # *OPC was sent and waits for the end of the operation
        self.message_available = False
        self.powered = True

    @property
    def identity(self) -> str:
        """What `*IDN?` answers."""
        return self.faults.identity or self._identity

    @abstractmethod
    def execute(self, message: bytes, *, stream: bool = False) -> Iterator[bytes | None]:
        """Carry out a program message: how, the scope knows. Some commands hold one (`*TRG`, recalled setups)."""

    def rows_below(self, branch: str) -> list[Row]:
        """Settings that a branch query answers, in the order of the table."""
        rows = self.panel.rows.values()
        return [row for row in rows if row.in_branch and row.header.startswith(f"{branch}:")]

    def leaves(self, rows: list[Row]) -> list[Leaf]:
        """Headers and values of settings."""
        verbose = self.panel.flag("VERBOSE")
        return [
            (tuple(row.header.split(":")), row.kind.write(self.panel.values[row.header.upper()], verbose))
            for row in rows
        ]

    def set(self, key: str, value: Value) -> None:
        """Change a setting as a command or a hand on the front panel would."""
        self.acquisition.update()
        if key.startswith(RESTARTING):
            self.acquisition.settle()
        if key == "ACQUIRE:STATE":
            if value:
                self.panel.values[key] = 1
                self.acquisition.restart()
            else:
                self.acquisition.stop()
            return
        before = dict(self.panel.values)
        store(self.panel, key, value)
        averages = self.panel.text("ACQUIRE:MODE") == "AVERAGE"
        if self.panel.values != before and restarts(key, averages=averages):
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
        return self._channel_trace(name)

    def _channel_trace(self, name: str) -> Trace:
        record = self.acquisition.latest()
        channel = record.channels.get(name, self.panel.channel(name))
        codes = self.digitizer.codes(record, name)
        ampere = self.model.letter_series and self.panel.text(f"{name}:YUNIT") == "A"
        return channel_trace(record, name, codes, channel, "A" if ampere else "Volts")

    def screen_traces(self) -> dict[str, Trace]:
        """What the screen shows; of a spectrum only the part that is zoomed in."""
        traces = {name: self.trace(name) for name in self.model.waveform_names}
        shown = {name: trace for name, trace in traces.items() if trace is not None}
        if "MATH" in shown and shown["MATH"].xunit == "Hz":
            zoom, position = "MATH:FFT:HORIZONTAL:SCALE", "MATH:FFT:HORIZONTAL:POSITION"
            part = visible_part(self.panel.number(zoom), self.panel.number(position))
            shown["MATH"] = replace(shown["MATH"], codes=shown["MATH"].codes[part])
        return shown

    def reset(self) -> None:
        """`*RST`: factory settings and a new record; header, masks, links and stored data stay."""
        self.panel.factory()
        self.acquisition.record = None
        self.acquisition.restart()

    def factory(self) -> None:
        """`FACtory`: `*RST`, and header, masks and DATa as at the factory."""
        self.reset()
        self.panel.values["HEADER"] = 1
        self.status.esr_mask, self.status.service_mask, self.status.device_mask = 0, 0, 255
        self.status.clear_masks_at_power_on = True
        self.completion_wanted = False
        self.data_init()

    def data_init(self) -> None:
        """DATa settings as at the factory."""
        for leaf in _DATA_SETTINGS:
            self.panel.values[f"DATA:{leaf}"] = self.panel.rows[f"DATA:{leaf}"].default

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


# --------------------
# The memory card or USB stick of later models and of the TDS2MEM module: files and folders on drive A:.
#
# Names are those of DOS: eight characters, a point and three, in capitals. Source: programmer manual 071-1075-04,
# file system commands and events 251 to 258


ROOT = "A:\\"
CAPACITY = 32 * 1024 * 1024  # bytes
_NAME = re.compile(r"[A-Z0-9_$~!#%&'()@^{}-]{1,8}(\.[A-Z0-9_$~!#%&'()@^{}-]{0,3})?")
_NOT_FOUND, _BAD_NAME, _FULL, _NO_MEDIUM = 256, 257, 254, 252


class MassStorage:
    r"""Files by their whole path, such as ``A:\\ALL0000\\F0000CH1.CSV``."""

    def __init__(self) -> None:
        self.present = True
        self.format()

    def format(self) -> None:
        """Empty it."""
        self._check_present()
        self.files: dict[str, bytes] = {}
        self.folders = {ROOT}
        self.folder = ROOT

    @property
    def free(self) -> int:
        """Bytes that are left."""
        self._check_present()
        return CAPACITY - sum(map(len, self.files.values()))

    def path(self, name: str) -> str:
        """The whole path of a name; Refusal if it cannot be one, or its folder is missing."""
        self._check_present()
        wanted = name.strip().upper().replace("/", "\\")
        if wanted.startswith("\\"):
            wanted = "A:" + wanted
        wanted = wanted if wanted.startswith("A:") else self.folder + wanted
        parts: list[str] = []
        for part in wanted.removeprefix("A:").split("\\"):
            if part == "..":
                parts = parts[:-1]
            elif part not in ("", "."):
                if not _NAME.fullmatch(part.replace("*", "X").replace("?", "X")[:12]) or len(part) > 12:
                    raise Refusal(_BAD_NAME)
                parts.append(part)
        folder = ROOT + "".join(f"{part}\\" for part in parts[:-1])
        if folder not in self.folders:
            raise Refusal(_NOT_FOUND)
        return folder + (parts[-1] if parts else "")

    def write(self, name: str, content: bytes) -> None:
        """Store a file, over one of the same name."""
        path = self.path(name)
        if path == ROOT or f"{path}\\" in self.folders or "*" in path or "?" in path:
            raise Refusal(_BAD_NAME)
        if len(content) - len(self.files.get(path, b"")) > self.free:
            raise Refusal(_FULL)
        self.files[path] = content

    def read(self, name: str) -> bytes:
        """Content of a file."""
        path = self.path(name)
        if path not in self.files:
            raise Refusal(_NOT_FOUND)
        return self.files[path]

    def delete(self, name: str) -> None:
        """Delete the files that a name, perhaps with ``*`` and ``?``, fits."""
        pattern = self.path(name)
        pattern = pattern[:-2] if pattern.endswith("*.*") else pattern
        depth = pattern.count("\\")
        found = [path for path in self.files if fnmatch.fnmatchcase(path, pattern) and path.count("\\") == depth]
        if not found:
            raise Refusal(_NOT_FOUND)
        for path in found:
            del self.files[path]

    def rename(self, old: str, new: str) -> None:
        """Give a file another name or folder."""
        content, target = self.read(old), self.path(new)
        if target in self.files or f"{target}\\" in self.folders:
            raise Refusal(_BAD_NAME)
        del self.files[self.path(old)]
        self.write(new, content)

    def make_folder(self, name: str) -> None:
        """Make a folder in one that exists."""
        path = self.path(name)
        if f"{path}\\" in self.folders or path in self.files or path == ROOT:
            raise Refusal(_BAD_NAME)
        self.folders.add(f"{path}\\")

    def remove_folder(self, name: str) -> None:
        """Remove an empty folder."""
        path = self._folder(name)
        if path == ROOT or any(other != path and other.startswith(path) for other in (*self.files, *self.folders)):
            raise Refusal(Guess.FOLDER_NOT_EMPTY)
        self.folders.discard(path)

    def change_folder(self, name: str) -> None:
        """Look up names without a path there from now on."""
        self.folder = self._folder(name)

    def listing(self) -> list[str]:
        """Names of files and folders in the present folder, in order."""
        self._check_present()
        inside = [path.removeprefix(self.folder).rstrip("\\") for path in (*self.files, *self.folders)
                  if path.startswith(self.folder) and path != self.folder]  # fmt: skip
        return sorted(name for name in inside if "\\" not in name)

    def _folder(self, name: str) -> str:
        path = self.path(name)
        path = path if path.endswith("\\") else f"{path}\\"
        if path not in self.folders:
            raise Refusal(_NOT_FOUND)
        return path

    def _check_present(self) -> None:
        if not self.present:
            raise Refusal(_NO_MEDIUM)
