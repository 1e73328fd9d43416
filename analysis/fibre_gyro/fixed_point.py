"""Numbers as words of a gate array or a processor: whole multiples of 2^-f, and what the rounding makes of them.

A word of w bits, two's complement, of which f are behind the point, holds n 2^-f with -2^(w-1) <= n < 2^(w-1). The
rounding error is computed from the word itself, as it stands in the text that is written.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats

_PPM = 1e6
LONGEST_WORD = 64
_MOST_FRACTION = 256


@dataclass(frozen=True)
class FixedPoint:
    """Words of one width for several numbers."""

    width: int  # bits of a word, and how many of them are behind the point
    fraction: int
    words: tuple[int, ...]
    values: Floats  # (n,): what the words stand for: words 2^-fraction
    error: Floats  # (n,): rounded less exact number, in its unit and of the number itself; nan of zero
    error_ppm: Floats

    @property
    def largest_error_ppm(self) -> float:
        """Largest of all in size; 0 where every number is zero."""
        known = self.error_ppm[np.isfinite(self.error_ppm)]
        return float(np.abs(known).max()) if known.size else 0.0


def round_to_words(
    numbers: ArrayLike, *, width: int | None = None, fraction: int | None = None, error_ppm: float = 1.0
) -> FixedPoint:
    """Round numbers to words.

    Parameters
    ----------
    numbers : (n,)
    width : int, optional
        Bits of a word, the sign among them; without it as many as are needed.
    fraction : int, optional
        Bits behind the point; without it as many as a given width leaves, or as few as keep every rounding error
        below `error_ppm`.
    error_ppm : float, optional
        Largest rounding error, ppm of each number.

    Raises
    ------
    ValueError
        A number is not finite, or does not fit into the width.

    Examples
    --------
    >>> found = round_to_words([2.4615, 24.615], error_ppm=10.0)
    >>> found.width, found.fraction, found.words, found.error_ppm.round(1).tolist()
    (20, 14, (40329, 403292), [-5.4, -0.4])
    >>> round_to_words([100.0], width=8, fraction=2)
    Traceback (most recent call last):
    ValueError: 100 with 2 bits behind the point takes 10 bits, not 8
    """
    exact = np.atleast_1d(np.asarray(numbers, dtype=np.float64))
    if exact.size == 0 or not np.all(np.isfinite(exact)):
        raise ValueError("there is no number to round, or one that is not finite")
    if fraction is None:
        fraction = _fraction_for(exact, width, error_ppm)
    words = tuple(round(float(one) * 2.0**fraction) for one in exact)
    needed = max(_bits(word) for word in words)
    if width is not None and needed > width:
        largest = float(exact[np.argmax([_bits(word) for word in words])])
        raise ValueError(f"{largest:.6g} with {fraction} bits behind the point takes {needed} bits, not {width}")
    if needed > LONGEST_WORD:
        raise ValueError(
            f"the numbers take {needed} bits; words have {LONGEST_WORD} at most: allow a larger error"
        )
    values = np.array([math.ldexp(word, -fraction) for word in words], dtype=np.float64)
    error = values - exact
    relative = np.full(exact.size, np.nan)
    np.divide(_PPM * error, np.abs(exact), out=relative, where=exact != 0)
    return FixedPoint(needed if width is None else width, fraction, words, values, error, relative)


def _bits(word: int) -> int:
    """Bits of two's complement that hold a word."""
    return (word if word >= 0 else -word - 1).bit_length() + 1


def _fraction_for(exact: Floats, width: int | None, error_ppm: float) -> int:
    if width is not None:
        largest = float(np.abs(exact).max())
        fraction = width - 1 - (math.frexp(largest)[1] if largest else 0)
        # a number next to a power of two may round up to it
        while max(_bits(round(float(one) * 2.0**fraction)) for one in exact) > width:
            fraction -= 1
        return fraction
    smallest = float(np.abs(exact[exact != 0]).min()) if np.any(exact) else 1.0
    # half a unit in the last place is within the error at the latest here
    last = min(max(0, math.ceil(-math.log2(2 * error_ppm / _PPM * smallest))), _MOST_FRACTION)
    for fraction in range(last + 1):
        rounded = np.round(exact * 2.0**fraction) * 2.0**-fraction
        if np.all(np.abs(rounded - exact) <= error_ppm / _PPM * np.abs(exact)):
            return fraction
    return last
