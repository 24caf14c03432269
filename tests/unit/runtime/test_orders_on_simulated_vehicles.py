"""Whole flights: every order against the simulated PX4 and ArduCopter, bytes both ways, over a radio with delay."""

from __future__ import annotations

import asyncio
import itertools
import math

import pytest

from skygcs.core.mavlink.frame import encode
from skygcs.core.protocols.command import Outcome
from skygcs.runtime import home_orders
from skygcs.runtime.vehicle_actor import VehicleActor
from support.sim_field import SimField
from support.vehicles import HOME

COSTS = "simulated vehicles fly their orders to the end"

pytestmark = pytest.mark.looptime


class Field(SimField):
    """Over the radio of `SimField`."""

    def __init__(self, px4: int, ardupilot: int) -> None:
        super().__init__(px4, ardupilot, {"origin": {"lat_deg": HOME[0], "lon_deg": HOME[1], "alt_amsl_m": HOME[2]}})

    async def ready(self) -> None:
        """Until every vehicle would arm: ArduPilot's estimator takes its time."""
        outcomes = await self.fleet.orders.command_all("all", VehicleActor.arm, wait_s=60.0)
        assert all(o.ok for o in outcomes.values()), outcomes
        outcomes = await self.fleet.orders.command_all("all", VehicleActor.disarm)
        assert all(o.ok for o in outcomes.values()), outcomes

    def setpoint_here(self, actor: VehicleActor) -> bytes:
        """A position target of where it is."""
        here = actor.vehicle.telemetry("position")
        assert here is not None
        values = {
            **{"target_system": actor.sysid, "target_component": 1, "coordinate_frame": 6, "type_mask": 0xDF8},
            **{"lat_int": round(here["lat_deg"] * 1e7), "lon_int": round(here["lon_deg"] * 1e7), "alt": 10.0},
        }
        return encode(self.dialect.by_name["SET_POSITION_TARGET_GLOBAL_INT"], values, sysid=255, compid=25, seq=0)

    def up_m(self, actor: VehicleActor) -> float:
        enu = actor.vehicle.enu_m()
        assert enu is not None
        return enu[2]


def done(outcomes: dict[str, Outcome]) -> bool:
    assert all(o.ok for o in outcomes.values()), {n: o.message for n, o in outcomes.items()}
    return True


async def test_a_mixed_fleet_takes_off_goes_somewhere_holds_and_lands() -> None:
    async with Field(px4=1, ardupilot=1) as field:
        fleet = field.fleet
        assert [a.vehicle.family for a in fleet.resolve("all")] == ["px4", "ardupilot"]
        await field.ready()
        assert done(await fleet.orders.command_all("all", VehicleActor.takeoff, 8.0))
        await asyncio.sleep(25)
        for actor in fleet.resolve("all"):
            assert actor.vehicle.in_air(field.loop.time())
            assert field.up_m(actor) == pytest.approx(8.0, abs=1.0)
        goals = {1: (20.0, 20.0), 2: (-20.0, 0.0)}
        for sysid, (east, north) in goals.items():
            outcome = await fleet.find(sysid).goto(enu_m=[east, north, 12.0])
            assert outcome.ok, outcome.message
        await asyncio.sleep(30)
        for sysid, (east, north) in goals.items():
            assert fleet.find(sysid).vehicle.enu_m() == pytest.approx([east, north, 12.0], abs=1.5)
        assert done(await fleet.orders.command_all("all", VehicleActor.hold))
        await asyncio.sleep(3)
        assert {a.vehicle.mode for a in fleet.resolve("all")} == {"AUTO.LOITER", "GUIDED"}
        assert done(await fleet.orders.command_all("all", VehicleActor.land))
        await asyncio.sleep(60)
        for actor in fleet.resolve("all"):
            assert not actor.vehicle.armed
            assert actor.vehicle.landed(field.loop.time()) == "on_ground"
            assert field.up_m(actor) == pytest.approx(0.0, abs=0.5)
            state = actor.state(field.loop.time())  # known without being asked for by a person
            assert state["firmware"] is not None and state["home"] is not None and state["uptime_s"] > 50


async def test_hold_stops_a_vehicle_on_its_way_and_goto_takes_it_out_of_hold_whatever_was_sent_before() -> None:
    async with Field(px4=1, ardupilot=1) as field:
        fleet = field.fleet
        await field.ready()
        assert done(await fleet.orders.command_all("all", VehicleActor.takeoff, 10.0))
        await asyncio.sleep(25)
        assert done(await fleet.orders.command_all("all", VehicleActor.goto, enu_m=[150.0, 0.0, 10.0]))
        await asyncio.sleep(6)
        assert done(await fleet.orders.command_all("all", VehicleActor.hold))
        await asyncio.sleep(10)
        held = {a.sysid: a.vehicle.enu_m() for a in fleet.resolve("all")}
        await asyncio.sleep(10)
        for actor in fleet.resolve("all"):
            assert actor.vehicle.enu_m() == pytest.approx(held[actor.sysid], abs=0.5)
            assert 0 < held[actor.sysid][0] < 140  # type: ignore[index]
        place = {"enu_m": [0.0, 30.0, 10.0], "yaw_deg": 90.0}
        assert done(await fleet.orders.command_all("all", VehicleActor.goto, same_place=True, **place))
        await asyncio.sleep(40)
        for actor in fleet.resolve("all"):
            assert actor.vehicle.enu_m() == pytest.approx([0.0, 30.0, 10.0], abs=1.5)
        # a setpoint that was sent before, over a slower link: an ArduCopter would fly back to it, a PX4 in LOITER not
        assert done(await fleet.orders.command_all("all", VehicleActor.hold))
        for actor in fleet.resolve("all"):
            field.loop.call_later(1.2, field.deliver, field.setpoint_here(actor))
        outcomes = await fleet.orders.command_all("all", VehicleActor.goto, enu_m=[0.0, 60.0, 10.0], same_place=True)
        assert done(outcomes)
        assert [o.attempts for o in outcomes.values()] == [1, 2]
        await asyncio.sleep(30)
        for actor in fleet.resolve("all"):
            assert actor.vehicle.enu_m() == pytest.approx([0.0, 60.0, 10.0], abs=1.5)
        outcomes = await fleet.orders.command_all("all", VehicleActor.disarm)
        assert {o.result for o in outcomes.values()} == {"refused"}, "in the air"
        assert done(await fleet.orders.command_all("all", VehicleActor.disarm, force=True))
        assert not any(a.vehicle.armed for a in fleet.resolve("all"))


@pytest.mark.deep  # places are held in test_fleet.py
async def test_several_vehicles_sent_to_one_place_keep_their_distance() -> None:
    async with Field(px4=1, ardupilot=2) as field:
        fleet = field.fleet
        await field.ready()
        assert done(await fleet.orders.command_all("all", VehicleActor.takeoff, 10.0))
        await asyncio.sleep(25)
        before = [a.vehicle.enu_m() for a in fleet.resolve("all")]
        assert done(await fleet.orders.command_all("all", VehicleActor.goto, enu_m=[40.0, 30.0, 12.0]))
        await asyncio.sleep(40)
        after = [a.vehicle.enu_m() for a in fleet.resolve("all")]
        for a, b in itertools.combinations(range(3), 2):
            assert math.dist(after[a], after[b]) == pytest.approx(math.dist(before[a], before[b]), abs=1.5)
        middle = [sum(p[axis] for p in after) / 3 for axis in range(3)]
        assert middle == pytest.approx([40.0, 30.0, 12.0], abs=1.5)


@pytest.mark.deep  # four minutes of a return
async def test_return_to_launch_ends_where_it_began() -> None:
    async with Field(px4=1, ardupilot=1) as field:
        fleet = field.fleet
        await field.ready()
        start = {a.sysid: a.vehicle.enu_m() for a in fleet.resolve("all")}
        assert done(await fleet.orders.command_all("all", VehicleActor.takeoff, 10.0))
        await asyncio.sleep(25)
        assert done(await fleet.orders.command_all("all", VehicleActor.goto, enu_m=[30.0, 30.0, 15.0]))
        await asyncio.sleep(25)
        assert done(await fleet.orders.command_all("all", VehicleActor.rtl))
        await asyncio.sleep(180)
        for actor in fleet.resolve("all"):
            assert not actor.vehicle.armed
            assert actor.vehicle.enu_m() == pytest.approx(start[actor.sysid], abs=1.5)


async def test_arducopter_refuses_at_first_says_why_and_wait_gets_it_armed() -> None:
    async with Field(px4=0, ardupilot=1) as field:
        actor = field.fleet.find(1)
        assert (await actor.set_mode("GUIDED")).ok  # which needs a position to arm; STABILIZE does not
        refused = await actor.arm()
        assert refused.result == "failed"
        assert refused.status_texts
        assert refused.status_texts[0] in refused.message
        armed = await actor.arm(wait_s=60)
        assert armed.ok, armed.message
        assert armed.attempts > 1


async def test_a_reboot_is_noticed_and_the_vehicle_usable_again() -> None:
    async with Field(px4=1, ardupilot=0) as field:
        actor = field.fleet.find(1)
        await asyncio.sleep(30)
        outcome = await actor.reboot()
        assert outcome.ok, outcome.message
        await asyncio.sleep(40)
        assert "reboot" in [e.kind for e in field.events]
        assert actor.vehicle.connected
        assert (await actor.arm(wait_s=30)).ok


async def test_modes_home_intervals_and_single_messages_work_on_both() -> None:
    async with Field(px4=1, ardupilot=1) as field:
        fleet = field.fleet
        await field.ready()
        for actor, mode in zip(fleet.resolve("all"), ("POSCTL", "ALT_HOLD"), strict=True):
            outcome = await actor.set_mode(mode)
            assert outcome.ok, outcome.message
            assert actor.vehicle.mode == mode
        assert done(await fleet.orders.command_all("all", home_orders.set_home))
        assert done(await fleet.orders.command_all("all", VehicleActor.set_message_interval, "ATTITUDE", 10.0))
        await asyncio.sleep(10)
        for actor in fleet.resolve("all"):
            assert actor.state(field.loop.time())["messages"]["ATTITUDE"]["rate_hz"] == pytest.approx(10, abs=1.5)
        assert done(await fleet.orders.command_all("all", VehicleActor.request_message, "AUTOPILOT_VERSION"))
