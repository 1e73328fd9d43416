"""One scope from several threads and tasks, two scopes at once, and two programs on one port."""

import asyncio
import os
import subprocess
import sys
import threading

import numpy as np
import pytest

from instrument import TDS2014
from instrument.errors import LinkError
from instrument.simulated import PtyServer, SimulatedTDS2014, TcpServer, resource_manager

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="there are serial terminals on POSIX only")


def sine(times):
    return 0.2 * np.sin(6283.0 * times)


def test_threads_take_turns():
    with (
        TcpServer(SimulatedTDS2014({1: sine, 2: lambda t: -sine(t)})) as server,
        TDS2014(server.resource_name) as scope,
    ):
        scope.set_channel("CH2")
        wrong, counts = [], []

        def work(channel):
            try:
                for _ in range(25):
                    counts.append(len(scope.fetch(channel)))
                    if scope.channel_settings(channel).channel != channel:
                        wrong.append(channel)
            except Exception as error:
                wrong.append(error)

        threads = [threading.Thread(target=work, args=(channel,)) for channel in ("CH1", "CH2", "CH1")]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert wrong == []
        assert counts == [2500] * 75


def test_two_scopes_in_one_event_loop():
    async def both():
        managers = [resource_manager(sine) for _ in range(2)]
        scopes = [TDS2014("GPIB0::1::INSTR", resource_manager=manager) for manager in managers]
        for scope in scopes:
            scope.set_timebase(1e-2)
        ticks = 0

        async def tick():
            nonlocal ticks
            while True:
                await asyncio.sleep(0.005)
                ticks += 1

        ticking = asyncio.create_task(tick())
        records = await asyncio.gather(*(scope.acquire_async("CH1") for scope in scopes))
        ticking.cancel()
        for scope, manager in zip(scopes, managers, strict=True):
            scope.close()
            manager.close()
        return records, ticks

    records, ticks = asyncio.run(both())
    assert [len(record) for record in records] == [2500, 2500]
    assert ticks >= 5  # 0.1 s of acquisition did not hold up the loop


SECOND = """
import sys
from instrument import TDS2014
from instrument.errors import LinkError
try:
    TDS2014(sys.argv[1])
except LinkError as error:
    print(error)
"""


@POSIX
def test_a_second_program_on_a_serial_port_is_refused_by_name():
    with PtyServer(SimulatedTDS2014({1: sine})) as server, TDS2014(server.resource_name) as scope:
        second = subprocess.run(
            [sys.executable, "-c", SECOND, server.resource_name], capture_output=True, text=True, timeout=60
        )
        assert f"{server.resource_name} is in use by process {os.getpid()} (" in second.stdout
        assert len(scope.acquire("CH1")) == 2500
        with pytest.raises(LinkError, match="in use"):
            TDS2014(server.resource_name)
