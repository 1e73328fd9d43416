"""Maximum-likelihood fit of the lock-in waveform to records as they come.

A record meets, in this order: `records` (checked, centred), `damage` (clipped samples), `frequency_search` (first
guess), `series_fit` (the fit: `series_start` where the guess is not plain, `minimise` on the normal equations of
`tied_equations` or `sampled_equations`), `quantisation` (rounding that is not noise), `residuals` (is it white, is
it a beat at all), `moving_rate` (a rate, an intensity or a baseline that moved), and `waveform_fit` leads it
through.
"""

from analysis.waveform.fit import WaveformFit, fit_waveform
from analysis.waveform.frequency import Stack, as_stack

__all__ = ["Stack", "WaveformFit", "as_stack", "fit_waveform"]
