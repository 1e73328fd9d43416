"""From bytes to program messages and commands, and numbers and headers as the family writes them.

Source: programmer manual 071-1075-04, pp. 2-3 to 2-14.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

from instrument.simulated.panel.events import Guess, Refusal

LONGEST_MESSAGE = 100_000  # bytes without a terminator that a link collects before it gives up
_SHORT = 1000  # bytes of a message that is worth remembering
LONGEST_BLOCK = 20_000  # bytes; 2500 points of two bytes and a generous margin

_WHITE = "".join(map(chr, [*range(0x0A), *range(0x0B, 0x21)]))
_HEADER = re.compile(r"(:?[A-Za-z][A-Za-z0-9_:]*|\*[A-Za-z]+)(\?)?(?:[\x00-\x09\x0b-\x20]+(.*))?\Z", re.DOTALL)
_BLOCK = re.compile(rb"#([1-9])")
_BLANKS = re.compile(r"[\x00-\x09\x0b-\x20]+")


@dataclass(frozen=True)
class Argument:
    """One argument: `text` for words and numbers, `quoted` for strings, `data` for blocks."""

    text: str = ""
    quoted: bool = False
    data: bytes | None = None


@dataclass(frozen=True)
class Command:
    """One command or query of a program message."""

    header: str
    query: bool
    arguments: tuple[Argument, ...]
    source: str

    @property
    def absolute(self) -> bool:
        """True when the header starts with a colon."""
        return self.header.startswith(":")


@dataclass(frozen=True)
class Malformed:
    """A piece of a program message that is no command at all."""

    source: str
    event: int


def block_end(data: bytes, start: int, *, final: bool) -> int | None:
    """Index after the block that starts at `data[start] == b"#"`; None while bytes are missing."""
    # What is not a sound definite block, or one longer than any this instrument takes, counts as plain text of one
    # character, so that a stray `#9` cannot swallow the messages after it.
    match = _BLOCK.match(data, start)
    if match is None:
        return start + 1 if final or start + 1 < len(data) else None
    width = int(match[1])
    digits = data[start + 2 : start + 2 + width]
    if not digits.isdigit() and digits:
        return start + 1
    if len(digits) < width:
        return start + 1 if final else None
    length = int(digits)
    if length > LONGEST_BLOCK:
        return start + 1
    end = start + 2 + width + length
    if end > len(data):
        return len(data) if final else None
    return end


class StreamSplitter:
    """Cuts a stream of bytes into program messages at LF or CR, but not inside a block."""

    def __init__(self) -> None:
        self._buffer = b""
        self._scanned = 0

    def clear(self) -> None:
        """Forget the bytes of an unfinished message."""
        self._buffer, self._scanned = b"", 0

    def feed(self, data: bytes, *, end: bool = False) -> list[bytes]:
        """Take in bytes and return the messages they complete; `end` marks the last byte as an END message."""
        self._buffer += data
        messages = []
        start, at = 0, self._scanned
        buffer = self._buffer
        while at < len(buffer):
            byte = buffer[at]
            if byte in b"\r\n":
                messages.append(buffer[start:at])
                start = at = at + 1
            elif byte == 0x23 and buffer[start:at].strip() and buffer[at - 1] in b"\t ,":
                indefinite = end and buffer[at + 1 : at + 2] == b"0"  # goes on to the END of the message
                after = len(buffer) if indefinite else block_end(buffer, at, final=end)
                if after is None:
                    break
                at = after
            else:
                at += 1
        if end:
            messages.append(buffer[start:])
            start = at = len(buffer)
        self._buffer, self._scanned = buffer[start:], at - start
        if len(self._buffer) > LONGEST_MESSAGE:
            self.clear()
        return [message for message in messages if message.strip()]


def parse_message(message: bytes, *, stream: bool = False) -> tuple[Command | Malformed, ...]:
    """Split one program message at its semicolons and read each command."""
    # On a stream nothing marks the end of an indefinite block, so it is refused there (event 161, p. 2-13).
    # a long one carries a record and does not come again: remembered ones must not fill the memory
    return _remembered(message, stream) if len(message) <= _SHORT else _parsed(message, stream)


def _parsed(message: bytes, stream: bool) -> tuple[Command | Malformed, ...]:
    return tuple(_parse_command(unit, stream) for unit in _split(message, 0x3B) if _trim(unit))


_remembered = lru_cache(maxsize=128)(_parsed)


def _trim(piece: bytes) -> str:
    return piece.decode("latin-1").strip(_WHITE)


def _split(message: bytes, separator: int) -> list[bytes]:
    """Split at a separator that stands outside strings and blocks."""
    if not any(mark in message for mark in (b'"', b"'", b"#")):
        return message.split(bytes([separator]))
    pieces = []
    start = at = 0
    while at < len(message):
        byte = message[at]
        if byte in b"\"'":
            close = message.find(byte, at + 1)
            at = len(message) if close < 0 else close + 1
        elif byte == 0x23 and message[at + 1 : at + 2] == b"0":
            at = len(message)
        elif byte == 0x23:
            at = block_end(message, at, final=True) or len(message)
        elif byte == separator:
            pieces.append(message[start:at])
            start = at = at + 1
        else:
            at += 1
    return [*pieces, message[start:]]


def _parse_command(unit: bytes, stream: bool) -> Command | Malformed:
    text = _trim(unit)
    match = _HEADER.match(unit.decode("latin-1").lstrip(_WHITE))
    if match is None:
        return Malformed(text, Guess.HEADER_IS_NOT_A_NAME)
    header, query, rest = match[1], match[2] is not None, match[3]
    if rest is None or not rest.strip(_WHITE):
        return Command(header, query, (), text)
    try:
        arguments = tuple(_parse_argument(piece, stream) for piece in _split(rest.encode("latin-1"), 0x2C))
    except Refusal as refusal:
        return Malformed(text, refusal.event)
    return Command(header, query, arguments, text)


def _parse_argument(piece: bytes, stream: bool) -> Argument:
    bare = piece.lstrip(_WHITE.encode("latin-1"))
    if stream and bare.startswith(b"#0"):
        raise Refusal(161)
    if bare.startswith(b"#"):
        return Argument(data=_block_data(bare))
    text = _trim(piece)
    if not text:
        raise Refusal(Guess.ARGUMENT_IS_EMPTY)
    quote = text[0]
    if quote not in "\"'":
        return Argument(text=_BLANKS.sub(" ", text))
    if len(text) < 2 or not text.endswith(quote) or quote in text[1:-1].replace(quote * 2, ""):
        raise Refusal(Guess.STRING_IS_NOT_CLOSED)
    return Argument(text=text[1:-1].replace(quote * 2, quote), quoted=True)


def _block_data(piece: bytes) -> bytes:
    """Bytes of a definite (`#<n><length>`) or indefinite (`#0`) block; event 161 when it does not fit."""
    if piece.startswith(b"#0"):
        return piece[2:]
    width = piece[1:2]
    if not width.isdigit():
        raise Refusal(161)
    digits = piece[2 : 2 + int(width)]
    body = piece[2 + int(width) :]
    if len(digits) < int(width) or not digits.isdigit() or len(body) < int(digits):
        raise Refusal(161)
    if body[int(digits) :].strip(_WHITE.encode("latin-1")):
        raise Refusal(161)
    return body[: int(digits)]


# --------------------
# Numbers, strings, blocks and headers as the TDS2000 family writes them in its answers.
#
# Source: programmer manual 071-1075-04, pp. 2-4 to 2-14, and answers of real instruments


INVALID = 9.9e37  # the family's "no such number", p. 2-170

Mnemonics = tuple[str, ...]
Leaf = tuple[Mnemonics, str]  # header and value of one setting; a `*` query has an empty header


def nr3(value: float, digits: int = 7) -> str:
    """Write a number in the NR3 form of this family."""
    # One digit, a point, at least one more digit, and an exponent without plus sign or leading zeros.
    if value == 0:
        return "0.0E0"
    if not math.isfinite(value):
        value = INVALID
    mantissa, _, exponent = f"{value:.{digits - 1}E}".partition("E")
    mantissa = mantissa.rstrip("0")
    if mantissa.endswith("."):
        mantissa += "0"
    return f"{mantissa}E{int(exponent)}"


def quoted(text: str) -> str:
    """Put a string in double quotes, doubling those inside it.

    >>> print(quoted('a "b" c'))
    "a ""b"" c"
    """
    return '"' + text.replace('"', '""') + '"'


def block(data: bytes) -> bytes:
    """Wrap bytes as a definite-length block, p. 2-13."""
    length = str(len(data))
    return f"#{len(length)}{length}".encode() + data


def spell(mnemonic: str, verbose: bool) -> str:
    """Long or short form of a mnemonic spelled as in the manual (`ACQuire`)."""
    if verbose:
        return mnemonic.upper()
    return "".join(c for c in mnemonic if not c.islower())


def abbreviations(mnemonic: str) -> list[str]:
    """Every accepted spelling from the short to the long form, in capitals; a trailing digit stays."""
    letters = mnemonic.rstrip("0123456789")
    digits = mnemonic[len(letters) :]
    if not any(c.islower() for c in letters):
        return [mnemonic]
    shortest = len(spell(letters, verbose=False))
    return [letters[:n].upper() + digits for n in range(shortest, len(letters) + 1)]


def join_leaves(leaves: Iterable[Leaf], *, header: bool, verbose: bool) -> str:
    """Write several settings as one answer."""
    # The first leaf carries its full path. A leaf below the branch of the one before it is written relative to
    # that branch, any other with `:` and its full path.
    if not header:
        return ";".join(value for _, value in leaves)
    parts = []
    branch: Mnemonics = ()
    for path, value in leaves:
        if not path:
            parts.append(value)
            continue
        depth = len(branch)
        relative = depth > 0 and path[:depth] == branch
        written = path[depth:] if relative else path
        name = ":".join(spell(mnemonic, verbose) for mnemonic in written)
        parts.append(f"{'' if relative else ':'}{name} {value}")
        branch = path[:-1]
    return ";".join(parts)
