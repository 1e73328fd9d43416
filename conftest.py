"""Settings that must stand before NumPy is imported anywhere in the tests."""

import os

# Small matrices: threads of the linear algebra library only get in the way of the parallel test processes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
