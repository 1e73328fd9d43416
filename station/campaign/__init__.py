"""A campaign: what a unit is tested with, in which order, against which limits; and how the test has ended."""
