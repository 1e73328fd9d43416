"""A record whose rate moves, whose intensity drifts or whose baseline moves, fitted with the exact equation.

In the order of work: `signs_of_motion` (is it one of these), `first_phase` (the phase read from the samples),
`matching` (a linear fit of the motion to that phase), `trajectory` (all phases and all parameters together, on the
exact steps of `exact_steps`), `choice` (how many terms), `rate_step` (or one step of rate or time base), and
`moving_fit` leads it through.
"""

from analysis.waveform.moving_rate.moving_fit import MovingFit, fit_moving_rate
from analysis.waveform.moving_rate.signs_of_motion import may_be_motion

__all__ = ["MovingFit", "fit_moving_rate", "may_be_motion"]
