"""The question for one or several records in one message, and how its answer is taken apart.

Of one source the question is ``WAVFrm?``. Of several, ``DATa:SOUrce`` goes from one to the next, and
``ACQuire:STATE?`` stands before and behind them. What comes back is, with headers off::

    <*ESR?>;[<STATE?>;]<preamble>;<block>[;<preamble>;<block>...;<STATE?>]

Programmer manual 071-1075-04, pp. 2-86 to 2-91 and 2-240 to 2-246.
"""

from dataclasses import dataclass

from instrument import scpi
from instrument.errors import SettingError, TransferError
from instrument.waveform import Preamble, Waveform, decode_curve

PREAMBLE_FIELDS = 16  # fields of ``WFMPre?`` of a waveform that is displayed
TRANSMISSION_FIELDS = 5  # fields of ``WFMPre?`` of a waveform that is not

_STOPPED, _RUNNING = "0", "1"


@dataclass(frozen=True)
class RecordQuestion:
    """Which records are asked for."""

    sources: tuple[str, ...]  # ``CH1``..., in the order in which they are wanted
    selected: str | None = None  # what ``DATa:SOUrce`` names before the question; None if not known
    # each record is asked for two times and must come alike: nothing else shows a changed byte in a curve
    twice: bool = False

    @property
    def blocks(self) -> int:
        """Binary blocks in a whole answer."""
        return len(self.sources) * (1 + self.twice)

    @property
    def text(self) -> str:
        """The queries, to follow ``*ESR?``."""
        query = ":WAVF?;:WAVF?" if self.twice else ":WAVF?"
        if len(self.sources) == 1:
            return f"{self._select(self.sources[0], self.selected)}{query}"
        before = (self.selected, *self.sources)
        waveforms = [f"{self._select(new, old)}{query}" for old, new in zip(before, self.sources, strict=False)]
        return ";".join((":ACQ:STATE?", *waveforms, ":ACQ:STATE?"))

    @staticmethod
    def _select(source: str, selected: str | None) -> str:
        return "" if source == selected else f":DATA:SOURCE {source};"

    def split(
        self, pieces: list[tuple[str, bytes]], rest: str, mark: str = ""
    ) -> tuple[str, list[str], list[bytes]]:
        """Take an answer apart."""
        several = len(self.sources) > 1
        fields: list[str] = []
        ends: list[int] = []  # numbers of fields before each block
        for number, (text, _) in enumerate(pieces):
            fields += _without_curve_header(_fields(text, follows_block=number > 0))
            ends.append(len(fields))
        if rest or not pieces:
            fields += _fields(rest, follows_block=bool(pieces))
        if mark:
            fields, ends = scpi.without_mark(fields, mark), [end - 1 for end in ends]
        if not fields:
            raise TransferError("nothing stands before the binary block; ask again")
        register, *fields = fields
        if several:
            if len(fields) < 2 or {fields[0], fields[-1]} - {_STOPPED, _RUNNING}:
                raise TransferError(f"records were expected, but {fields[-1:]!r:.60} ended the answer; ask again")
            if _RUNNING in (fields[0], fields[-1]):
                raise SettingError(
                    "the scope acquires on, so that its channels would be of different acquisitions; stop it, or "
                    "acquire a single record"
                )
            fields = fields[1:-1]
        behind = 2 if several else 1
        texts = self._preambles(fields, {end - behind for end in ends})
        curves = [data for _, data in pieces]
        if self.twice:
            if texts[::2] != texts[1::2] or curves[::2] != curves[1::2]:
                raise TransferError("a record came in two ways when it was read twice; ask again")
            texts, curves = texts[::2], curves[::2]
        return register, texts, curves

    def _preambles(self, fields: list[str], ends: set[int]) -> list[str]:
        """Cut the fields into preambles; `ends` are the places where a block followed."""
        texts, position = [], 0
        for _ in range(self.blocks):
            length = PREAMBLE_FIELDS if position + PREAMBLE_FIELDS in ends else TRANSMISSION_FIELDS
            texts.append(";".join(fields[position : position + length]))
            position += length
            ends.discard(position)
        if position != len(fields) or ends:
            raise TransferError(
                f"{len(fields)} fields of preambles came where {position} were expected; ask again"
            )
        return texts

    def not_displayed(self, texts: list[str]) -> str | None:
        """The first source of which only the transmission fields came."""
        for source, text in zip(self.sources, texts, strict=True):
            if len(scpi.split_parts(text)) == TRANSMISSION_FIELDS:
                return source
        return None

    def decode(self, texts: list[str], curves: list[bytes]) -> tuple[Waveform, ...]:
        """The records; TransferError if one is damaged, or not in our format, or of another acquisition."""
        if len(curves) != len(self.sources):
            raise TransferError(f"{len(curves)} records came where {len(self.sources)} belong; ask again")
        waveforms = []
        for source, text, data in zip(self.sources, texts, curves, strict=True):
            preamble = Preamble.parse(text)
            form = (preamble.byt_nr, preamble.encdg, preamble.bn_fmt)
            if form != (1, "BIN", "RI") or text.lstrip().startswith(":"):
                raise TransferError(
                    "somebody changed headers or the transfer format; it has been set again, ask again"
                )
            named = preamble.wfid.split(",")[0].upper().replace(" ", "")
            if named != source:
                raise TransferError(f"the record is of {named} instead of {source}; ask again")
            waveforms.append(decode_curve(data, preamble))
        if len({(waveform.preamble.xincr, waveform.preamble.xzero) for waveform in waveforms}) > 1:
            raise TransferError("the channels are not of one acquisition (was a knob turned?); ask again")
        return tuple(waveforms)


def _fields(text: str, *, follows_block: bool) -> list[str]:
    """Fields of the text between blocks; the ``;`` that joins them to the block is not one."""
    if follows_block:
        if not text.startswith(";"):
            raise TransferError(f"{text[:20]!r} follows a binary block where ';' belongs; ask again")
        text = text[1:]
    return scpi.split_parts(text)


def _without_curve_header(fields: list[str]) -> list[str]:
    """Drop what stands between a preamble and its block: nothing, or with headers on ``:CURVE``."""
    last = fields[-1].strip().lstrip(":").upper()
    return fields[:-1] if not last or last.startswith("CURV") else fields
