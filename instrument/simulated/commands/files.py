"""Files on the memory card or USB stick, and the clock that dates them: FILESystem, SAVe, RECAll, DATE and TIMe.

Only models with mass storage have them. Source: programmer manual 071-1075-04, chapter 2.
"""

from collections.abc import Callable, Iterator
from dataclasses import fields
from datetime import datetime, timedelta

from instrument.errors import FileFormatError, TransferError
from instrument.simulated.commands import waveform as reference_commands
from instrument.simulated.commands.setup_status import recall_setup, save, setup_file
from instrument.simulated.commands.tree import Action, Order, answer, one_argument, one_string, plain
from instrument.simulated.front_end.traces import Trace
from instrument.simulated.panel.events import Guess, Refusal
from instrument.simulated.panel.parsing import Argument, Leaf, quoted
from instrument.simulated.panel.settings import Words
from instrument.simulated.pictures import FORMATS, csv_file, draw
from instrument.simulated.state import MassStorage, ScopeState
from instrument.tek_files import parse_csv

_BEGINNING = datetime(2006, 4, 21, 8, 0)  # what the clock shows when the instrument begins to live
_DATE, _TIME = "%Y-%m-%d", "%H:%M:%S"


def _now(state: ScopeState) -> datetime:
    return _BEGINNING + timedelta(seconds=state.clock.now() + state.clock_offset)


def _set_clock(form: str) -> Order:
    """DATE keeps the time of day, TIMe the date."""

    def order(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
        now = _now(state)
        try:
            wanted = datetime.strptime(one_string(arguments).strip(), form)
        except ValueError:
            raise Refusal(Guess.DATE_IS_NONE) from None
        date, time = (wanted.date(), now.time()) if form == _DATE else (now.date(), wanted.time())
        state.clock_offset += (datetime.combine(date, time) - now).total_seconds()

    return order


def _on_one_name(act: Callable[[MassStorage, str], None]) -> Order:
    return lambda state, arguments: act(state.storage, one_string(arguments))


def _rename(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    if len(arguments) != 2:
        raise Refusal(Guess.SURPLUS_ARGUMENT if len(arguments) > 2 else Guess.MISSING_ARGUMENT)
    state.storage.rename(*(one_string((argument,)) for argument in arguments))


def _file_system(state: ScopeState) -> list[Leaf]:
    storage = state.storage
    return [(("FILESystem", "CWD"), quoted(storage.folder)), (("FILESystem", "FREESpace"), str(storage.free))]


def _save_image(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    name = one_string(arguments)
    write = FORMATS.get(state.panel.text("SAVE:IMAGE:FILEFORMAT"))
    if write is None:
        raise Refusal(Guess.PICTURE_FORMAT_NOT_SIMULATED)
    state.storage.write(name, write(draw(state.screen_traces())))


def _save_setup(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    if one_argument(arguments).quoted:
        state.storage.write(arguments[0].text, f"{setup_file(state)}\n".encode("latin-1"))
    else:
        save(state, arguments)


def _recall_setup(state: ScopeState, arguments: tuple[Argument, ...]) -> Iterator[bytes | None] | None:
    if not one_argument(arguments).quoted:
        recall_setup(state, arguments)
        return None
    content = state.storage.read(arguments[0].text).strip()
    if not content.startswith(b":"):
        raise Refusal(Guess.FILE_IS_NO_SETUP)
    return state.execute(content)


def _save_waveform(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    if len(arguments) != 2 or not arguments[1].quoted:
        reference_commands.save_waveform(state, arguments)
        return
    source = Words(*state.model.waveform_names).read(arguments[0])
    trace = state.trace(source)
    if trace is None:
        raise Refusal(2245)
    probe = state.panel.number(f"{source if source.startswith('CH') else 'CH1'}:PROBE")
    _, name, serial, rest = (*state.identity.split(",", 3), "", "", "", "")[:4]
    firmware = "FV:" + rest.rpartition("FV:")[2].split(" ")[0]
    later = {"Model Number": name.replace(" ", ""), "Serial Number": serial} if state.model.letter_series else {}
    state.storage.write(arguments[1].text, csv_file(trace, source, probe, {**later, "Firmware Version": firmware}))


def _recall_waveform(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
    """RECAll:WAVEform <file>,REF<x>."""
    if len(arguments) != 2:
        raise Refusal(Guess.SURPLUS_ARGUMENT if len(arguments) > 2 else Guess.MISSING_ARGUMENT)
    content = state.storage.read(one_string(arguments[:1]))
    target = Words(*state.model.reference_names).read(arguments[1])
    try:
        waveform = parse_csv(content.decode("ascii", errors="replace"))
    except (FileFormatError, TransferError):
        raise Refusal(Guess.FILE_IS_NO_WAVEFORM) from None
    read = {one.name: getattr(waveform.preamble, one.name) for one in fields(Trace)[1:]}
    read["wfid"] = f"Ref{target[-1]},{read['wfid'].partition(',')[2]}"
    state.references[target] = Trace(waveform.codes.astype("int8"), **read)


def _awaited(state: ScopeState) -> bool:
    return state.awaits_record()


ACTIONS = {
    "DATE": Action(answer("DATE", lambda state: quoted(_now(state).strftime(_DATE))), _set_clock(_DATE)),
    "TIMe": Action(answer("TIMe", lambda state: quoted(_now(state).strftime(_TIME))), _set_clock(_TIME)),
    "FILESystem": Action(_file_system),
    "FILESystem:CWD": Action(
        answer("FILESystem:CWD", lambda state: quoted(state.storage.folder)),
        _on_one_name(lambda storage, name: storage.change_folder(name)),
    ),
    "FILESystem:DELEte": Action(order=_on_one_name(lambda storage, name: storage.delete(name))),
    "FILESystem:DIR": Action(
        answer("FILESystem:DIR", lambda state: ",".join(map(quoted, state.storage.listing())) or quoted(""))
    ),
    "FILESystem:FORMat": Action(order=plain(lambda state: state.storage.format())),
    "FILESystem:FREESpace": Action(answer("FILESystem:FREESpace", lambda state: str(state.storage.free))),
    "FILESystem:MKDir": Action(order=_on_one_name(lambda storage, name: storage.make_folder(name))),
    "FILESystem:REName": Action(order=_rename),
    "FILESystem:RMDir": Action(order=_on_one_name(lambda storage, name: storage.remove_folder(name))),
    "SAVe:IMAge": Action(order=_save_image, waits=_awaited),
    "SAVe:SETUp": Action(order=_save_setup),
    "SAVe:WAVEform": Action(order=_save_waveform, waits=_awaited),
    "RECAll:SETUp": Action(order=_recall_setup),
    "RECAll:WAVEform": Action(order=_recall_waveform),
}
