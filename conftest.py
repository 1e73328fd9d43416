"""Settings that must stand before NumPy is imported anywhere in the tests, and how hard property tests search."""

import atexit
import importlib.util
import os
import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

from station.files import keep_for_batches

# Small matrices: threads of the linear algebra library only get in the way of the parallel test processes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Programs that the tests start say here how they stand, and not beside those of the user.
os.environ.setdefault("GYROLOCK_STATE", str(Path(tempfile.gettempdir()) / "gyrolock-tests"))

# As in the commands: the memory of large arrays is kept for the next ones.
keep_for_batches()

# Each test process has instruments of its own: two of them may open the same made-up name at the same time.
os.environ["GYROLOCK_LOCKS"] = tempfile.mkdtemp(prefix="gyrolock-locks-")
atexit.register(shutil.rmtree, os.environ["GYROLOCK_LOCKS"], ignore_errors=True)

# The same examples in every run: a red test is the work of the last change. `make explore` searches freely.
settings.register_profile("fixed", derandomize=True, database=None, deadline=None, max_examples=50)
settings.register_profile("explore", derandomize=False, deadline=None, max_examples=5000, print_blob=True)
settings.load_profile("fixed")

# Doctests are looked for in every module; those of a framework that is not installed cannot be imported.
_FRAMEWORKS = {"pymeasure": "pymeasure", "qcodes": "qcodes", "ophyd": "ophyd_async"}
collect_ignore = [
    f"instrument/adapters/{name}_scope.py"
    for name, framework in _FRAMEWORKS.items()
    if importlib.util.find_spec(framework) is None
]


@pytest.hookimpl(trylast=True)  # after the order is drawn
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes longest begins first, in every process: none is left alone with it at the end."""
    long = [item for item in items if item.get_closest_marker("long")]
    items[:] = [item for item in items if not item.get_closest_marker("long")]
    quarter = len(items) // 4
    for place, item in enumerate(long):
        items.insert(place % 4 * (quarter + 1), item)
