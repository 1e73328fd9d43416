"""Dask workers against one process: python -m benchmarks.cluster [--records 40000].

Records of a saved run, each with noise of its own, are exported as parts, and every one is estimated: by this
process, by one and by two workers of a local cluster, and by two of which one is killed in the middle. The
estimates must be the same, bit for bit.
"""

from __future__ import annotations

import argparse
import os
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from station.datasets.data_set import export, sources_of
from station.lock_in.estimate import Piece, estimate_pieces, pieces_of, together
from station.runs.store import NewRecord, RunWriter, open_run
from station.sources import open_source
from station.sources.workers import Cluster, ThisProcess, Workers
from station.terminal import say

RUN = Path(__file__).parents[1] / "tests" / "golden" / "single.sqlite"
AT_ONCE = 1000


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=40_000)
    count = parser.parse_args().records
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        export([open_source(saved(Path(folder), count))], f"{folder}/parts/", records_of_part=10_000)
        size = sum(path.stat().st_size for path in Path(folder, "parts").iterdir())
        say(f"{count} records, {size / 1e6:.0f} MB of Parquet, made in {time.perf_counter() - began:.0f} s")
        (source,) = sources_of(f"{folder}/parts/")
        pieces = pieces_of(source, {})
        estimate_pieces(pieces[0])  # the first use of a module takes its time
        alone, expected = measured("one process", ThisProcess(), pieces, count)
        for workers in (1, 2):
            with cluster(workers) as of:
                took, found = measured(f"Dask, {workers} worker{'s' * (workers > 1)}", of, pieces, count)
                assert found == expected
                say(f"{'':24}{alone / took:8.2f} times one process")
                if workers == 2:
                    killed, found = measured("one of 2 is killed", of, pieces, count, kill=len(pieces) // 3)
                    assert found == expected
                    say(f"{'':24}{killed - took:8.2f} s more")
        say("the estimates are the same, bit for bit")


@contextmanager
def cluster(workers: int) -> Iterator[Cluster]:
    """A local one that has imported what it needs."""
    began = time.perf_counter()
    with Cluster("local", workers) as opened:
        say(f"start of {workers} worker{'s' * (workers > 1)}: {time.perf_counter() - began:15.1f} s")
        list(opened.map(estimate_pieces, [[]] * 8 * workers))
        yield opened


def measured(
    name: str, workers: Workers, pieces: list[list[Piece]], count: int, kill: int = -1
) -> tuple[float, bytes]:
    """Estimate all records, say how long it took, and return that and the bits."""
    pids = list(workers._client.run(os.getpid).values()) if isinstance(workers, Cluster) else []  # noqa: SLF001
    began, found = time.perf_counter(), []
    for number, (one,) in enumerate(workers.map(estimate_pieces, pieces)):
        found.append(one)
        if number == kill:
            os.kill(pids[0], signal.SIGKILL)
    took = time.perf_counter() - began
    say(f"{name:24}{took:8.2f} s {count / took:8.0f} records/s")
    each = together(found).each
    assert each is not None
    fields = (each.lock_in_rate, each.lock_in_rate_u, each.flags)
    return took, b"".join(np.asarray(field).tobytes() for field in fields)


def saved(folder: Path, count: int) -> Path:
    """Save a run of so many records."""
    run, draw = open_run(RUN), np.random.default_rng(1)
    kinds = [record for record in run.records if record.purpose == "measure"]
    with RunWriter.create(folder, dict(run.facts)) as writer:
        for first in range(0, count, AT_ONCE):
            rows = []
            for number in range(first, min(first + AT_ONCE, count)):
                one = kinds[number % len(kinds)]
                noise = draw.integers(-1, 2, one.codes.size)
                codes = np.clip(one.codes + noise, -127, 127).astype(np.int8).tobytes()
                key = f"record {number + 1}"
                rows.append(NewRecord(key, "measure", one.header, codes, one.conditions, one.taken_at))
            writer.save_records(rows)
    return writer.path


if __name__ == "__main__":
    main()
