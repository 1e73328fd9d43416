"""Facts of the TDS1000/TDS2000 family that driver, simulator and station all need: numbers of the data sheet."""

POINTS = 2500
"""Points of every record."""

DIVISIONS = 10
"""A record, and the screen, is so many divisions wide (user manual 071-1064-00, p. 156)."""

POINTS_PER_DIVISION = POINTS // DIVISIONS
"""XINCR is s/div over this."""

VERTICAL_DIVISIONS = 8
"""The screen is so many divisions high."""

LEVELS_PER_DIVISION = 25
"""Codes per vertical division, at one byte a point (programmer manual 071-1075-04, p. 2-84)."""

HIGHEST_CODE = 127
"""Channel codes stop at plus and minus this value: there the record is clipped."""

NO_DATA = -128
"""Code where the scope has no data: the moving blank of scan mode, an empty reference."""

TIME_BASES = tuple(float(f"{mantissa}e{decade}") for decade in range(-9, 2) for mantissa in (1, 2.5, 5))
"""Steps of the time base, s/div (071-1075-04, HORizontal:MAIn:SCAle); not every model has the fastest ones."""

VERTICAL_SCALES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Coarse steps of the vertical scale at the input, V/div (071-1075-04, CH<x>:SCAle)."""

SCAN_FROM = 0.1
"""From this s/div on, AUTO mode scans instead of waiting for triggers (071-1064-00, pp. 78 and 92)."""
