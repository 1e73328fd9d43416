"""The language on the wire: answers of several parts, headers, numbers, strings and binary blocks.

Pure functions on text and bytes; nothing here knows a link or a scope. The rules are those of the programmer
manual 071-1075-04, pp. 2-4 to 2-14.
"""

from decimal import Decimal

from instrument.errors import TransferError


def split_parts(text: str, separator: str = ";") -> list[str]:
    """Split an answer at `separator`, but never inside a quoted string."""
    parts = [""]
    for number, stretch in enumerate(text.split('"')):
        if number:
            parts[-1] += '"'
        if number % 2:  # inside quotes
            parts[-1] += stretch
        else:
            first, *rest = stretch.split(separator)
            parts[-1] += first
            parts += rest
    return parts


def split_header(part: str) -> tuple[str, str]:
    """Separate one part of an answer into its header ("" where headers are off) and its value."""
    # A header is a word of letters, digits, ``_``, ``:`` or ``*`` that starts with a colon or a letter and is
    # followed by a blank. A value alone never looks like that: numbers start with a digit or a sign, strings with
    # a quote, and single words have no blank behind them.
    part = part.strip()
    word, blank, value = part.partition(" ")
    looks_like_header = word[:1] in (":", "*") or word[:1].isalpha()
    if blank and looks_like_header and all(c.isalnum() or c in "_:*" for c in word):
        return word, value.strip()
    return "", part


def without_mark(parts: list[str], mark: str) -> list[str]:
    """Take the mark of its question off an answer; TransferError if it bears another one."""
    if not parts or split_header(parts[0])[1] != mark:
        raise TransferError(f"the answer {parts[:1]!r:.40} belongs to another question; ask again")
    return parts[1:]


def unquote(text: str) -> str:
    """Take the double quotes off a string value; a doubled quote inside stands for one."""
    text = text.strip()
    if len(text) >= 2 and text[0] == text[-1] == '"':
        return text[1:-1].replace('""', '"')
    return text


def number(text: str) -> float:
    """Read an NR1, NR2 or NR3 number."""
    stripped = text.strip()
    try:
        # float() alone would also take "nan", "inf" and "1_000".
        if not stripped or any(c not in "0123456789+-.eE" for c in stripped):
            raise ValueError
        value = float(stripped)
    except ValueError:
        raise TransferError(f"the scope sent {text!r} where a number belongs; ask again") from None
    if value in (float("inf"), float("-inf")):
        raise TransferError(f"the scope sent {text!r}, a number too large to be true; ask again")
    return value


def integer(text: str) -> int:
    """Read a whole number; TransferError if there is a fraction or no number at all."""
    value = number(text)
    if value != int(value):
        raise TransferError(f"the scope sent {text!r} where a whole number belongs; ask again")
    return int(value)


def nr3(value: float) -> str:
    """Write a number as the scope does: one digit, a point, at least one digit, E, plain exponent."""
    # The shortest digits that read back to the same float are used.
    if value == 0:
        return "0.0E0"
    # repr() gives the shortest digits that read back to the same float; formatting would round them again.
    sign, digits, exponent = Decimal(repr(float(value))).normalize().as_tuple()
    if not isinstance(exponent, int):
        raise ValueError(f"{value} cannot be sent to a scope; give a finite number")
    first, rest = str(digits[0]), "".join(map(str, digits[1:])) or "0"
    return f"{'-' if sign else ''}{first}.{rest}E{exponent + len(digits) - 1}"


def block_start(message: bytes | bytearray, position: int = 0) -> int:
    """Index of the next ``#`` that opens a binary block, not counting one inside a quoted string; -1 if none."""
    index, quotes = message.find(b"#", position), 0
    while index >= 0:
        quotes += message.count(b'"', position, index)
        if quotes % 2 == 0:
            break
        position, index = index, message.find(b"#", index + 1)
    return index


def bytes_missing(message: bytes | bytearray, *, longest: int, blocks: int = 1) -> int:
    """How many bytes must still come before a message with binary blocks is complete."""
    # Counts the line feed behind the last block. 0 means complete; where the length is not known yet, the answer
    # is the number of bytes that are needed to know more.
    position = 0
    for _ in range(blocks):
        start = block_start(message, position)
        if start < 0:
            return 0 if message.endswith(b"\n") and len(message) > position else 1
        missing = _header_bytes_missing(message, start)
        if missing:
            return missing
        _, position = _block_span(message, start, longest)
        if len(message) <= position:
            return position + 1 - len(message)  # the byte behind this block tells what comes next
    more_text = message[position : position + 1] == b";" and not message.endswith(b"\n")
    return 1 if more_text or len(message) == position else 0


def blocks_begun(message: bytes | bytearray, *, longest: int) -> tuple[int, int]:
    """Number of blocks that have begun, and how many bytes the last of them still lacks."""
    # The second number is 0 right behind that block and negative in the text after it; 0 without a block.
    begun = position = 0
    while (start := block_start(message, position)) >= 0 and not _header_bytes_missing(message, start):
        _, position = _block_span(message, start, longest)
        begun += 1
    return begun, position - len(message) if begun else 0


def split_blocks(
    message: bytes, *, longest: int, blocks: int = 1, terminated: bool = True
) -> tuple[list[tuple[str, bytes]], str]:
    """Separate a complete answer into its binary blocks, each with the text before it, and the text behind."""
    # A block is cut by its own length, so data may hold any byte. Behind it only a ``;`` or the line end may
    # follow, and on a link one of them must: without it the last byte of the data would be the line end, and one
    # byte before it lost.
    pieces: list[tuple[str, bytes]] = []
    position = 0
    while len(pieces) < blocks and (start := block_start(message, position)) >= 0:
        if len(message) < start + 2:
            raise TransferError("the binary block of the answer is cut in its header; ask again")
        first, end = _block_span(message, start, longest)
        data = message[first:end]
        if len(data) < end - first:
            raise TransferError(f"the binary block is cut: {len(data)} of {end - first} bytes came; ask again")
        pieces.append((decode_text(message[position:start]), data))
        rest = message[end:]
        length = len(data)
        if terminated and not rest:
            raise TransferError(
                f"no line end follows the binary block of {length} bytes: a byte was lost; ask again"
            )
        if rest[:1] != b";" and (rest.strip(b"\r\n") or len(rest) > 2):
            raise TransferError(
                f"{len(rest)} bytes follow the binary block of {length} bytes where only a line end belongs: "
                "bytes were lost or added; ask again"
            )
        position = end
    return pieces, decode_text(message[position:])


def split_block(message: bytes, *, longest: int, terminated: bool = True) -> tuple[str, bytes]:
    """Separate a complete answer that ends with one binary block; errors as `split_blocks`."""
    pieces, rest = split_blocks(message, longest=longest, terminated=terminated)
    if not pieces:
        return rest, b""
    text, data = pieces[0]
    if rest:
        raise TransferError(
            f"{len(rest)} bytes follow the binary block of {len(data)} bytes where only a line end belongs: "
            "bytes were lost or added; ask again"
        )
    return text, data


def decode_text(message: bytes) -> str:
    """Text of an answer without its line end; TransferError for bytes that are not printable ASCII."""
    stripped = message.strip(b"\r\n")
    if any(not 0x20 <= byte < 0x7F for byte in stripped):
        raise TransferError(f"the answer holds bytes that are not text ({stripped[:40]!r}); ask again")
    return stripped.decode("ascii")


def _header_bytes_missing(message: bytes | bytearray, start: int) -> int:
    """Bytes that are missing of the ``#<n><n digits>`` that begins at `start`."""
    if len(message) < start + 2:
        return start + 2 - len(message)
    return max(0, start + 2 + _length_digits(message, start) - len(message))


def _block_span(message: bytes | bytearray, start: int, longest: int) -> tuple[int, int]:
    """Where the data of a block begin and end whose whole header has come."""
    digits = _length_digits(message, start)
    first = start + 2 + digits
    field = message[start + 2 : start + 2 + digits]
    if not field.isdigit() or len(field) < digits:
        raise TransferError(f"the length of the binary block reads {field!r}; ask again")
    length = int(field)
    if length > longest:
        raise TransferError(f"the binary block claims {length} bytes where at most {longest} belong; ask again")
    return first, first + length


def _length_digits(message: bytes | bytearray, start: int) -> int:
    digits = message[start + 1] - 0x30
    if not 1 <= digits <= 9:
        raise TransferError(
            f"a binary block starts with {message[start : start + 2]!r} instead of '#' and a digit; ask again"
        )
    return digits


# --------------------
# Facts of the TDS1000/TDS2000 family that driver, simulator and station all need: numbers of the data sheet


POINTS = 2500  # points of every record

DIVISIONS = 10
"""A record, and the screen, is so many divisions wide (user manual 071-1064-00, p. 156)."""

POINTS_PER_DIVISION = POINTS // DIVISIONS  # XINCR is s/div over this
VERTICAL_DIVISIONS = 8  # the screen is so many divisions high

LEVELS_PER_DIVISION = 25
"""Codes per vertical division, at one byte a point (programmer manual 071-1075-04, p. 2-84)."""

HIGHEST_CODE = 127  # channel codes stop at plus and minus this value: there the record is clipped
NO_DATA = -128  # code where the scope has no data: the moving blank of scan mode, an empty reference

TIME_BASES = tuple(float(f"{mantissa}e{decade}") for decade in range(-9, 2) for mantissa in (1, 2.5, 5))
"""Steps of the time base, s/div (071-1075-04, HORizontal:MAIn:SCAle); not every model has the fastest ones."""

VERTICAL_SCALES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Coarse steps of the vertical scale at the input, V/div (071-1075-04, CH<x>:SCAle)."""

SCAN_FROM = 0.1
"""From this s/div on, AUTO mode scans instead of waiting for triggers (071-1064-00, pp. 78 and 92)."""
