"""The language on the wire: answers of several parts, headers, numbers, strings and binary blocks.

Pure functions on text and bytes; nothing here knows a link or a scope. The rules are those of the programmer
manual 071-1075-04, pp. 2-4 to 2-14.
"""

from __future__ import annotations

from decimal import Decimal

from instrument.errors import TransferError


def split_parts(text: str, separator: str = ";") -> list[str]:
    """Split an answer at `separator`, but never inside a quoted string.

    >>> split_parts('1;"Ch1; DC";Y')
    ['1', '"Ch1; DC"', 'Y']
    """
    parts: list[str] = []
    current: list[str] = []
    quoted = False
    for character in text:
        if character == '"':
            quoted = not quoted
        if character == separator and not quoted:
            parts.append("".join(current))
            current = []
        else:
            current.append(character)
    parts.append("".join(current))
    return parts


def split_header(part: str) -> tuple[str, str]:
    """Separate one part of an answer into its header ("" where headers are off) and its value.

    A header is a word of letters, digits, ``_``, ``:`` or ``*`` that starts with a colon or a letter and is
    followed by a blank. A value alone never looks like that: numbers start with a digit or a sign, strings
    with a quote, and single words have no blank behind them.

    >>> split_header(":WFMPRE:BYT_NR 1"), split_header("2500"), split_header('"Ch1, DC"')
    ((':WFMPRE:BYT_NR', '1'), ('', '2500'), ('', '"Ch1, DC"'))
    """
    part = part.strip()
    word, blank, value = part.partition(" ")
    looks_like_header = word[:1] in (":", "*") or word[:1].isalpha()
    if blank and looks_like_header and all(c.isalnum() or c in "_:*" for c in word):
        return word, value.strip()
    return "", part


def unquote(text: str) -> str:
    """Take the double quotes off a string value; a doubled quote inside stands for one."""
    text = text.strip()
    if len(text) >= 2 and text[0] == text[-1] == '"':
        return text[1:-1].replace('""', '"')
    return text


def number(text: str) -> float:
    """Read an NR1, NR2 or NR3 number.

    Raises
    ------
    TransferError
        If `text` is not a finite number: something was lost on the way.
    """
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
    """Write a number as the scope does: one digit, a point, at least one digit, E, plain exponent.

    The shortest digits that read back to the same float are used.

    >>> nr3(0.00025), nr3(0), nr3(-11008), nr3(50)
    ('2.5E-4', '0.0E0', '-1.1008E4', '5.0E1')
    """
    if value == 0:
        return "0.0E0"
    # repr() gives the shortest digits that read back to the same float; formatting would round them again.
    sign, digits, exponent = Decimal(repr(float(value))).normalize().as_tuple()
    if not isinstance(exponent, int):
        raise ValueError(f"{value} cannot be sent to a scope; give a finite number")
    first, rest = str(digits[0]), "".join(map(str, digits[1:])) or "0"
    return f"{'-' if sign else ''}{first}.{rest}E{exponent + len(digits) - 1}"


def block_start(message: bytes | bytearray) -> int:
    """Index of the ``#`` that opens a binary block, not counting one inside a quoted string; -1 if none."""
    quoted = False
    for index, byte in enumerate(message):
        if byte == 0x22:
            quoted = not quoted
        elif byte == 0x23 and not quoted:
            return index
    return -1


def bytes_missing(message: bytes, *, longest: int) -> int:
    """How many bytes must still come before a message with a binary block is complete.

    Counts the line feed behind the block. 0 means complete; where the length is not known yet, the answer is
    the number of bytes that are needed to know more.

    Parameters
    ----------
    message : bytes
        What has arrived so far, from the first byte of the answer.
    longest : int
        Longest block that can be meant; a larger length is a damaged length.

    Raises
    ------
    TransferError
        If the block header is not ``#<n><n digits>`` or its length is not plausible.
    """
    start = block_start(message)
    if start < 0:
        return 0 if message.endswith(b"\n") else 1
    if len(message) < start + 2:
        return start + 2 - len(message)
    digits = _length_digits(message, start)
    if len(message) < start + 2 + digits:
        return start + 2 + digits - len(message)
    end = start + 2 + digits + _block_length(message, start, digits, longest)
    return max(0, end + 1 - len(message))


def split_block(message: bytes, *, longest: int, terminated: bool = True) -> tuple[str, bytes]:
    """Separate a complete answer into the text before its binary block and the data of the block.

    The block is cut by its own length, so data may hold any byte. Behind it only a line end may follow, and on
    a link it must: without it the last byte of the data would be the line end, and one byte before it lost.

    Returns
    -------
    text : str
        Everything before the ``#``; the whole message without its line end if there is no block.
    data : bytes
        The bytes of the block, empty if there is none.

    Raises
    ------
    TransferError
        If the block is cut, too long or followed by something else.
    """
    start = block_start(message)
    if start < 0:
        return decode_text(message), b""
    if len(message) < start + 2:
        raise TransferError("the binary block of the answer is cut in its header; ask again")
    digits = _length_digits(message, start)
    length = _block_length(message, start, digits, longest)
    first = start + 2 + digits
    data, rest = message[first : first + length], message[first + length :]
    if len(data) < length:
        raise TransferError(f"the binary block is cut: {len(data)} of {length} bytes came; ask again")
    if terminated and not rest:
        raise TransferError(f"no line end follows the binary block of {length} bytes: a byte was lost; ask again")
    if rest.strip(b"\r\n") or len(rest) > 2:
        raise TransferError(
            f"{len(rest)} bytes follow the binary block of {length} bytes where only a line end belongs: "
            "bytes were lost or added; ask again"
        )
    return decode_text(message[:start]), data


def decode_text(message: bytes) -> str:
    """Text of an answer without its line end; TransferError for bytes that are not printable ASCII."""
    stripped = message.strip(b"\r\n")
    if any(not 0x20 <= byte < 0x7F for byte in stripped):
        raise TransferError(f"the answer holds bytes that are not text ({stripped[:40]!r}); ask again")
    return stripped.decode("ascii")


def _length_digits(message: bytes, start: int) -> int:
    digits = message[start + 1] - 0x30
    if not 1 <= digits <= 9:
        raise TransferError(
            f"a binary block starts with {message[start : start + 2]!r} instead of '#' and a digit; ask again"
        )
    return digits


def _block_length(message: bytes, start: int, digits: int, longest: int) -> int:
    field = message[start + 2 : start + 2 + digits]
    if not field.isdigit() or len(field) < digits:
        raise TransferError(f"the length of the binary block reads {field!r}; ask again")
    length = int(field)
    if length > longest:
        raise TransferError(f"the binary block claims {length} bytes where at most {longest} belong; ask again")
    return length
