"""The driver in other people's frameworks, one file each: PyMeasure, QCoDeS, ophyd-async.

Each maps the methods of `instrument.TDS2014` to the words of its framework and knows nothing of the scope itself.
A framework is imported by its own file only (`pip install 'gyrolock[frameworks]'`).
"""
