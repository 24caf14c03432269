"""Orders over two links that lose, delay and flap: each is done once, and stop goes over both. In virtual time."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from pathlib import Path

import pytest

from skygcs.core.mavlink import mav_cmd
from support.two_links import TwoLinks, two_links

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
