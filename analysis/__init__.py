"""Mathematics of the lock-in measurement, on arrays: no files, no instruments, no clock, no printing."""

from analysis.channel import ChannelResponse, correct_response
from analysis.combine import combine_estimates
from analysis.dead_band import DeadBand, find_dead_band, simulate_sweep
from analysis.flags import FATAL, Flag, describe_flag, flag_names
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
from analysis.several_rates import fit_rate_ratios, fit_rates
from analysis.several_rates.result import RatesFit, RatesFlag

__all__ = [
    "EARTH_RATE_DPS",
    "FATAL",
    "ChannelResponse",
    "DeadBand",
    "Flag",
    "FrequencyFit",
    "HarmonicFit",
    "LockInEstimate",
    "QuadratureEstimate",
    "QuadratureFlag",
    "RatesFit",
    "RatesFlag",
    "TiltFit",
    "beat_frequency",
    "beat_signal",
    "combine_estimates",
    "correct_response",
    "describe_flag",
    "earth_rate_on_axis",
    "estimate_lock_in",
    "estimate_quadratures",
    "find_dead_band",
    "fit_frequencies",
    "fit_harmonics",
    "fit_rate_ratios",
    "fit_rates",
    "flag_names",
    "harmonic_ratio",
    "input_rate_from_beat",
    "lock_in_from_beat",
    "lock_in_from_rate",
    "rate_on_axis",
    "rate_varying_beat",
    "simulate_sweep",
    "tilt_from_fast_runs",
]
