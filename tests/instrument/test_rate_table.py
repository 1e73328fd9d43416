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
