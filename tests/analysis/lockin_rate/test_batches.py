"""A record gives the same bits whatever records are analysed with it."""

from dataclasses import fields

import numpy as np

from analysis import beat_signal, estimate_lock_in
from analysis.waveform import fit

K, INTERVAL, SAMPLES = 9000.0, 2e-5, 800


def records_of_every_kind() -> np.ndarray:
    """Volts of quiet, noisy, clipped, spiked, blank, locked and coloured records, missing samples among them."""
    rng = np.random.default_rng(14)
    times = np.arange(SAMPLES) * INTERVAL
    records = []
    for number in range(45):
        ratio = rng.choice([0.01, 0.07, 0.3, 0.7, 0.97])
        rate = rng.uniform(0.02, 0.2)
        volts = beat_signal(
            times, scale_factor=K, input_rate=rate, lock_in_rate=ratio * rate, initial_phase=rng.uniform(0, 6)
        )
        noise = rng.choice([0.0, 0.1, 1.0, 8.0])
        codes = np.rint(rng.choice([30, 100, 140]) * volts + noise * rng.standard_normal(SAMPLES))
        if number % 7 == 1:
            codes[:] = rng.integers(-3, 3)
        if number % 7 == 2:
            codes[rng.integers(SAMPLES)] += 90
        if number % 7 == 3:
            codes += np.rint(np.cumsum(rng.standard_normal(SAMPLES)))
        codes = np.clip(codes, -127, 127).astype(float)
        if number % 5 == 4:
            codes[rng.integers(SAMPLES) :][:200] = np.nan
        records.append(0.04 * codes)
    return np.array(records)


VOLTS = records_of_every_kind()
CLIPPED = np.abs(VOLTS) >= 0.04 * 127


def estimates(order: np.ndarray, at_once: int) -> dict[str, np.ndarray]:
    """Estimates of the records in their own order, made in batches of another."""
    parts = []
    for first in range(0, len(order), at_once):
        rows = order[first : first + at_once]
        parts.append(
            estimate_lock_in(VOLTS[rows], INTERVAL, scale_factor=K, clipped=CLIPPED[rows], nan_policy="omit")
        )
    arrays = [one.name for one in fields(parts[0]) if isinstance(getattr(parts[0], one.name), np.ndarray)]
    back = np.argsort(order)
    return {name: np.concatenate([getattr(part, name) for part in parts])[back] for name in arrays}


def test_a_record_gives_the_same_bits_alone_and_in_any_batch(monkeypatch):
    together = estimates(np.arange(len(VOLTS)), len(VOLTS))
    assert len(np.unique(together["flags"])) > 8  # records of many kinds, so that every branch has its say
    shuffled = np.random.default_rng(1).permutation(len(VOLTS))
    # and with more that move than are worked on together
    for order, at_once, moving in ((np.arange(len(VOLTS)), 1, 256), (shuffled, 7, 256), (shuffled, 45, 3)):
        monkeypatch.setattr(fit, "MOVING_AT_ONCE", moving)
        apart = estimates(order, at_once)
        for name, values in together.items():
            assert values.tobytes() == apart[name].tobytes(), (name, at_once)
