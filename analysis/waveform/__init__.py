"""Maximum-likelihood fit of the lock-in waveform to records as they come.

A record meets, in this order: `frequency` (checked, centred, first values), `converter` (what not to believe),
`series_fit` on the equations of `series`, `residuals` (is it white, is it a beat at all), and where the rate moves
`smooth_phase`, else `varying_rate` on `trajectory`; `fit` leads it through.
"""
