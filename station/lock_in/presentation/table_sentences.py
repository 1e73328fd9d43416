"""The check by the rate table in plain sentences: what it shows, and what it cannot."""

from __future__ import annotations

from analysis.lock_in_run import ScaleFactorCheck, TableCheck
from station.lock_in.found import LockInFound
from station.results.numbers import with_uncertainty

_WAYS = {
    "known tilt": "the tilt that is known without the gyro",
    "earth rate": "the earth rate, which swings with the azimuth",
}


def table_sentences(found: LockInFound) -> list[str]:
    """Say whether beat, harmonics and table fit together, and whether anything tests the scale factor."""
    check = found.table_check
    if check is None:
        return []
    used = found.method.scale_factor
    return [
        _beat_over_table(check, found.lock_in_rate),
        *(_scale_factor(one, used) for one in check.scale_factors),
        _unseen(check),
    ]


def beat_over_table_words(check: TableCheck) -> str:
    """Return beat over table with its uncertainty."""
    return with_uncertainty(check.beat_over_table, check.beat_over_table_u)


def by_table_words(check: TableCheck) -> str:
    """Return the lock-in rate by the table; its u leaves out detector and channel."""
    return f"{with_uncertainty(check.lock_in_rate, check.lock_in_rate_u, 'deg/s')} (u by noise and table)"


def _beat_over_table(check: TableCheck, lock_in_rate: float) -> str:
    over = (check.beat_over_table - 1) / check.beat_over_table_u
    verdict = "as far as this check sees, they fit together"
    if check.unexplained:
        verdict = "they do not fit together, by more than chance and all that the budget counts explain"
    elif check.mismatch:
        verdict = (
            "more than chance explains, but not more than the budget counts for what is not known of detector and "
            "channel"
        )
    seen = f"{100 * check.least_error_seen:.2g} %"
    text = (
        f"Beat over table is {beat_over_table_words(check)}, {over:+.1f} u from 1: {verdict}. An error of the "
        f"lock-in rate by the harmonics (a slow channel, distortion) shows here from {seen} on."
    )
    if not check.mismatch or not check.by_frequencies > 0:
        return text
    alone = with_uncertainty(check.by_frequencies, check.by_frequencies_u, "deg/s")
    off = 100 * (lock_in_rate / check.by_frequencies - 1)
    return (
        f"{text} By the beat frequencies alone, without the harmonics, the lock-in rate is {alone}; that by the "
        f"harmonics is {off:+.2g} % from it."
    )


def _scale_factor(one: ScaleFactorCheck, used: float) -> str:
    found = with_uncertainty(one.scale_factor, one.scale_factor_u, "pulses/deg")
    text = f"By {_WAYS[one.by]}, the scale factor is {found}; {used:g} was used"
    if one.p_value < 0.001:
        wrong = 100 * (one.scale_factor / used - 1)
        return (
            f"{text}. They differ by {wrong:+.2g} %, more than chance explains, and by so much the lock-in rate "
            "is then wrong: measure the scale factor, or look for a wrong angle, latitude or table rate, or a "
            "bias of the gyro."
        )
    return f"{text}, which agrees."


def _unseen(check: TableCheck) -> str:
    text = (
        "The tilt was found with the same scale factor, and an error of it is absorbed there: scale factor, tilt "
        "and lock-in rate change together, and beat over table moves by what the earth's rate does not share only."
    )
    if check.scale_factors:
        return f"{text} Only what is said above of the scale factor tests it."
    return (
        f"{text} Nothing in these records tests the scale factor; a tilt known without the gyro "
        "(table.known_tilt_deg), or records with the table's azimuth in both senses, would."
    )
