"""Each kind of alarm in a whole daemon: the condition is made, the alarm is raised, and it ends with the condition."""

from __future__ import annotations

import asyncio
import errno
import math
import os
import re
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core import alarms
from skygcs.runtime.recorder import TlogFiles
from support.flown import Flown, aloft
from support.planned import here, northwards, run, state
from support.pymav import PymavPeer

Step = Callable[[Flown], Awaitable[None]]

BATTERY = {"battery_low_percent": 25.0, "battery_critical_percent": 12.0}
SETTINGS = {"operator_timeout_s": 30.0, "operator_lost": "hold"}


async def nothing(gcs: Flown) -> None:
    """Its end needs nobody."""


def done(method: str, targets: str = "v2", **params: Any) -> Step:
    """An order that is carried out."""

    async def step(gcs: Flown) -> None:
        await gcs.done(method, targets=targets, **params)

    return step


def now(change: Callable[[Flown], object]) -> Step:
    """Something that happens to a vehicle."""

    async def step(gcs: Flown) -> None:
        change(gcs)

    return step


def drained(percent: float) -> Step:
    return now(lambda gcs: gcs.sim("v2").battery.set_percent(percent))


async def outside_its_fence(gcs: Flown, name: str) -> None:
    x, y, up = gcs.place(name)
    await gcs.done("vehicles.goto", targets=name, enu_m=[x, y + 15.0, up])
    await gcs.until(lambda: gcs.place(name)[1] > y + 14.0, 60.0)
    await gcs.done("fence.set", targets=name, radius_m=10.0, action="return", force=True)


async def beside_each_other(gcs: Flown) -> None:
    x, y, up = gcs.place("v1")
    await gcs.done("vehicles.goto", targets="v2", enu_m=[x + 0.8, y, up], force=True)
    await gcs.until(lambda: math.dist(gcs.place("v1"), gcs.place("v2")) < 1.5, 30.0)


async def apart(gcs: Flown) -> None:
    x, y, _ = gcs.place_of_home("v2")
    await gcs.done("vehicles.goto", targets="v2", enu_m=[x, y, 10.0], force=True)


async def held_by_the_guard(gcs: Flown) -> None:
    await gcs.fly("position", "v2")
    await asyncio.sleep(2)
    gcs.sim("v2").faults.nan_attitude = True


async def sound_again(gcs: Flown) -> None:
    gcs.sim("v2").faults.nan_attitude = False
    await asyncio.sleep(3)
    await gcs.done("control.set", targets="v2", mode="off")


async def a_plan_that_is_aborted(gcs: Flown) -> None:
    await run(gcs, northwards(here(gcs), 8.0))
    await gcs.until(lambda: state(gcs) in ("engaging", "to_starts", "flying"), 60.0)
    await gcs("plan.abort")


async def a_plan_that_flies(gcs: Flown) -> None:
    await gcs.until(lambda: state(gcs) == "aborted", 60.0)
    await gcs("plan.unload")
    await asyncio.sleep(2)
    await run(gcs, northwards(here(gcs), -4.0))
    await gcs.until(lambda: state(gcs) == "finished", 120.0)


async def a_wrong_take_off(gcs: Flown) -> None:
    """A station moves home after the height was computed."""
    await gcs.lands("v2")
    await gcs("vehicles.takeoff", targets="v2", height_m=8.0)
    await gcs.until(lambda: gcs.sim("v2").armed and gcs.sim("v2").motion.up_m > 1.0, 60.0)
    gcs.sim("v2").motion.up_m += 9.0


async def landed(gcs: Flown) -> None:
    await gcs.done("vehicles.land", targets="v2")
    await gcs.until(lambda: not gcs.sim("v2").armed, 120.0)


async def nobody_flies_it(gcs: Flown) -> None:
    await gcs.fly("attitude", "v2")
    await asyncio.sleep(2)
    gcs.actor("v2").offboard.release("a fault")


async def flown_by_nobody_at_the_controls(gcs: Flown) -> None:
    await gcs.fly("position", "v2")


def position_interval(gcs: Flown, interval_us: float) -> None:
    gcs.by_other_station(mav.MAVLink_command_long_message(2, 1, 511, 0, 33, interval_us, 0, 0, 0, 0, 0))


async def sends_no_position(gcs: Flown) -> None:
    gcs.loses = frozenset({"COMMAND_LONG", "REQUEST_DATA_STREAM"})  # nobody asks for it again
    position_interval(gcs, -1.0)


async def sends_it_again(gcs: Flown) -> None:
    gcs.loses = frozenset()
    position_interval(gcs, 2e5)


def another_with_its_id(gcs: Flown) -> asyncio.Task[None]:
    """A PX4 with the same id on the same link, which is heard five times a second."""
    peer = PymavPeer(2, 1)

    async def send() -> None:
        while True:
            gcs.link.peer.send(peer.pack(peer_heartbeat()))
            await asyncio.sleep(0.2)

    return asyncio.create_task(send())


def peer_heartbeat() -> Any:
    return mav.MAVLink_heartbeat_message(13, 12, 0x1D, 1 << 16, 3, 3)


async def another(gcs: Flown) -> None:
    gcs.other_one = another_with_its_id(gcs)  # type: ignore[attr-defined]


async def gone(gcs: Flown) -> None:
    gcs.other_one.cancel()  # type: ignore[attr-defined]


async def a_full_disk(gcs: Flown) -> None:
    """Every write fails from now on, as `write` and `ftruncate` do on a full disk or beyond RLIMIT_FSIZE."""
    assert gcs.daemon.recorder is not None
    full = mock.patch.object(TlogFiles, "write", side_effect=OSError(errno.EFBIG, os.strerror(errno.EFBIG)))
    full.start()
    gcs.full_disk = full  # type: ignore[attr-defined]
    await gcs.until(lambda: recorder_state(gcs) == "failing", 30.0)


async def room_again(gcs: Flown) -> None:
    gcs.full_disk.stop()  # type: ignore[attr-defined]
    await gcs.until(lambda: recorder_state(gcs) == "recording", 30.0)


def recorder_state(gcs: Flown) -> str:
    assert gcs.daemon.recorder is not None
    return str(gcs.daemon.recorder.status()["state"])


CONDITIONS: dict[str, tuple[str | None, Step, Step]] = {
    "lost": ("v2", now(lambda gcs: gcs.muted.add(2)), now(lambda gcs: gcs.muted.clear())),
    "deaf": (
        "v2",
        now(lambda gcs: setattr(gcs.sim("v2").faults, "deaf", True)),
        now(lambda gcs: setattr(gcs.sim("v2").faults, "deaf", False)),
    ),
    "battery": ("v2", drained(20.0), drained(90.0)),
    "fence": ("v2", lambda gcs: outside_its_fence(gcs, "v2"), nothing),
    "separation": ("v2", beside_each_other, apart),
    "guard": ("v2", held_by_the_guard, sound_again),
    "plan": (None, a_plan_that_is_aborted, a_plan_that_flies),
    "takeoff": ("v2", a_wrong_take_off, landed),
    "duplicate": ("v2", another, gone),
    "unwatched": ("v2", sends_no_position, sends_it_again),
    "failsafe": (
        "v2",
        now(lambda gcs: setattr(gcs.sim("v2").faults, "gps_lost", True)),
        now(lambda gcs: setattr(gcs.sim("v2").faults, "gps_lost", False)),
    ),
    "recorder": (None, a_full_disk, room_again),
    "unattended": ("v2", nobody_flies_it, nothing),
    "operator": (None, flown_by_nobody_at_the_controls, nothing),
    "autopilot": ("v2", now(lambda gcs: gcs.sim("v2").tx.say(2, "Potential Thrust Loss (1)")), nothing),
}
"""By kind: the vehicle, what makes the condition, and what ends it."""

ELSEWHERE = {
    "stop": "test_alarms.py",
    "return": "test_restart_in_flight.py",
    "ground": "test_companion_lost.py",
    "keys": "unit/ext/companions/test_tls_orders.py",
    "fault": "a fault is ours: `flown` has none",
}


@pytest.mark.parametrize("kind", CONDITIONS)
async def test_the_condition_raises_its_alarm_and_its_end_ends_it(kind: str, tmp_path: Path) -> None:
    name, begin, end = CONDITIONS[kind]
    settings = {**SETTINGS, "record": kind == "recorder"}
    async with aloft(
        tmp_path, px4=1, ardupilot=1, settings=settings, tables={"alarms": BATTERY}, setpoints_end=False
    ) as gcs:
        client = asyncio.create_task(present(gcs, away=kind == "operator"))
        try:
            await begin(gcs)
            alarm = await found(gcs, kind, name)
            lasts = alarm["active"]
            await end(gcs)
            if lasts:
                await gone_by(gcs, kind, name)
        finally:
            client.cancel()
            mock.patch.stopall()


async def present(gcs: Flown, *, away: bool) -> None:
    """Somebody is at the controls."""
    while not away:
        gcs.daemon.operator_watchdog.on_client()
        await asyncio.sleep(1)


async def listed(gcs: Flown, kind: str, name: str | None) -> dict[str, Any] | None:
    alarms = gcs.daemon.alarms.all()
    return next((a for a in alarms if a["kind"] == kind and (name is None or a["vehicle"] == name)), None)


async def found(gcs: Flown, kind: str, name: str | None, within_s: float = 120.0) -> dict[str, Any]:
    end = gcs.now + within_s
    while (alarm := await listed(gcs, kind, name)) is None:
        assert gcs.now < end, (kind, [a["kind"] for a in gcs.daemon.alarms.all()])
        await asyncio.sleep(0.25)
    return alarm


async def gone_by(gcs: Flown, kind: str, name: str | None, within_s: float = 120.0) -> None:
    """Not active any more: it is over, and listed until somebody has seen it."""
    end = gcs.now + within_s
    while (alarm := await listed(gcs, kind, name)) is not None and alarm["active"]:
        assert gcs.now < end, alarm
        await asyncio.sleep(0.25)


def test_each_kind_is_made_here_or_in_the_test_that_is_named() -> None:
    assert alarms.__doc__ is not None
    kinds = alarms.__doc__.partition("state of an alarm")[0]
    named = {row.split()[0] for row in re.findall(r"^    [a-z]+ {3,}.*$", kinds, re.MULTILINE)} - {"kind"}
    assert named == set(CONDITIONS) | set(ELSEWHERE)
