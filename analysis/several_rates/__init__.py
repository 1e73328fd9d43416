"""Lock-in rate from records at several rates, free of distortion and of the gain's delay: see `fit`."""

from analysis.several_rates.fit import COUNTED, fit_again, fit_rate_ratios, fit_rates
from analysis.several_rates.ratio_model import RatioData, Reference, predicted_ratio, prior_of
from analysis.several_rates.result import Model, RatesFit, RatesFlag
