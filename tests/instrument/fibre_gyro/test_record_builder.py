"""Time from the counter: wraps, missing frames, restarts."""

import numpy as np
import pytest

from instrument.fibre_gyro.frame_fields import CounterRule
from instrument.fibre_gyro.recording import CounterClock


def places(clock, steps):
    """Place frames of (counter, host time, silence, damaged); gives index and cause of each."""
    ticks = [clock.place(c, host_s=h, silent_s=s, damaged=d) for c, h, s, d in steps]
    return [None if tick is None else (tick.index, tick.cause) for tick in ticks]


def test_any_pattern_of_losses_is_placed_right():
    rng = np.random.default_rng(4)
    sent = np.flatnonzero(rng.random(20_000) < 0.3)  # most frames are lost, some dozens in succession
    clock = CounterClock(CounterRule(256, 3), 0.01)
    found = places(clock, [((int(n) * 3 + 77) % 256, n * 0.01 + rng.uniform(0, 0.1), 0.0, 0) for n in sent])
    assert [index for index, _ in found] == (sent - sent[0]).tolist()
    assert [cause == "frames lost" for _, cause in found[1:]] == (np.diff(sent) > 1).tolist()


def test_silence_longer_than_the_wrap_is_bridged_by_the_host():
    clock = CounterClock(CounterRule(16), 0.1)
    # 16 frames last 1.6 s; 5.0 s of silence are 50 frames, three whole wraps more than the counter shows.
    assert places(clock, [(3, 0.0, 0, 0), (5, 5.15, 5.0, 0)]) == [(0, ""), (50, "frames lost")]


def test_a_stalled_host_is_no_silence():
    clock = CounterClock(CounterRule(16), 0.1)
    # Nothing was read for 5 s because the program was busy; the frames had waited.
    assert places(clock, [(3, 0.0, 0, 0), (4, 5.0, 0.0, 0), (5, 5.0, 0.0, 0)]) == [(0, ""), (1, ""), (2, "")]


def test_counter_set_anew_goes_by_the_host():
    clock = CounterClock(CounterRule(65536), 0.01)
    steps = [(100, 0.0, 0, 0), (101, 0.01, 0, 0), (0, 0.02, 0, 0), (1, 0.03, 0, 0)]
    assert places(clock, steps) == [(0, ""), (1, ""), (2, "counter jump"), (3, "")]


def test_counter_between_frames_is_a_jump():
    clock = CounterClock(CounterRule(65536, per_frame=10), 0.01)
    assert places(clock, [(0, 0, 0, 0), (10, 0.01, 0, 0), (25, 0.05, 0, 0)])[-1] == (5, "counter jump")


def test_counter_that_stands_still():
    clock = CounterClock(CounterRule(256), 0.01)
    assert places(clock, [(7, 0, 0, 0), (7, 0.01, 0, 0), (8, 0.02, 0, 0)]) == [(0, ""), None, (1, "")]


@pytest.mark.parametrize(
    ("silent", "damaged", "passed", "cause"),
    [(0.0, 0, 1, ""), (0.02, 0, 1, ""), (0.0, 3, 4, "frames lost"), (1.0, 0, 100, "silence")],
)
def test_without_a_counter_damage_and_silence_tell(silent, damaged, passed, cause):
    clock = CounterClock(None, 0.01)
    found = places(clock, [(None, 0, 0, 0), (None, 1, silent, damaged)])
    assert found[1] == (passed, cause)
