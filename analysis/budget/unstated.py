"""Bounds for what nobody has stated or measured: what is not known is not zero.

Each bound is the half width of a rectangular distribution: inside it everything is taken to be equally likely. It
is meant for a photodiode, its amplifier and an eight-bit oscilloscope with records that show nothing suspicious;
whoever knows more states it, and whoever measures it does best.
"""

from __future__ import annotations

SECOND_ORDER_LIMIT = 0.01
"""Second harmonic that the receiver makes of a pure sine as large as the beat, over the sine: -40 dBc.

Eight-bit oscilloscopes show -45 to -55 dBc near full scale, a photodiode with its amplifier in linear use less;
the worst of the former, with some of the latter in phase, is -40 dBc."""

THIRD_ORDER_LIMIT = 0.01
"""The same for the third harmonic, and the same reasons. A record shows much of it: the third harmonic of the beat
itself is r^2, and what stands beside it is seen as soon as it stands out of the noise."""

THIRD_ORDER_ON_RATIO = 1.0
"""Largest relative change of r for a third harmonic h of the receiver, over h, at every rate alike; its sign is
that of -cos(2 delta), delta the readout less the backscatter phase.

s + k s^3 makes h = k/4 and turns the second harmonic by 1 - 3 h exp(2 i delta). A geometric series that is fitted
to the waveform sees the third harmonic too, and takes two of the three back."""

THIRD_ORDER_LEAK = 0.3
"""What the same third harmonic leaks into r, over h, times the periods in a record."""

LOWEST_BANDWIDTH_OVER_BEAT = 5.0
"""-3 dB bandwidth of the channel (one pole) over the slowest beat of a run.

An amplifier or a filter against noise is chosen for the beat, so its corner scales with it. At five times the
beat a pole takes 2 % off the fundamental and 7 % off the second harmonic; nobody who means to measure the
second harmonic takes a slower one on purpose. It costs 5.3 % of r."""

LOWEST_GAIN_CORNER_OVER_BEAT = 3.0
"""Corner of the laser's gain saturation, g_c/2 pi, over the slowest beat of a run.

It lies between tens of hertz in large rings and 17 kHz in small ones, so only the method's own condition, a beat
slow against the gain, bounds it: at three beats r has lost 5 % and its phase lags by 18 degrees."""

LOWEST_GAIN_CORNER_HZ = 5000.0
"""What is computed for a navigation gyro of 0.28 m with a net gain of 3e-5: where three beats would be more than
this, this is the bound, since a fast beat does not make the gain faster."""

SCALE_FACTOR_LIMIT = 0.01
"""Relative error of a scale factor that stands on a data sheet or a type plate: rounded, and of another unit."""

TIME_BASE_LIMIT_PPM = 50.0
"""Data sheet of the TDS2014."""

AC_CORNER_HZ = 10.0
"""Lower -3 dB corner of the oscilloscope's AC coupling with a direct cable, where nobody says that it was set to
DC."""

TABLE_RATE_LIMIT = 1e-3
"""Relative error of the rate that a table shows, or that somebody reads from it."""

LATITUDE_LIMIT_DEG = 0.1
"""Of a bench whose latitude was looked up for its town."""

BIAS_LIMIT_DPH = 0.03
"""Bias of the gyro, deg/h: some three times that of a navigation gyro. A discharge whose two arms carry different
currents makes degrees per hour; who measures lock-in balances it first."""

FRONT_END_LIMIT = 0.1
"""Relative error of a corner or of a response that the records were freed of: parts of 10 %."""


def lowest_bandwidth(slowest_beat_hz: float) -> float:
    """Lowest -3 dB bandwidth of a channel of which nobody said anything, Hz.

    Examples
    --------
    >>> lowest_bandwidth(160.0)
    800.0
    """
    return LOWEST_BANDWIDTH_OVER_BEAT * slowest_beat_hz


def lowest_gain_corner(slowest_beat_hz: float) -> float:
    """Lowest corner of the laser's gain of which nobody said anything, Hz.

    Examples
    --------
    >>> lowest_gain_corner(160.0), lowest_gain_corner(4000.0)
    (480.0, 5000.0)
    """
    return min(LOWEST_GAIN_CORNER_OVER_BEAT * slowest_beat_hz, LOWEST_GAIN_CORNER_HZ)
