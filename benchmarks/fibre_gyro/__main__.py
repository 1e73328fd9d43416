"""`python -m benchmarks.fibre_gyro`: the simulated loop beside its laws (`loop`)."""

import sys

from benchmarks.fibre_gyro.loop import main

sys.exit(main())
