"""Vehicles with a network link and a radio each, in virtual time: the choice, orders over both, setpoints in flight.

Each order is done once and a stop goes over both, though links lose, delay and flap; setpoints change over in flight.
"""

from __future__ import annotations

import asyncio
import itertools
import math
import random
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.mavlink import mav_cmd
from support.called import call
from support.flown import KINDS, SETPOINTS
from support.two_links import Delivered, TwoLinks, two_links

ONCE = (
    mav_cmd.DO_DIGICAM_CONTROL,
    mav_cmd.IMAGE_START_CAPTURE,
    mav_cmd.VIDEO_START_CAPTURE,
    mav_cmd.DO_REPEAT_SERVO,
    mav_cmd.DO_WINCH,
    mav_cmd.DO_MOTOR_TEST,
)
HARMLESS = (
    mav_cmd.DO_SET_SERVO,
    mav_cmd.DO_SET_RELAY,
    mav_cmd.DO_GRIPPER,
    mav_cmd.DO_SPRAYER,
    mav_cmd.DO_CHANGE_SPEED,
    mav_cmd.DO_SET_ROI_NONE,
)
ORDERS = 1000
GOAL = [20.0, 0.0, 10.0]


def p95(ages_s: list[float]) -> float:
    return ages_s[int(0.95 * len(ages_s))]


@pytest.mark.deep
async def test_the_radio_keeps_in_touch_while_the_network_carries_telemetry_and_takes_over(tmp_path: Path) -> None:
    async with two_links(tmp_path, ardupilot=3) as field:
        await field.until(lambda: all(v["standby"] and v["settled"] for v in field.air()["vehicles"]))
        await asyncio.sleep(15)
        reduced = field.air()["down"]
        assert reduced["planned_bytes_per_s"] == 3 * 41 and reduced["measured_bytes_per_s"] < 300
        before = await field.watch(10)
        # cut
        for port in field.ports.values():
            port.cut = True
        cut_at = field.daemon.now()
        assert await field.carried_by("air") - cut_at <= 2.5
        cut = await field.watch(20)
        assert field.air()["down"]["planned_bytes_per_s"] > 500
        assert p95(before) <= 0.3 and p95(cut) <= 1.0 and max(cut) <= 3.5
        # restored
        for port in field.ports.values():
            port.cut = False
        await field.carried_by("wifi")
        assert all(field.links(sysid)["air"]["changes"] >= 2 for sysid in (1, 2, 3))


def reached(field: TwoLinks, commands: tuple[int, ...]) -> Counter[float]:
    """How often each order of these commands reached a vehicle; its number is its parameter 7."""
    return Counter(
        d.values["param7"] for d in field.delivered if d.name == "COMMAND_LONG" and d.values["command"] in commands
    )


async def flap(field: TwoLinks, seed: int) -> None:
    """Network links that are up and down for up to 3 s each, and lose and delay while they are up."""
    rng = random.Random(seed)
    for port in field.ports.values():
        port.loss, port.delay_s, port.jitter_s = 0.1, 0.05, 0.3
    while True:
        await asyncio.sleep(3.0 * rng.random())
        port = field.ports[rng.choice(sorted(field.ports))]
        port.cut = not port.cut


@pytest.mark.deep
async def test_no_order_of_a_thousand_that_does_something_again_is_done_twice(tmp_path: Path) -> None:
    async with two_links(tmp_path, ardupilot=4, radio={"loss": 0.05}) as field:
        flapping = asyncio.create_task(flap(field, 7))
        actors = [field.daemon.fleet.vehicles[sysid << 8 | 1] for sysid in field.ports]
        sent = answered = 0
        while sent < ORDERS:
            orders = []
            for command in (*ONCE, *HARMLESS):
                for actor in actors:
                    sent += 1
                    orders.append(actor.command(command, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, float(sent))))
            outcomes = await asyncio.gather(*orders)
            answered += sum(outcome.result != "timeout" for outcome in outcomes)
        flapping.cancel()
        once, harmless = reached(field, ONCE), reached(field, HARMLESS)
        assert max(once.values()) == 1, "what would be done again is sent once"
        assert len(harmless) >= 0.98 * sent / 2, "and what is harmless is repeated until it arrives"
        assert answered >= 0.75 * sent


@pytest.mark.deep
async def test_a_vehicle_is_armed_once_by_one_order_though_links_flap(tmp_path: Path) -> None:
    async with two_links(tmp_path, ardupilot=2, radio={"loss": 0.05}) as field:
        await asyncio.sleep(30)  # its estimator has a position then
        actor, sim = field.daemon.fleet.vehicles[1 << 8 | 1], field.sim(1)
        armings = 0
        before = sim.arm

        def arm(now: float) -> None:
            nonlocal armings
            armings += 1
            before(now)

        sim.arm = arm  # type: ignore[method-assign]
        flapping = asyncio.create_task(flap(field, 3))
        for count in range(1, 6):
            outcome = await actor.arm()
            assert armings <= count, "never twice by one order"
            armings = count
            await field.until(lambda: not sim.armed or actor.vehicle.armed, 20.0)
            assert outcome.ok or outcome.result in ("timeout", "temporarily_rejected", "failed"), outcome
            await actor.disarm(force=True)
            await field.until(lambda: not sim.armed and not actor.vehicle.armed, 20.0)
            await asyncio.sleep(3.0)
        flapping.cancel()


async def test_a_stop_goes_over_both_links_at_once(tmp_path: Path) -> None:
    async with two_links(tmp_path, ardupilot=2) as field:
        actor = field.daemon.fleet.vehicles[1 << 8 | 1]
        field.delivered.clear()
        stop = asyncio.create_task(actor.stop(action="land"))
        await asyncio.sleep(0.2)
        over = {d.over for d in field.delivered if d.values.get("command") == mav_cmd.NAV_LAND}
        at_once = over == {"wifi"} or over == {"wifi", "air"}
        await asyncio.sleep(1.5)
        over = {d.over for d in field.delivered if d.values.get("command") == mav_cmd.NAV_LAND}
        stop.cancel()
        await asyncio.gather(stop, return_exceptions=True)
        assert at_once and over == {"wifi", "air"}


async def order(field: TwoLinks, method: str, **params: Any) -> None:
    outcomes = (await call(field.daemon, method, targets="all", **params))["outcomes"]
    assert all(o["ok"] for o in outcomes.values()), outcomes


async def flying(field: TwoLinks) -> None:
    """At 10 m under control by position."""
    await order(field, "vehicles.takeoff", height_m=10.0, wait_s=90)
    await asyncio.sleep(15)
    await order(field, "control.set", mode="position")
    await asyncio.sleep(8)


def setpoints(field: TwoLinks, since: float) -> list[Delivered]:
    return [d for d in field.delivered if d.name in SETPOINTS and d.at >= since]


def place(field: TwoLinks) -> tuple[float, float, float]:
    (actor,) = field.daemon.fleet.vehicles.values()
    state = actor.state(field.daemon.now())
    x, y, up = state["position"]["enu_m"]
    return float(x), float(y), float(up)


@KINDS
async def test_setpoints_change_over_in_flight_and_come_over_one_link_at_a_time(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with two_links(tmp_path, **kind) as field:
        await flying(field)
        assert {d.over for d in setpoints(field, field.daemon.now() - 5)} == {"wifi"}
        await order(field, "vehicles.goto", enu_m=GOAL)
        await asyncio.sleep(2)
        port = field.ports[1]
        port.cut = True
        began = field.daemon.now()
        switched = await field.carried_by("air")
        assert switched - began < 2.5
        await asyncio.sleep(20)
        came = setpoints(field, began)
        assert {d.over for d in came} == {"air"}
        gaps = [b.at - a.at for a, b in itertools.pairwise(came)]
        assert came[0].at - began < 3.0 and max(gaps) < 1.0, "neither a hole nor a stop of the stream"
        assert math.dist(place(field), GOAL) < 1.0, "it went on to its goal"
        # back to the network while setpoints flow
        port.cut = False
        back = await field.carried_by("wifi")
        await asyncio.sleep(10)
        after = setpoints(field, back)
        late = [d.at - back for d in after if d.over == "air"]
        assert max(late, default=0.0) < 1.5, "what was in the air arrives at most a round later"
        assert [d for d in after if d.over == "wifi"] and math.dist(place(field), GOAL) < 1.0
        (status,) = await call(field.daemon, "control.status", targets="all")
        assert status["state"] == "flying"


@KINDS
async def test_a_link_over_which_the_vehicle_does_not_hear_us_is_left_in_flight(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with two_links(tmp_path, **kind) as field:
        await flying(field)
        port = field.ports[1]
        changes = field.links(1)["air"]["changes"]
        port.deaf = True
        began = field.daemon.now()
        switched = await field.carried_by("air")
        assert switched - began < 5.0
        assert any("does not hear us over it" in text for text in field.switches())
        await field.until(lambda: any("hears us again" in text for text in field.events("uplink_back")), 10.0)
        await order(field, "vehicles.goto", enu_m=GOAL)
        await asyncio.sleep(60)
        assert math.dist(place(field), GOAL) < 1.0
        shown = field.links(1)
        assert shown["wifi1"]["deaf"] and shown["wifi1"]["health"] == "poor" and not shown["air"]["deaf"]
        assert shown["air"]["changes"] == changes + 1, "its telemetry comes, and it is not taken again"
        port.deaf = False
        await field.carried_by("wifi")
        assert not field.links(1)["wifi1"]["deaf"]
        assert field.links(1)["air"]["changes"] == changes + 2
