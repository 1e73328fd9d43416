"""The settings of the instrument: one row each, in the order in which `SET?` answers them.

A row gives the header as the manual spells it, the kind of value, the factory value, and the places where
this setting departs from the rule. Source: programmer manual 071-1075-04, chapter 2 and appendix B.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Protocol

from instrument.scpi import POINTS, TIME_BASES
from instrument.simulated.panel.events import Guess, Refusal
from instrument.simulated.panel.models import Model
from instrument.simulated.panel.parsing import Argument, abbreviations, nr3, quoted, spell

# --------------------
# The kinds of values that a setting can hold: how each is read, forced into range, and written.
#
# A number outside its range is silently forced to the nearest allowed value (programmer manual 071-1075-04,
# p. 2-12); a word that is not in the list is refused


Value = str | int | float


class Kind(Protocol):
    """How one setting's value is read from an argument and written into an answer."""

    def read(self, argument: Argument) -> Value:
        """Value of the argument, forced into range; raises Refusal."""

    def write(self, value: Value, verbose: bool) -> str:
        """The value as it stands in an answer."""


def number(argument: Argument) -> float:
    """Read NR1, NR2 or NR3; refuse anything else."""
    text = argument.text
    try:
        value = float(text) if not argument.quoted and "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise Refusal(Guess.NUMBER_EXPECTED)
    return value


def nearest(value: float, steps: Sequence[float]) -> float:
    """The step closest to a value; the lower one in the middle."""
    return min(steps, key=lambda step: abs(step - value))


@dataclass(frozen=True)
class Words:
    """One word of a list, spelled with capitals for its short form: `Words("SAMple", "AVErage")`."""

    words: tuple[str, ...]
    _spellings: dict[str, str] = field(init=False, repr=False, compare=False)

    def __init__(self, *words: str) -> None:
        spellings: dict[str, str] = {}
        for word in words:
            for spelling in abbreviations(word):
                spellings.setdefault(spelling, word)
        object.__setattr__(self, "words", words)
        object.__setattr__(self, "_spellings", spellings)

    def read(self, argument: Argument) -> str:
        """The long form in capitals."""
        word = None if argument.quoted else self._spellings.get(argument.text.upper())
        if word is None:
            raise Refusal(Guess.UNKNOWN_WORD)
        return word.upper()

    def write(self, value: Value, verbose: bool) -> str:
        """Long form, or with VERBose off the short form."""
        return str(value) if verbose else spell(self._spellings[str(value)], verbose)


@dataclass(frozen=True, init=False)
class QuotedWords(Words):
    """One word of a list that travels in quotes, as the unit of a probe does."""

    def read(self, argument: Argument) -> str:
        """The word in capitals."""
        if not argument.quoted:
            raise Refusal(Guess.STRING_EXPECTED)
        return super().read(Argument(argument.text))

    def write(self, value: Value, verbose: bool) -> str:
        """In double quotes."""
        return quoted(super().write(value, verbose))


@dataclass(frozen=True)
class Switch:
    """ON, OFF or a number; `words` chooses whether it answers `ON`/`OFF` or `1`/`0`."""

    words: bool = False

    def read(self, argument: Argument) -> int:
        """1 for ON and any number that rounds to something else than zero."""
        word = argument.text.upper()
        if word in ("ON", "OFF") and not argument.quoted:
            return int(word == "ON")
        return int(round(number(argument)) != 0)

    def write(self, value: Value, verbose: bool) -> str:
        """`1` or `0`, `ON` or `OFF`."""
        return ("OFF", "ON")[int(value)] if self.words else str(int(value))


@dataclass(frozen=True)
class Whole:
    """A whole number in a range, answered as NR1."""

    low: int
    high: int

    def read(self, argument: Argument) -> int:
        """Rounded and forced into the range."""
        return round(min(max(number(argument), self.low), self.high))

    def write(self, value: Value, verbose: bool) -> str:
        """NR1."""
        return str(int(value))


@dataclass(frozen=True)
class Real:
    """A number in a range, in steps if `step` is given, answered as NR3."""

    low: float
    high: float
    step: float = 0.0
    digits: int = 7

    def read(self, argument: Argument) -> float:
        """Rounded to the step and forced into the range."""
        value = min(max(number(argument), self.low), self.high)
        if self.step:
            value = round(round(value / self.step) * self.step, 12)
        return float(f"{value:.{self.digits - 1}e}")

    def write(self, value: Value, verbose: bool) -> str:
        """NR3."""
        return nr3(float(value), self.digits)


@dataclass(frozen=True)
class PulseWidth(Real):
    """Multiples of 16.5 ns, and of 0.1 % where those are coarser, p. 2-232."""

    def read(self, argument: Argument) -> float:
        """The nearest multiple in the range."""
        value = super().read(argument)
        fine = max(value, self.low)
        step = max(self.low / 2, 10.0 ** math.floor(math.log10(fine)) / 1e4)
        return float(f"{round(fine / step) * step:.6e}")


@dataclass(frozen=True)
class Steps:
    """One of a list of numbers; others go to the nearest. `whole` answers NR1, else NR3."""

    steps: tuple[float, ...]
    whole: bool = False

    def read(self, argument: Argument) -> float:
        """The nearest step."""
        return nearest(number(argument), self.steps)

    def write(self, value: Value, verbose: bool) -> str:
        """NR1 or NR3."""
        return str(int(value)) if self.whole else nr3(float(value))


@dataclass(frozen=True)
class NumberedWords:
    """Words that stand for numbers, answered as the number: `PERSistence INF` answers 99."""

    words: tuple[tuple[str, int], ...]

    def read(self, argument: Argument) -> int:
        """Number of the word, or the nearest of the numbers."""
        for word, value in self.words:
            if argument.text.upper() in abbreviations(word) and not argument.quoted:
                return value
        return int(nearest(number(argument), [value for _, value in self.words]))

    def write(self, value: Value, verbose: bool) -> str:
        """NR1."""
        return str(int(value))


@dataclass(frozen=True)
class Text:
    """A quoted string."""

    longest: int = 1000

    def read(self, argument: Argument) -> str:
        """The string without its quotes."""
        if not argument.quoted:
            raise Refusal(Guess.STRING_EXPECTED)
        return argument.text[: self.longest]

    def write(self, value: Value, verbose: bool) -> str:
        """In double quotes."""
        return quoted(str(value))


@dataclass(frozen=True)
class Constant:
    """A value that can be asked for but not set."""

    answer: str

    def read(self, argument: Argument) -> Value:
        """Refuse: there is no such command."""
        raise Refusal(Guess.QUERY_HAS_NO_COMMAND)

    def write(self, value: Value, verbose: bool) -> str:
        """The constant."""
        return self.answer


@dataclass(frozen=True)
class Row:
    """One setting."""

    header: str
    kind: Kind
    default: Value = ""
    aliases: tuple[str, ...] = ()
    kept: bool = False  # *RST, FACtory and recalled setups leave it alone
    in_set: bool = True  # part of the answer to SET?
    in_file: bool = True  # part of a setup on the memory card, too, unless it is `kept`
    in_branch: bool = True  # part of the answer to a branch query


def time_steps(fastest: float) -> tuple[float, ...]:
    """The 1-2.5-5 sequence of s/div from the fastest sweep to 50 s/div."""
    return tuple(step for step in TIME_BASES if step >= fastest)


CURRENT_PROBES = (0.2, 1.0, 2.0, 5.0, 10.0, 50.0, 100.0, 1000.0)  # A/V
ENCODINGS = Words("ASCIi", "RIBinary", "RPBinary", "SRIbinary", "SRPbinary")
UNBOUNDED = 1e12  # rows whose range depends on other settings are forced by panel_rules.py


@lru_cache(maxsize=32)
def setting_rows(model: Model) -> tuple[Row, ...]:
    """All settings of a model, in the order of `SET?`."""
    return (
        *_answer_and_data(model),
        *_display_and_acquire(model),
        *(row for name in model.channel_names for row in _channel(name, model)),
        *_horizontal(model),
        *_trigger(model),
        *_select_and_cursors(model),
        *data_logging(model),
        *_measurement_and_math(model),
        *limit_test(model),
        *_hard_copy_and_links(model),
        *picture_printer(model),
        *battery_and_power(model),
    )


def _answer_and_data(model: Model) -> Iterator[Row]:
    # B, C and TPS answer without headers as they come (published USB programs never send HEADer)
    yield Row("HEADer", Switch(), int(not model.letter_series), aliases=("HDR",), kept=True)
    yield Row("VERBose", Switch(), 1, kept=True)
    yield Row("DATa:ENCdg", ENCODINGS, "RIBINARY", kept=True)
    references = Words(*model.reference_names)
    yield Row("DATa:DESTination", references, "REFA", aliases=("DATa:TARget",), kept=True)
    yield Row("DATa:SOUrce", Words(*model.waveform_names), "CH1", kept=True)
    yield Row("DATa:STARt", Whole(1, POINTS), 1, kept=True)
    yield Row("DATa:STOP", Whole(1, POINTS), POINTS, kept=True)
    yield Row("DATa:WIDth", Whole(1, 2), 1, kept=True)
    yield Row("LOCk", Words("ALL", "NONe"), "NONE", kept=True)


def _display_and_acquire(model: Model) -> Iterator[Row]:
    persistence = (("OFF", 0), ("1", 1), ("2", 2), ("5", 5), ("INF", 99))
    yield Row("DISplay:FORMat", Words("YT", "XY"), "YT")
    yield Row("DISplay:STYle", Words("DOTs", "VECtors"), "VECTORS")
    yield Row("DISplay:PERSistence", NumberedWords(persistence), 0)
    yield Row("DISplay:CONTRast", Whole(1, 100), 50, kept=True)
    yield Row("DISplay:INVert", Switch(words=True), 0, kept=True)
    if model.series == "TPS":
        yield Row(
            "DISplay:BRIGHTness", Steps((0, 15, 30, 45, 60, 75, 90, 100), whole=True), 100, kept=True, in_set=False
        )
    yield Row("ACQuire:MODe", Words("SAMple", "PEAKdetect", "AVErage"), "SAMPLE")
    averages = Steps((4, 16, 64, 128), whole=True)
    yield Row("ACQuire:NUMAVg", averages, 16, aliases=("ACQuire:NUMA",))  # NUMA stands in an example, p. 2-7
    yield Row("ACQuire:STATE", AcquireState(), 1)
    yield Row("ACQuire:STOPAfter", Words("RUNSTop", "SEQuence"), "RUNSTOP")


@dataclass(frozen=True)
class AcquireState(Switch):
    """ON, OFF, RUN, STOP or a number."""

    def read(self, argument: Argument) -> int:
        """1 to run, 0 to stop."""
        word = argument.text.upper()
        return int(word == "RUN") if word in ("RUN", "STOP") else super().read(argument)


def _channel(name: str, model: Model) -> Iterator[Row]:
    yield Row(f"{name}:PRObe", Steps(model.probes, whole=not model.letter_series), 10.0)
    if model.letter_series:
        yield Row(f"{name}:CURRENTPRObe", Steps(CURRENT_PROBES), 10.0)
    yield Row(f"{name}:SCAle", Real(2e-3, 5e3, digits=3), 1.0, aliases=(f"{name}:VOLts",))
    yield Row(f"{name}:POSition", Real(-1000.0, 1000.0, step=0.04), 0.0)
    yield Row(f"{name}:COUPling", Words("DC", "AC", "GND"), "DC")
    yield Row(f"{name}:BANdwidth", Switch(words=True), 0)
    yield Row(f"{name}:INVert", Switch(words=True), 0)
    if model.letter_series:
        yield Row(f"{name}:YUNit", QuotedWords("V", "A"), "V")


def _horizontal(model: Model) -> Iterator[Row]:
    steps = Steps(time_steps(model.fastest))
    main, delay = "HORizontal:MAIn", "HORizontal:DELay"
    scales = (f"{main}:SECdiv", "HORizontal:SCAle", "HORizontal:SECdiv")
    yield Row("HORizontal:VIEW", Words("MAIn", "WINDOW", "ZONE"), "MAIN")
    yield Row("HORizontal:RECOrdlength", Constant(str(POINTS)), in_set=False)
    yield Row(f"{main}:SCAle", steps, 5e-4, aliases=scales)
    yield Row(f"{main}:POSition", Real(-200, 50), 0.0, aliases=("HORizontal:POSition",))
    yield Row(f"{delay}:SCAle", steps, 5e-5, aliases=(f"{delay}:SECdiv",))
    yield Row(f"{delay}:POSition", Real(-200, 50), 0.0)
    if model.measurements == 6:  # TBS1000B; what stands below the first word is a guess
        yield Row("ZOOm:STATE", Switch(), 0, in_set=False)
        yield Row("ZOOm:SCAle", steps, 5e-5, in_set=False)
        yield Row("ZOOm:POSition", Real(0, 100), 50.0, in_set=False)


def _trigger(model: Model) -> Iterator[Row]:
    main = "TRIGger:MAIn"
    sources = (*model.channel_names, "EXT", "EXT5", *(("EXT10",) if model.series == "TPS" else ()))
    yield Row(f"{main}:MODe", Words("AUTO", "NORMal"), "AUTO")
    yield Row(f"{main}:TYPe", Words("EDGE", "VIDeo", "PULse"), "EDGE")
    yield Row(f"{main}:HOLDOff:VALue", Real(5e-7, 10.0), 5e-7)
    yield Row(f"{main}:EDGE:SOUrce", Words(*sources, "AC LINE", "LINE"), "CH1")
    yield Row(f"{main}:EDGE:COUPling", Words("DC", "AC", "HFRej", "LFRej", "NOISErej"), "DC")
    yield Row(f"{main}:EDGE:SLOpe", Words("RISe", "FALL"), "RISE")
    yield Row(f"{main}:VIDeo:SOUrce", Words(*sources), "CH1", in_file=False)
    yield Row(f"{main}:VIDeo:SYNC", Words("LINE", "FIELD", "ODD", "EVEN", "LINENum"), "LINE")
    yield Row(f"{main}:VIDeo:POLarity", Words("NORMal", "INVert"), "NORMAL")
    yield Row(f"{main}:VIDeo:LINE", Whole(1, 625), 1)
    yield Row(f"{main}:VIDeo:STANdard", Words("NTSc", "PAL"), "NTSC")
    pulse = f"{main}:PULse"
    yield Row(f"{pulse}:SOUrce", Words(*sources), "CH1", in_file=False)
    yield Row(f"{pulse}:WIDth:POLarity", Words("POSITIVe", "NEGAtive"), "POSITIVE")
    yield Row(f"{pulse}:WIDth:WHEN", Words("EQual", "NOTEqual", "INside", "OUTside"), "EQUAL")
    yield Row(f"{pulse}:WIDth:WIDth", PulseWidth(33e-9, 10.0), 1e-3)
    yield Row(f"{main}:LEVel", Real(-UNBOUNDED, UNBOUNDED), 0.0)


def _select_and_cursors(model: Model) -> Iterator[Row]:
    for name in model.waveform_names:
        yield Row(f"SELect:{name}", Switch(), int(name == "CH1"))
    yield Row("CURSor:FUNCtion", Words("OFF", "HBArs", "VBArs"), "OFF")
    yield Row("CURSor:SELect:SOUrce", Words(*model.waveform_names), "CH1")
    yield Row("CURSor:VBArs:UNIts", Words("SECOnds", "HERtz"), "SECONDS")
    yield Row("CURSor:VBArs:POSITION1", Real(-UNBOUNDED, UNBOUNDED), -2e-3)
    yield Row("CURSor:VBArs:POSITION2", Real(-UNBOUNDED, UNBOUNDED), 2e-3)
    yield Row("CURSor:HBArs:POSITION1", Real(-UNBOUNDED, UNBOUNDED), -3.2)
    yield Row("CURSor:HBArs:POSITION2", Real(-UNBOUNDED, UNBOUNDED), 3.2)


def _measurement_and_math(model: Model) -> Iterator[Row]:
    types: tuple[str, ...] = ("FREQuency", "MEAN", "PERIod", "PK2pk", "CRMs", "MINImum", "MAXImum")
    types = (*types, "RISe", "FALL", "PWIdth", "NWIdth")
    if model.has_rms:
        types = (*types, "RMS", *(("CURSORRMS",) if model.series == "C" else ()))
    if model.has_power_key:
        types = (*types, "PHAse")
    sources = Words(*model.channel_names, *(("MATH",) if model.letter_series else ()))
    for number in range(1, model.measurements + 1):
        yield Row(f"MEASUrement:MEAS{number}:TYPe", Words(*types, "NONe"), "NONE")
        yield Row(f"MEASUrement:MEAS{number}:SOUrce", sources, "CH1")
    if model.has_rms:
        yield Row("MEASUrement:METHod", Words("AUTO", "HISTOgram", "MINMax"), "AUTO")
    immediate = "MEASUrement:IMMed"
    yield Row(f"{immediate}:TYPe", Words(*types), "PERIOD", in_file=False)
    first, second = f"{immediate}:SOUrce", f"{immediate}:SOUrce1"
    if model.letter_series:
        first, second = second, first  # the answer says SOURCE1 there
    yield Row(first, sources, "CH1", aliases=(second,), in_file=False)
    if model.has_power_key:
        yield Row(f"{immediate}:SOUrce2", sources, "CH2", in_file=False)
    yield Row("MATH:DEFINE", MathExpression(model.channels, products=model.letter_series), "CH1 - CH2")
    if model.letter_series:
        yield Row("MATH:VERtical:POSition", Real(-1000, 1000, step=0.04), 0.0)
        yield Row("MATH:VERtical:SCAle", Real(1e-6, 1e6, digits=3), 2.0)
    yield Row("MATH:FFT:HORizontal:POSition", Real(0, 100), 50.0)
    yield Row("MATH:FFT:HORizontal:SCAle", Steps((1, 2, 5, 10)), 1.0)
    yield Row("MATH:FFT:VERtical:POSition", Real(-1000, 1000, step=0.04), 0.0)
    yield Row("MATH:FFT:VERtical:SCAle", Steps((0.5, 1, 2, 5, 10)), 1.0)
    if model.letter_series:
        yield Row("AUTORange:STATE", Switch(), 0, in_set=False)
        if model.series != "TPS":
            yield Row("AUTOSet:ENABLE", Switch(), 1, kept=True, in_set=False)
        yield Row("AUTORange:SETTings", Words("HORizontal", "VERTical", "BOTH"), "BOTH")


def data_logging(model: Model) -> Iterator[Row]:
    """Settings that setup files of the C series show (their words beyond those are guesses)."""
    if model.series == "C":
        yield Row("DATALOGging:DURAtion", Whole(30, 1440), 30)
        yield Row("DATALOGging:SOUrce", Words(*model.channel_names, "MATH"), "CH1")


def limit_test(model: Model) -> Iterator[Row]:
    """The same of the limit test; its settings are kept, no test is made."""
    if model.series != "C":
        return
    sources = Words(*model.channel_names, "MATH")
    yield Row("LIMit:SOUrce", sources, "CH1")
    yield Row("LIMit:COMPARE", Words(*model.reference_names), "REFA")
    yield Row("LIMit:SAVEIMAge", Switch(), 0)
    yield Row("LIMit:SAVEWFM", Switch(), 0)
    yield Row("LIMit:STOPAfter:MODe", Words("MANual", "TIMe", "VIOLation", "WAVEform"), "MANUAL")
    yield Row("LIMit:TEMPLate:DESTination", Words(*model.reference_names), "REFA")
    yield Row("LIMit:TEMPLate:SOUrce", sources, "CH1")
    yield Row("LIMit:TEMPLate:TOLerance:HORizontal", Whole(0, 500), 0)
    yield Row("LIMit:TEMPLate:TOLerance:VERTical", Whole(0, 5000), 0)


def picture_printer(model: Model) -> Iterator[Row]:
    """Settings of a PictBridge printer at the USB port of B and C models; their words are guesses."""
    if model.series not in ("B", "C"):
        return
    sizes = ("DEFLT", "L", "L2", "IN4BY6", "IN8BY10", "LETTER", "IN11BY17", "A3", "A4", "A5", "A6", "ROLL89MM")
    places = ("DEFLT", "IN2P5BY3P25", "L", "IN4BY6", "L2", "IN8BY10", "A4", "LETTER")
    qualities = ("DEFLT", "NORMAL", "DRAFT", "FINE")
    switches = ("DEFLT", "OFF", "ON")
    for leaf, words in (
        ("PAPERSIZE", sizes),
        ("IMAGESIZE", places),
        ("PAPERTYPE", ("DEFLT", "PLAIN", "PHOTO", "FASTPHOTO")),
        ("PRINTQUAL", qualities),
        ("DATEPRINT", switches),
        ("IDPRINT", switches),
    ):
        yield Row(f"PICTBridge:{leaf}", Words(*words), "DEFLT", kept=True, in_set=False)


def battery_and_power(model: Model) -> Iterator[Row]:
    """Settings of a TPS besides its batteries' state. Those of its key for power are guesses."""
    if model.series == "TPS":
        yield Row("POWer:BUTTONLIGHT", Switch(), 1, kept=True, in_set=False)
    if model.has_power_key:
        pair = Words("CH1CH2", *(("CH3CH4",) if model.channels == 4 else ()))
        one = Words(*model.channel_names)
        for header, words, first in (
            ("HARmonics:SOUrce", one, "CH1"),
            ("HARmonics:SETUp", Words("ALL", "ODD", "EVEN"), "ALL"),
            ("HARmonics:SELect", Whole(1, 50), 1),
            ("POWerANALYSIS:SOUrces", pair, "CH1CH2"),
            ("SWLoss:SOUrces", pair, "CH1CH2"),
            ("WAVEFORMANALYSIS:SOUrce", one, "CH1"),
        ):
            yield Row(header, words, first, in_set=False, in_file=False)


def _hard_copy_and_links(model: Model) -> Iterator[Row]:
    printers = ("BUBBLEJet", "DESKJet", "DPU3445", "DPU411", "DPU412", "EPSC60", "EPSC80", "EPSImage")
    formats = ("BMP", *printers, "EPSOn", "INTERLEAF", "LASERJet", "PCX", "RLE", "THINKjet", "TIFf")
    ports = ("CENtronics", "RS232", "GPIb", *(("USB",) if model.series in ("B", "C") else ()))
    languages = ("ENGLish", "FRENch", "GERMan", "ITALian", "SPANish", "JAPAnese", "PORTUguese", "KOREan")
    yield Row("HARDCopy:FORMat", Words(*formats), "EPSON", kept=True)
    yield Row("HARDCopy:PORT", Words(*ports), "CENTRONICS", kept=True)
    if model.has_storage:
        button = Words("PRINTS", "SAVESALL", "SAVESIMAGE")
        yield Row("HARDCopy:BUTTON", button, "SAVESALL", kept=True, in_set=False, in_branch=False)
        yield Row("SAVe:IMAge:FILEFormat", Words(*formats), "BMP", kept=True, in_set=False, in_branch=False)
    yield Row("HARDCopy:LAYout", Words("PORTRait", "LANdscape"), "PORTRAIT", kept=True)
    yield Row("HARDCopy:INKSaver", Switch(words=True), 1, kept=True)
    yield Row("LANGuage", Words(*languages, "TRADitionalchinese", "SIMPlifiedchinese"), "ENGLISH", kept=True)
    yield Row(
        "RS232:BAUd", Steps((300, 600, 1200, 2400, 4800, 9600, 19200), whole=True), 9600, kept=True, in_set=False
    )
    yield Row("RS232:SOFTFlagging", Switch(), 0, kept=True, in_set=False)
    yield Row("RS232:HARDFlagging", Switch(), 1, kept=True, in_set=False)
    yield Row("RS232:PARity", Words("NONe", "EVEN", "ODD"), "NONE", kept=True, in_set=False)
    yield Row("RS232:TRANsmit:TERMinator", Words("LF", "CR", "CRLf", "LFCr"), "LF", kept=True, in_set=False)


# --------------------
# The expression of MATH:DEFINE: a sum, difference or product of two channels, or the spectrum of one.
#
# Source: programmer manual 071-1075-04, p. 2-148


_INVALID_EXPRESSION = 2235
_WINDOWS = {
    spelling: word.upper() for word in ("HANning", "FLATtop", "RECTangular") for spelling in abbreviations(word)
}
_SUM = re.compile(r"CH(\d)([+*-])CH(\d)")
_FFT = re.compile(r"FFT\(CH(\d)(?:,([A-Z]+))?\)")
_PAIRS = {"1+2", "3+4", "1-2", "2-1", "3-4", "4-3"}
_PRODUCTS = {"1*2", "3*4"}


@dataclass(frozen=True)
class MathExpression:
    """The quoted expression of MATH:DEFINE, written as the instrument answers it."""

    channels: int
    products: bool = False  # B, C and TPS multiply, too

    def read(self, argument: Argument) -> str:
        """Canonical form; event 2235 if this family cannot calculate it."""
        if not argument.quoted:
            raise Refusal(Guess.STRING_EXPECTED)
        pairs = _PAIRS | _PRODUCTS if self.products else _PAIRS
        text = re.sub(r"\s+", "", argument.text).upper()
        if (match := _SUM.fullmatch(text)) and "".join(match.groups()) in pairs:
            first, sign, second = match.groups()
            if max(int(first), int(second)) <= self.channels:
                return f"CH{first} {sign} CH{second}"
        if (match := _FFT.fullmatch(text)) and 1 <= int(match[1]) <= self.channels:
            window = _WINDOWS.get(match[2] or "HANNING")
            if window is not None:
                return f"FFT(CH{match[1]},{window})"
        raise Refusal(_INVALID_EXPRESSION)

    def write(self, value: Value, verbose: bool) -> str:
        """In double quotes."""
        return quoted(str(value))


def operands(expression: str) -> list[str]:
    """Channels of an expression."""
    return re.findall(r"CH\d", expression)
