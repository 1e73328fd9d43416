"""Records over a link that spoils two answers in a hundred: each one right or refused, none wrong."""

import pytest

from benchmarks import faults


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 14])
def test_records_are_right_or_refused(seed):
    outcome = faults.run(1200, seed=seed)
    assert outcome.wrong == 0
    assert outcome.records == 1200
    assert outcome.right > 1100
    # The faults did happen, and some of them were felt.
    assert len(outcome.faults) >= len(faults.KINDS) - 1
    assert outcome.refused["TransferError"] > 5
    assert outcome.refused["LinkError"] > 2
    # A refusal takes no longer than the driver's own time limits, however late the answer is.
    assert outcome.longest_refusal < 15


def test_a_wrong_record_would_be_noticed(monkeypatch, capsys):
    truth = faults.is_what_the_scope_holds

    def another_record(waveform, scope):
        list(scope.execute(b"CH1:POSITION 1;:ACQUIRE:STATE RUN"))
        scope.clock.sleep(1)
        return truth(waveform, scope)

    monkeypatch.setattr(faults, "is_what_the_scope_holds", another_record)
    assert faults.main(["--records", "5"]) == 1
    assert "4 wrong" in capsys.readouterr().out
