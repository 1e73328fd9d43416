"""How good and how fast `analysis.estimate_lock_in` is, beside the other ways to read a beat record.

gyros     random gyros and their eight-bit records
bound     what no estimator can beat (Cramér-Rao)
methods   ours and the others, one signature
accuracy, coverage, speed    the three measurements, each returning plain dataclasses
tables, plots    how they are shown
"""

import os

# One thread each, or the ratios of times would depend on the machine's cores. NumPy reads this when it is first
# imported, and that is after this package.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"
