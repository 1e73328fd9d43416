"""Whether a beat may be no beat: a gyro that is shaken inside lock-in swings, and its swing is nearly a sine too.

Its phase follows the rate that shakes it, arc sine of W/WL. So the signal is a curve f of that rate: of its
harmonics the second stands in phase with the fundamental or against it, but for a small lag, and the third is
2/3 f' f'''/f''^2 of that of a beat with the same second harmonic: hardly ever as much. The smaller the swing, the
less of this can be seen; then its height has to tell, since whoever set the scale saw something larger.
"""

from __future__ import annotations

import numpy as np

from analysis.arrays import Complexes, Floats
from analysis.lockin_rate.beat import Beat

FEW_LEVELS = 16.0
"""Levels of amplitude below which a beat fills so little of the converter (127 levels) that whoever set it saw
something larger, or nothing like a beat."""

FEW_LEVELS_OF_A_SWING = 40.0
"""The same for a waveform that a gyro which swings inside lock-in may show. Vertical scales in steps of 1, 2, 5
leave more than that of a beat that was to fill the screen."""

FEW_LEVELS_WITHOUT_A_THIRD = 64.0
"""The same for one whose third harmonic is probably not that of a beat."""

LAGS, LAG_SCATTERS = 0.2, 2.0
"""rad by which the second harmonic of a swing may lag behind the fundamental, and standard uncertainties of its
phase beside them."""

QUICK_LAGS = 0.8
"""The same where the third harmonic speaks against a beat: a quick swing lags by more."""

SHOWS, CLOSE = 6.0, 5.0
"""Uncertainties that the third harmonic of a beat must have to show that it is one, and times by which it must
exceed what is amiss with it."""

PROBABLY = 3.0
"""Uncertainties beyond which it is probably not that of a beat: noise is so in one of 90 records."""


def fewest_levels(beat: Beat, third: Complexes, third_u: Floats) -> Floats:
    """Levels of the converter below which the amplitude of each record speaks against a beat, (R,)."""
    size, across = np.abs(beat.rho), np.abs(beat.rho.imag)
    scatter = LAG_SCATTERS * np.sqrt(np.maximum(beat.rho_covariance[:, 1, 1], 0.0))
    amiss = np.abs(third) > PROBABLY * third_u
    # the third harmonic of a beat is r times its second
    turns = size**2 > np.maximum(SHOWS * third_u, CLOSE * np.abs(third))
    in_phase, nearly = across < LAGS * size + scatter, across < np.sin(QUICK_LAGS) * size + scatter
    few = np.where(in_phase & ~turns, FEW_LEVELS_OF_A_SWING, FEW_LEVELS)
    return np.asarray(np.where(nearly & amiss, FEW_LEVELS_WITHOUT_A_THIRD, few))
