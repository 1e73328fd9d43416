"""Several channels of one acquisition, and records one after the other."""

import itertools

import pytest

from instrument import SettingError, TransferError
from instrument.simulated import Fault


def test_channels_of_one_acquisition(bench, bench_scope):
    before = bench_scope.acquisition.record
    first, second = bench.acquire(("CH1", 2))
    assert first.preamble.wfid.startswith("Ch1")
    assert second.preamble.wfid.startswith("Ch2")
    assert first.times.tolist() == second.times.tolist()
    # Half the amplitude in phase, as only the same acquisition can show.
    assert abs(first.volts - 2 * second.volts).max() < 0.05
    assert bench_scope.acquisition.record is not before
    assert bench.acquire([2])[0].preamble.wfid.startswith("Ch2")


def test_no_channel_at_all(bench):
    with pytest.raises(SettingError, match="at least one"):
        bench.acquire(())


def test_time_base_turned_between_two_channels(bench, bench_scope):
    bench.acquire((1, 2))
    bench_scope.faults.add(
        Fault(
            "knob turned", in_answer=b"#42500", answer=1, command="HORIZONTAL:SCALE 5E-4;:ACQUIRE:STATE RUN;*WAI"
        )
    )
    with pytest.raises(TransferError):
        bench.acquire((1, 2))
    assert bench_scope.faults.happened
    first, second = bench.acquire((1, 2))
    assert first.sample_interval == second.sample_interval == pytest.approx(2e-6)


def test_records_one_after_the_other(bench, bench_scope):
    numbers = []
    for waveform in bench.records(1, 3):
        assert waveform.codes.shape == (2500,)
        numbers.append(bench_scope.acquisition.record.number)
    assert len(set(numbers)) == 3
    assert len(list(itertools.islice(bench.records(1), 2))) == 2


def test_damaged_record_is_taken_anew(bench, bench_scope):
    bench.acquire(1)
    bench_scope.faults.add(Fault("lost byte", answer=1, bytes_sent=1200))
    assert len(list(bench.records(1, 2))) == 2
    assert len(bench_scope.faults.happened) == 1
    bench_scope.faults.add(Fault("lost byte", shortest=2000, bytes_sent=1200))
    with pytest.raises(TransferError):
        list(bench.records(1, 2, attempts=2))
    assert len(bench_scope.faults.happened) == 3
