"""A storm of garbage on a UDP port while a vehicle is in attitude control: the longest turn of the loop, in processor
time of its thread, and whether the vehicle stays in control.

Run by `make bench`. The storm is a process of its own that sends as fast as it can: runs of 0xFD and 0xFE, starts of
frames whose checksums are all wrong, noise, and good frames, in datagrams of 1 kB to 65 kB, with one socket and with a
new one for each datagram. Results also in build/bench/garbage-storm.json. The bound itself is proven without a clock:
tests/unit/links/test_udp.py, test_fast_path.py, test_reading.py.
"""

from __future__ import annotations

import asyncio
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import uvloop

from bench.results import keep
from skygcs.config.models import SimulatedLinkConfig, UdpServerLinkConfig
from skygcs.links import fast_path
from support.called import call
from support.daemons import made_daemon, started
from support.process import free_port

STORM_S = 10.0
LONGEST_TURN_S = 0.02

STORM = """
import random, socket, sys, time
rng, to = random.Random(1), ("127.0.0.1", int(sys.argv[1]))
good = bytes.fromhex(sys.argv[3])
made = [bytes((0xFD,)), bytes((0xFE,)), bytes((0xFD, 255, 0, 0, 0)), bytes((0xFE, 20)), rng.randbytes(997), good]
data = [(pattern * 65_000)[:size] for pattern in made for size in (60, 1_000, 12_000, 65_000)]
one, until = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), time.monotonic() + float(sys.argv[2])
while time.monotonic() < until:
    sock = one if rng.random() < 0.5 else socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for _ in range(60):
        try:
            sock.sendto(rng.choice(data), to)
        except OSError:
            time.sleep(0.001)
"""

HEARTBEAT = "fe09004d01000000000002030004034b2c"
"""A frame of a system that is nobody's: its checksum does not matter here, it costs what a good one costs to check."""


class Probe:
    """Runs once in each turn of the loop and notes the processor time between two runs."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.turns_s: list[float] = []
        self._loop = loop
        self._at = time.thread_time()
        self._on = True
        loop.call_soon(self._run)

    def _run(self) -> None:
        now = time.thread_time()
        self.turns_s.append(now - self._at)
        self._at = now
        if self._on:
            self._loop.call_later(0.001, self._run)

    def close(self) -> None:
        self._on = False


async def stormed(folder: Path, port: int) -> dict[str, Any]:
    daemon = made_daemon(
        folder,
        daemon={"record": True},
        links={
            "air": SimulatedLinkConfig(name="air", px4=1, ardupilot=0),
            "net": UdpServerLinkConfig(name="net", host="127.0.0.1", port=port),
        },
    )
    async with started(daemon):
        await asyncio.sleep(12)
        await call(daemon, "vehicles.arm", targets="all", wait_s=90.0)
        await call(daemon, "vehicles.takeoff", targets="all", height_m=10.0, wait_s=60.0)
        await asyncio.sleep(12)
        await call(daemon, "origin.from_vehicle", target="1")
        outcomes = (await call(daemon, "control.set", targets="all", mode="attitude"))["outcomes"]
        assert all(outcome["ok"] for outcome in outcomes.values()), outcomes
        await asyncio.sleep(2)
        words = [sys.executable, "-c", STORM, str(port), str(STORM_S), HEARTBEAT]
        storm = await asyncio.create_subprocess_exec(*words)
        probe = Probe(asyncio.get_running_loop())
        await asyncio.sleep(STORM_S)
        probe.close()
        await storm.wait()
        (actor,) = (actor for actor in daemon.fleet.vehicles.values() if actor.sysid == 1)
        turns = sorted(probe.turns_s)
        return {
            "turns": len(turns),
            "longest_turn_ms": round(1e3 * turns[-1], 2),
            "p99_turn_ms": round(1e3 * turns[int(0.99 * len(turns))], 2),
            "in_control": actor.offboard.sends_setpoints,
            "clock": actor.offboard.clock.as_dict(),
            "link": daemon.links.link("net").counters(),
        }


@pytest.mark.parametrize("pure", [False, True], ids=["compiled", "python"])
def test_no_turn_is_long_and_the_vehicle_stays_in_control(
    pure: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if pure:
        monkeypatch.setenv(fast_path.PURE, "1")
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        result = runner.run(stormed(tmp_path, free_port()))
    keep("garbage-storm", {"python" if pure else "compiled": result}, beside=True)
    print(result)
    assert result["in_control"], result
    assert result["longest_turn_ms"] <= 1e3 * LONGEST_TURN_S, result
