"""A computer that slept takes nothing of before for new."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

from skygcs.config.models import SimulatedLinkConfig, UdpServerLinkConfig
from skygcs.core.radio_link.transmit_queue import OwnMessage
from skygcs.daemon import Daemon
from skygcs.errors import SkygcsError
from skygcs.rpc.client import Client
from skygcs.runtime.loop_clock import STOOD_STILL_S, SleepWatch, Standstill, slept_s
from support.called import call
from support.daemons import made_daemon, started
from support.hosts import heartbeat

pytestmark = pytest.mark.looptime


class Watched:
    """A watch with clocks of the test."""

    def __init__(self) -> None:
        self.now = self.slept = 100.0
        self.woke: list[Standstill] = []
        self.watch = SleepWatch(self.woke.append, asyncio.get_running_loop(), lambda: self.slept)
        self.watch.clock = lambda: self.now
        self.watch.check()

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        self.slept += seconds


async def test_it_notices_each_sleep_once_and_no_jitter() -> None:
    its = Watched()
    its.sleep(0.001)
    assert not its.watch.check()
    its.sleep(3600.0)
    assert its.watch.check()
    await asyncio.sleep(0)
    assert not its.watch.check()
    assert its.woke == [(pytest.approx(3600.001), True)] and its.woke[0].missed_s == its.woke[0].seconds


async def test_it_notices_a_standstill_once_it_beats_and_no_late_timer() -> None:
    its = Watched()
    its.now += 60.0
    assert not its.watch.check()  # nobody has begun
    its.watch.beat()
    its.now += STOOD_STILL_S - 0.01
    assert not its.watch.check()
    its.watch.beat()
    its.now += 10.0
    assert its.watch.check()
    await asyncio.sleep(0)
    assert not its.watch.check()
    assert its.woke == [(10.0, False)] and its.woke[0].missed_s == 0.0  # the loop's clock has counted them
    its.now += 10.0
    its.watch.beat()
    await asyncio.sleep(0)
    assert len(its.woke) == 2


async def test_a_long_turn_in_which_something_is_done_all_the_time_is_no_standstill() -> None:
    its = Watched()
    its.watch.beat()
    for _ in range(10):
        its.now += 1.0
        assert not its.watch.check()
    its.watch.beat()
    await asyncio.sleep(0)
    assert its.woke == []


async def test_a_check_reads_one_clock_until_it_finds_a_gap() -> None:
    its = Watched()
    looks = list[int]()
    its.watch.slept_s = lambda: looks.append(1) or its.slept
    for _ in range(100):
        its.now += 0.1
        its.watch.check()
    assert looks == []
    its.now += 0.6
    assert not its.watch.check() and looks == [1]


async def test_everything_is_held_back_until_the_loop_has_forgotten_what_was_known() -> None:
    its = Watched()
    its.watch.beat()
    its.now += 10.0
    assert its.watch.check() and its.watch.check()  # whoever asks second, too
    assert its.woke == []  # nobody is called amid something
    during = list[bool]()
    its.watch._on_woke = lambda _: during.append(its.watch.check())  # what is ended there may send nothing either
    its.now += 10.0
    assert its.watch.check()
    await asyncio.sleep(0)
    assert during == [True, True] and not its.watch.check()


def test_a_stop_between_two_readings_of_clocks_is_no_sleep(monkeypatch: pytest.MonkeyPatch) -> None:
    true = time.monotonic
    stopped = iter([0.0, 5.0])
    late = [0.0]

    def read() -> float:
        late[0] += next(stopped, 0.0)
        return true() + late[0]

    real = time.clock_gettime(time.CLOCK_BOOTTIME) - true()
    monkeypatch.setattr(time, "clock_gettime", lambda _: true() + real + late[0])
    monkeypatch.setattr(time, "monotonic", read)
    assert slept_s() == pytest.approx(real, abs=0.5)


async def test_control_ends_with_a_sleep_and_states_of_before_are_as_old_as_they_are(tmp_path: Path) -> None:
    daemon = made_daemon(
        tmp_path,
        links={"air": SimulatedLinkConfig(name="air", px4=0, ardupilot=1)},
    )
    async with started(daemon):
        await until(lambda: bool(daemon.fleet.vehicles))
        await asyncio.sleep(10)
        await call(daemon, "vehicles.arm", targets="all", wait_s=90.0)
        await call(daemon, "vehicles.takeoff", targets="all", height_m=10.0, wait_s=60.0)
        await asyncio.sleep(20)
        await call(daemon, "origin.from_vehicle", target="1")
        outcomes = (await call(daemon, "control.set", targets="all", mode="velocity"))["outcomes"]
        assert all(outcome["ok"] for outcome in outcomes.values()), outcomes
        await asyncio.sleep(3)
        before = next(iter(daemon.fleet.vehicles.values()))
        assert before.offboard.sends_setpoints
        loop = asyncio.get_running_loop()
        unknown = sent_to_unknown(daemon)
        known = daemon.fleet.sleep.slept_s()
        daemon.fleet.sleep.slept_s = lambda: known + 600.0
        daemon.fleet.sleep.clock = lambda: loop.time() + 600.0
        await asyncio.sleep(before.offboard.controller.period_s)
        assert not before.offboard.clock.running  # the next tick did not use a state of ten minutes ago
        assert before not in daemon.fleet.vehicles.values()
        await asyncio.sleep(10)
        assert set(unknown) <= {"HEARTBEAT"}  # no ping takes the place of the last setpoint either
        slept = [
            event
            for event in daemon.event_log.recent
            if event["kind"] == "warning" and "slept for 600 s" in event["text"]
        ]
        assert len(slept) == 1
        (after,) = daemon.fleet.vehicles.values()
        assert after is not before and after.vehicle.connected and not after.offboard.sends_setpoints
        texts = [event["text"] for event in daemon.event_log.recent if event["vehicle"] == after.name]
        assert any("hold" in text for text in texts), texts[-20:]
        assert any("before a sleep of this computer" in text for text in texts), texts[-20:]


async def test_what_was_sent_to_a_process_that_stood_still_is_neither_believed_nor_carried_out(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    daemon = made_daemon(
        tmp_path,
        links={"ground": UdpServerLinkConfig(name="ground", host="127.0.0.1", port=port, role="vehicle")},
    )
    task = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    loop: Any = asyncio.get_running_loop()
    vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client = Client(str(tmp_path / "s"))
    try:
        vehicle.connect(("127.0.0.1", port))
        vehicle.send(heartbeat(7))
        await until(lambda: 7 << 8 | 1 in daemon.fleet.vehicles)
        await client.open()
        await client.call("vehicles.list")
        # a heartbeat and an order wait while the process is stopped
        answer = asyncio.create_task(client.call("vehicles.mode", targets="7", mode="LOITER"))
        late = socket.socket(socket.AF_UNIX)  # connects meanwhile: the kernel takes the connection and its line
        await asyncio.sleep(0)
        for _ in range(200):  # more than is read in one turn
            vehicle.send(heartbeat(7))
        drain(vehicle)
        loop.stand_still(10.0)
        late.connect(str(tmp_path / "s"))
        late.send(b'{"jsonrpc":"2.0","id":1,"method":"daemon.info"}\n')
        with pytest.raises(SkygcsError, match=r"stood still for 10 s.*connect anew|closed"):
            await answer
        await until(lambda: any("200 frames had waited" in event["text"] for event in daemon.event_log.recent))
        late.settimeout(10.0)
        with contextlib.suppress(ConnectionResetError):
            assert b'"result"' not in late.recv(65536)
        late.close()
        assert daemon.hub.stale_frames == daemon.info()["stale_frames"] == 200 and not daemon.fleet.vehicles
        assert not [f for f in drain(vehicle) if f[9:10] == bytes([76])]  # no COMMAND_LONG
        vehicle.send(heartbeat(7))  # the socket has been empty once: this one is new, however soon it comes
        await until(lambda: 7 << 8 | 1 in daemon.fleet.vehicles)
    finally:
        await client.close()
        vehicle.close()
        daemon.stop()
        await task


def sent_to_unknown(daemon: Daemon) -> list[str]:
    """The messages of ours that are sent from now on while no vehicle is known."""
    names: list[str] = []
    send_on = daemon.hub._send_on

    def noted(ids: Any, message: OwnMessage, *rest: Any) -> bool:
        if not daemon.fleet.vehicles:
            names.append(message.info.name)
        return send_on(ids, message, *rest)

    daemon.hub._send_on = noted  # type: ignore[method-assign]
    return names


async def test_nothing_that_orders_beyond_a_vehicle_outlives_a_standstill(tmp_path: Path) -> None:
    daemon = made_daemon(tmp_path)
    async with started(daemon):
        fleet, loop = daemon.fleet, cast(Any, asyncio.get_running_loop())
        await asyncio.sleep(1.0)
        # the turns of missions: tests/integration/test_missions_for_several.py; orders: test_returns_at_once.py
        watchdog = daemon.operator_watchdog
        owners = (fleet.returns._tasks, fleet.monitor._tasks, watchdog._tasks)
        works = [owner.start(asyncio.sleep(3600.0), "an order that waits") for owner in owners]
        await asyncio.sleep(0)
        loop.stand_still(10.0)
        await asyncio.sleep(1.0)
        assert all(work.cancelled() for work in works), works


def drain(sock: socket.socket) -> list[bytes]:
    """The datagrams that have come."""
    found = []
    with contextlib.suppress(BlockingIOError):
        while True:
            found.append(sock.recv(2048, socket.MSG_DONTWAIT))
    return found


async def until(condition: Callable[[], Any]) -> None:
    for _ in range(1000):
        if condition():
            return
        await asyncio.sleep(0.1)
    raise AssertionError("it did not come")
