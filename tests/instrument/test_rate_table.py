"""The table that a person turns: what is asked, and which answers are taken."""

import pytest

from instrument import LinkError, ManualRateTable, RateTable


def table_with(*answers: str) -> tuple[ManualRateTable, list[str]]:
    questions: list[str] = []
    replies = iter(answers)

    def ask(question: str) -> str:
        questions.append(question)
        return next(replies)

    return ManualRateTable(ask=ask, azimuth_deg=12.5), questions


def test_enter_means_as_asked():
    table, questions = table_with("")
    table.set_rate(-2.5)
    assert table.rate() == -2.5
    assert "-2.5 deg/s" in questions[0]
    assert table.azimuth() == 12.5


def test_operator_types_what_the_table_shows():
    table, questions = table_with("fast", "2,51")
    table.set_rate(2.5)
    assert table.rate() == 2.51
    assert "not a number" in questions[1]


@pytest.mark.parametrize("typed", ["-2.5", "25", "0.25", "2.8", "0"])
def test_another_rate_than_was_asked_for_is_asked_for_again(typed: str) -> None:
    table, questions = table_with(typed, "")
    table.set_rate(2.5)
    assert table.rate() == 2.5  # it was set right
    assert f"not at {float(typed):+.6g}. If it does, type it again" in questions[1]
    table, questions = table_with(typed, typed)
    table.set_rate(2.5)
    assert table.rate() == float(typed)
    assert len(questions) == 2


@pytest.mark.parametrize("typed", ["nan", "inf", "-inf", "1e999"])
def test_a_rate_that_is_no_number_is_not_taken(typed: str) -> None:
    table, questions = table_with(typed, "2.4")
    table.set_rate(2.5)
    assert table.rate() == 2.4
    assert "is not a number" in questions[1]


def test_a_table_that_goes_on_turning_is_asked_about() -> None:
    table, questions = table_with("", "1.0", "")
    table.set_rate(1.0)
    table.close()
    assert table.rate() == 0.0
    assert "not at +1" in questions[2]


def test_closing_stops_a_turning_table_once():
    table, questions = table_with("", "")
    table.close()
    assert questions == []
    table.set_rate(1.0)
    table.close()
    assert table.rate() == 0.0
    assert "+0 deg/s" in questions[1]


def test_nobody_to_ask():
    def ask(_: str) -> str:
        raise EOFError

    with pytest.raises(LinkError, match="terminal"):
        ManualRateTable(ask=ask).set_rate(1.0)


def test_it_is_a_rate_table():
    table: RateTable = ManualRateTable()
    assert table.rate() == 0.0
