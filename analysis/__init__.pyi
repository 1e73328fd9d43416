from .beam_swings import BeamModulation as BeamModulation, beam_modulation as beam_modulation
from .channel import ChannelResponse as ChannelResponse, correct_response as correct_response
from .combine import combine_estimates as combine_estimates
from .dead_band import DeadBand as DeadBand, find_dead_band as find_dead_band, simulate_sweep as simulate_sweep
from .dithered import (
    CountsWalk as CountsWalk,
    DitheredEstimate as DitheredEstimate,
    combine_dithered as combine_dithered,
    estimate_dithered as estimate_dithered,
    lock_in_of_random_walk as lock_in_of_random_walk,
    walk_of_counts as walk_of_counts,
)
from .flags import (
    DOUBTFUL as DOUBTFUL,
    FATAL as FATAL,
    Flag as Flag,
    describe_flag as describe_flag,
    flag_names as flag_names,
)
from .frequency_method import FrequencyFit as FrequencyFit, fit_frequencies as fit_frequencies
from .harmonics import HarmonicFit as HarmonicFit, fit_harmonics as fit_harmonics
from .lockin_equation import (
    beat_frequency as beat_frequency,
    beat_signal as beat_signal,
    harmonic_ratio as harmonic_ratio,
    input_rate_from_beat as input_rate_from_beat,
    lock_in_from_beat as lock_in_from_beat,
    lock_in_from_rate as lock_in_from_rate,
    rate_varying_beat as rate_varying_beat,
)
from .lockin_rate import LockInEstimate as LockInEstimate, estimate_lock_in as estimate_lock_in
from .quadratures import (
    QuadratureEstimate as QuadratureEstimate,
    QuadratureFlag as QuadratureFlag,
    estimate_quadratures as estimate_quadratures,
)
from .rotation import (
    EARTH_RATE_DPS as EARTH_RATE_DPS,
    TiltFit as TiltFit,
    earth_rate_on_axis as earth_rate_on_axis,
    rate_on_axis as rate_on_axis,
    tilt_from_fast_runs as tilt_from_fast_runs,
)
from .several_rates import (
    RatesFit as RatesFit,
    RatesFlag as RatesFlag,
    fit_rate_ratios as fit_rate_ratios,
    fit_rates as fit_rates,
)
from .single_beams import BeamsFit as BeamsFit, BeamsKnowledge as BeamsKnowledge, fit_beams as fit_beams
