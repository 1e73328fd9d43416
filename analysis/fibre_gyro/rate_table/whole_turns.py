"""Windows of whole turns of the rate table: the horizontal earth rate averages out.

A gyro whose axis is not exactly along the vertical table axis sees the horizontal earth rate as a sine of one
period a turn. Over a whole number of turns its mean is zero; over 30.15 turns it is not. A window of fixed
length is whole turns at one rate only, so every rate has a window of its own: M 360/Omega.
"""

from __future__ import annotations

import numpy as np


def turn_time(rate_dps: float) -> float:
    """Time of one turn of the table in s, either sense.

    Raises
    ------
    ValueError
        The table does not turn.

    Examples
    --------
    >>> turn_time(-20.0)
    18.0
    """
    if not abs(rate_dps) > 0 or not np.isfinite(rate_dps):
        raise ValueError(f"a table at {rate_dps:g} deg/s makes no turns: give a rate other than zero")
    return 360.0 / abs(rate_dps)


def whole_turns_in(duration_s: float, rate_dps: float, *, tolerance_s: float = 0.0) -> int:
    """Largest number of whole turns that fits into a record of `duration_s`.

    Parameters
    ----------
    tolerance_s : float, optional
        So much may be missing at the end: usually one sample interval.

    Raises
    ------
    ValueError
        Not one turn fits.

    Examples
    --------
    >>> whole_turns_in(540.0, 20.0), whole_turns_in(540.0, 21.0)
    (30, 31)
    """
    turn = turn_time(rate_dps)
    turns = int(np.floor((duration_s + tolerance_s) / turn * (1 + 1e-12)))
    if turns < 1:
        raise ValueError(
            f"{duration_s:.6g} s at {abs(rate_dps):g} deg/s is {duration_s / turn:.3f} of a turn: "
            f"record at least {turn:.6g} s"
        )
    return turns


def check_whole_turns(duration_s: float, rate_dps: float, *, tolerance_s: float) -> int:
    """Number of turns of a window that was chosen by its length; refuses one that is not whole turns.

    Parameters
    ----------
    tolerance_s : float
        A window may be off by so much: usually one sample interval.

    Raises
    ------
    ValueError
        With the two windows that are whole turns.

    Examples
    --------
    >>> check_whole_turns(540.0, 20.0, tolerance_s=0.01)
    30
    """
    turn = turn_time(rate_dps)
    turns = round(duration_s / turn)
    if turns >= 1 and abs(duration_s - turns * turn) <= tolerance_s * (1 + 1e-9):
        return turns
    below = int(duration_s / turn)
    choices = [f"{count} turns = {count * turn:.3f} s" for count in (below, below + 1) if count >= 1]
    raise ValueError(
        f"a window of {duration_s:.6g} s at {abs(rate_dps):g} deg/s is {duration_s / turn:.3f} turns, not a whole "
        f"number: use {' or '.join(choices)}"
    )
