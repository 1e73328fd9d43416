"""Pull, coverage and flags of the fit over several rates."""
