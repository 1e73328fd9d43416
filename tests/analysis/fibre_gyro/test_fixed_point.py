"""Words of fixed point against exact fractions."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, strategies as st

from analysis.fibre_gyro import round_to_words

NUMBERS = st.lists(st.floats(-1e6, 1e6).filter(lambda x: x == 0 or abs(x) > 1e-6), min_size=1, max_size=5)


@given(NUMBERS, st.integers(0, 30))
def test_words_are_the_nearest_and_their_error_is_that_of_the_word(numbers: list[float], fraction: int) -> None:
    found = round_to_words(numbers, fraction=fraction)
    for exact, word, value, error in zip(numbers, found.words, found.values, found.error, strict=True):
        stands_for = Fraction(word, 2**fraction)
        assert abs(stands_for - Fraction(exact)) <= Fraction(1, 2 ** (fraction + 1))
        assert Fraction(value) == stands_for
        assert error == pytest.approx(float(stands_for - Fraction(exact)), rel=1e-6, abs=1e-12)
        assert -(2 ** (found.width - 1)) <= word < 2 ** (found.width - 1)
    # not wider than needed
    assert (
        any(not -(2 ** (found.width - 2)) <= word < 2 ** (found.width - 2) for word in found.words)
        or found.width == 1
    )


@given(NUMBERS, st.floats(0.1, 1e4))
def test_a_wanted_error_is_kept_by_the_fewest_bits(numbers: list[float], error_ppm: float) -> None:
    try:
        found = round_to_words(numbers, error_ppm=error_ppm)
    except ValueError as error:
        assert "words have 64 at most" in str(error)
        return
    assert found.largest_error_ppm <= error_ppm * (1 + 1e-9)
    if found.fraction:
        fewer = round_to_words(numbers, fraction=found.fraction - 1)
        assert fewer.largest_error_ppm > error_ppm * (1 - 1e-9)


@given(NUMBERS, st.integers(12, 40))
def test_a_given_width_is_used_to_its_last_bit(numbers: list[float], width: int) -> None:
    found = round_to_words(numbers, width=width)
    assert found.width == width
    if any(numbers):
        with pytest.raises(ValueError, match="bits"):
            round_to_words(numbers, width=width, fraction=found.fraction + 2)


def test_what_cannot_be_is_said() -> None:
    with pytest.raises(ValueError, match=r"100 with 2 bits behind the point takes 10 bits, not 8"):
        round_to_words([100.0], width=8, fraction=2)
    with pytest.raises(ValueError, match="words have 64 at most"):
        round_to_words([1e9, 1e-9], error_ppm=1e-3)
    with pytest.raises(ValueError, match="not finite"):
        round_to_words([float("nan")])
    assert np.isnan(round_to_words([0.0, 1.0]).error_ppm[0])
