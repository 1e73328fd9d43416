"""How long an answer is waited for: learned from those that came, doubled by silence."""

import pytest

from instrument.dialogue.retry import AnswerTimeout


def learned(*after: float, kind: str = "text") -> AnswerTimeout:
    patience = AnswerTimeout(0.5, 3.0)
    for seconds in after:
        patience.came(kind, seconds)
    return patience


def test_of_what_is_not_known_the_longest_is_waited() -> None:
    assert AnswerTimeout(0.5, 3.0).seconds("text") == 3.0
    assert learned(0.01, 0.01).seconds("text") == 3.0


def test_a_quick_instrument_is_waited_for_briefly_and_each_kind_by_itself() -> None:
    patience = learned(0.01, 0.01, 0.01)
    assert patience.seconds("text") == 0.5
    assert patience.seconds("record") == 3.0


def test_mean_and_spread_by_hand() -> None:
    # mean 0.4, spread 0.2; then spread 0.2 + (0.4 - 0.2)/4 = 0.25, mean 0.4 + 0.4/8 = 0.45;
    # then spread 0.25 + (0.05 - 0.25)/4 = 0.2, mean 0.45 - 0.05/8 = 0.44375: 2 * 0.44375 + 4 * 0.2
    assert learned(0.4, 0.8, 0.4).seconds("text") == pytest.approx(1.6875)


def test_each_silence_doubles_it_up_to_the_longest() -> None:
    patience = learned(0.01, 0.01, 0.01)
    waited = []
    for _ in range(4):
        patience.silent("text")
        patience.came("record", 0.01)
        waited.append(patience.seconds("text"))
    assert waited == [1.0, 2.0, 3.0, 3.0]
    patience.came("text", 0.01)
    assert patience.seconds("text") == 0.5


def test_one_that_always_thinks_long_is_given_the_time() -> None:
    assert learned(*[1.2] * 50).seconds("text") > 2 * 1.2
