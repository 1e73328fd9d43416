"""What records, or what is stated of a bench, do not give; a call that is wrong in itself is a ValueError."""


class NoFit(ValueError):
    """The records do not determine what was to be fitted; the text says what would."""


class NoTilt(ValueError):
    """Beats and table rates of the fast run do not belong together."""


class NoBudget(ValueError):
    """A result has no uncertainty budget; the text says why."""


class OutsideResponse(ValueError):
    """A frequency at which the measured response of a channel is not known."""


class OneRateOnly(ValueError):
    """A method for records at one rate was asked of records at several."""
