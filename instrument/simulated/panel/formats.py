"""Numbers, strings, blocks and headers as the TDS2000 family writes them in its answers.

Source: programmer manual 071-1075-04, pp. 2-4 to 2-14, and answers of real instruments.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

INVALID = 9.9e37  # the family's "no such number", p. 2-170

Mnemonics = tuple[str, ...]
Leaf = tuple[Mnemonics, str]  # header and value of one setting; a `*` query has an empty header


def nr3(value: float, digits: int = 7) -> str:
    """Write a number in the NR3 form of this family.

    One digit, a point, at least one more digit, and an exponent without plus sign or leading zeros.

    Examples
    --------
    >>> nr3(0), nr3(5e-4), nr3(1), nr3(-11008), nr3(3.852921)
    ('0.0E0', '5.0E-4', '1.0E0', '-1.1008E4', '3.852921E0')
    """
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

    Examples
    --------
    >>> print(quoted('a "b" c'))
    "a ""b"" c"
    """
    return '"' + text.replace('"', '""') + '"'


def block(data: bytes) -> bytes:
    """Wrap bytes as a definite-length block, p. 2-13.

    Examples
    --------
    >>> block(b"abc")
    b'#13abc'
    """
    length = str(len(data))
    return f"#{len(length)}{length}".encode() + data


def spell(mnemonic: str, verbose: bool) -> str:
    """Long or short form of a mnemonic spelled as in the manual (`ACQuire`).

    Examples
    --------
    >>> spell("ACQuire", True), spell("ACQuire", False), spell("BYT_Nr", False)
    ('ACQUIRE', 'ACQ', 'BYT_N')
    """
    if verbose:
        return mnemonic.upper()
    return "".join(c for c in mnemonic if not c.islower())


def abbreviations(mnemonic: str) -> list[str]:
    """Every accepted spelling from the short to the long form, in capitals; a trailing digit stays.

    Examples
    --------
    >>> abbreviations("COUPling")
    ['COUP', 'COUPL', 'COUPLI', 'COUPLIN', 'COUPLING']
    >>> abbreviations("MEAS1"), abbreviations("SOUrce1")
    (['MEAS1'], ['SOU1', 'SOUR1', 'SOURC1', 'SOURCE1'])
    """
    letters = mnemonic.rstrip("0123456789")
    digits = mnemonic[len(letters) :]
    if not any(c.islower() for c in letters):
        return [mnemonic]
    shortest = len(spell(letters, verbose=False))
    return [letters[:n].upper() + digits for n in range(shortest, len(letters) + 1)]


def join_leaves(leaves: Iterable[Leaf], *, header: bool, verbose: bool) -> str:
    """Write several settings as one answer.

    The first leaf carries its full path. A leaf below the branch of the one before it is written relative to
    that branch, any other with `:` and its full path.

    Examples
    --------
    >>> leaves = [(("HORizontal", "VIEW"), "MAIN"), (("HORizontal", "MAIn", "SCAle"), "5.0E-4"),
    ...           (("HORizontal", "MAIn", "POSition"), "0.0E0"), (("HORizontal", "DELay", "SCAle"), "5.0E-5")]
    >>> join_leaves(leaves, header=True, verbose=True)
    ':HORIZONTAL:VIEW MAIN;MAIN:SCALE 5.0E-4;POSITION 0.0E0;:HORIZONTAL:DELAY:SCALE 5.0E-5'
    >>> join_leaves(leaves, header=False, verbose=True)
    'MAIN;5.0E-4;0.0E0;5.0E-5'
    """
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
