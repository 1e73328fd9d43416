"""Mathematics of the lock-in measurement, on arrays: no files, no instruments, no clock, no printing.

An *estimate* is what each record says, in arrays of the shape of the records.
A *fit* is one statement that many records make together.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from analysis.beam_swings import BeamModulation, beam_modulation
    from analysis.channel import ChannelResponse, correct_response
    from analysis.combine import combine_estimates
    from analysis.dead_band import DeadBand, find_dead_band, simulate_sweep
    from analysis.dithered import (
        CountsWalk,
        DitheredEstimate,
        combine_dithered,
        estimate_dithered,
        lock_in_of_random_walk,
        walk_of_counts,
    )
    from analysis.flags import DOUBTFUL, FATAL, Flag, describe_flag, flag_names
    from analysis.frequency_method import FrequencyFit, fit_frequencies
    from analysis.harmonics import HarmonicFit, fit_harmonics
    from analysis.lockin_equation import (
        beat_frequency,
        beat_signal,
        harmonic_ratio,
        input_rate_from_beat,
        lock_in_from_beat,
        lock_in_from_rate,
        rate_varying_beat,
    )
    from analysis.lockin_rate import LockInEstimate, estimate_lock_in
    from analysis.quadratures import QuadratureEstimate, QuadratureFlag, estimate_quadratures
    from analysis.rotation import EARTH_RATE_DPS, TiltFit, earth_rate_on_axis, rate_on_axis, tilt_from_fast_runs
    from analysis.several_rates import RatesFit, RatesFlag, fit_rate_ratios, fit_rates
    from analysis.single_beams import BeamsFit, BeamsKnowledge, fit_beams

__all__ = [  # noqa: RUF022 - in the order of the work, not of the alphabet
    # make a beat, and what the lock-in equation says of it
    "beat_frequency",
    "beat_signal",
    "harmonic_ratio",
    "input_rate_from_beat",
    "lock_in_from_beat",
    "lock_in_from_rate",
    "rate_varying_beat",
    "simulate_sweep",
    # one record
    "DOUBTFUL",
    "FATAL",
    "Flag",
    "HarmonicFit",
    "LockInEstimate",
    "QuadratureEstimate",
    "QuadratureFlag",
    "describe_flag",
    "estimate_lock_in",
    "estimate_quadratures",
    "fit_harmonics",
    "flag_names",
    "BeamModulation",
    "DitheredEstimate",
    "beam_modulation",
    "estimate_dithered",
    # many records
    "BeamsFit",
    "BeamsKnowledge",
    "DeadBand",
    "FrequencyFit",
    "RatesFit",
    "RatesFlag",
    "combine_dithered",
    "combine_estimates",
    "find_dead_band",
    "fit_beams",
    "fit_frequencies",
    "fit_rate_ratios",
    "fit_rates",
    "lock_in_of_random_walk",
    "CountsWalk",
    "walk_of_counts",
    # the bench: rotation, tilt, channel
    "ChannelResponse",
    "EARTH_RATE_DPS",
    "TiltFit",
    "correct_response",
    "earth_rate_on_axis",
    "rate_on_axis",
    "tilt_from_fast_runs",
]


# a name is imported when it is first used: most programs need few of them
_HOMES = {
    "analysis.channel": ("ChannelResponse", "correct_response"),
    "analysis.combine": ("combine_estimates",),
    "analysis.dead_band": ("DeadBand", "find_dead_band", "simulate_sweep"),
    "analysis.dithered": (
        "DitheredEstimate",
        "CountsWalk",
        "combine_dithered",
        "estimate_dithered",
        "lock_in_of_random_walk",
        "walk_of_counts",
    ),
    "analysis.flags": ("DOUBTFUL", "FATAL", "Flag", "describe_flag", "flag_names"),
    "analysis.frequency_method": ("FrequencyFit", "fit_frequencies"),
    "analysis.harmonics": ("HarmonicFit", "fit_harmonics"),
    "analysis.lockin_equation": (
        "beat_frequency",
        "beat_signal",
        "harmonic_ratio",
        "input_rate_from_beat",
        "lock_in_from_beat",
        "lock_in_from_rate",
        "rate_varying_beat",
    ),
    "analysis.lockin_rate": ("LockInEstimate", "estimate_lock_in"),
    "analysis.quadratures": ("QuadratureEstimate", "QuadratureFlag", "estimate_quadratures"),
    "analysis.rotation": (
        "EARTH_RATE_DPS",
        "TiltFit",
        "earth_rate_on_axis",
        "rate_on_axis",
        "tilt_from_fast_runs",
    ),
    "analysis.several_rates": ("RatesFit", "RatesFlag", "fit_rate_ratios", "fit_rates"),
    "analysis.beam_swings": ("BeamModulation", "beam_modulation"),
    "analysis.single_beams": ("BeamsFit", "BeamsKnowledge", "fit_beams"),
}


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            found = globals()[name] = getattr(importlib.import_module(home), name)
            return found
    raise AttributeError(f"module 'analysis' has no attribute {name!r}")
