"""From the signal at the input to codes: front end, trigger, converter, acquisition."""
