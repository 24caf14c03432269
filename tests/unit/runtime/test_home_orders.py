"""One frame for the fleet, and telling single vehicles of it, against scripted vehicles."""

from __future__ import annotations

import asyncio

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.geo import Origin
from skygcs.errors import RefusedError, TargetError
from support.vehicles import ARDUPILOT, HOME, PX4, Ground, ScriptedVehicle, Sent

pytestmark = pytest.mark.looptime

HERE = Origin(*HOME)
SOUTH = Origin(HOME[0] - 1e-3, HOME[1], HOME[2], 30.0)


async def test_vehicles_met_before_and_after_are_in_one_frame() -> None:
    async with Ground() as ground:
        ScriptedVehicle(ground, 1)
        await asyncio.sleep(3)
        ground.fleet.set_origin(SOUTH)
        ScriptedVehicle(ground, 2)
        await asyncio.sleep(3)
        states = [a.state(ground.loop.time())["position"] for a in ground.fleet.resolve("all")]
        assert states[0]["enu_m"] == states[1]["enu_m"] != [0.0, 0.0, 0.0]
        assert [s["origin_generation"] for s in states] == [1, 1] == [ground.fleet.origin_generation] * 2


async def test_a_change_is_told_once_with_what_was_before() -> None:
    async with Ground() as ground:
        ScriptedVehicle(ground, 1)
        await asyncio.sleep(3)
        fleet = ground.fleet
        for origin in (HERE, HERE, SOUTH):
            fleet.set_origin(origin)
            assert fleet.find(1).vehicle.origin == origin
        fleet.set_origin(None)
        assert fleet.origin_generation == 3
        events = [e for e in ground.events if e.kind == "origin"]
        assert [e.data["generation"] for e in events] == [1, 2, 3]
        assert events[1].data["old"]["x_heading_deg"] == 90.0
        assert "x to 30.0°; it was 47.3977420, 8.5455940, 488.1 m AMSL" in events[1].text


async def test_a_vehicle_gives_the_origin_and_x_stays_unless_its_heading_is_wanted() -> None:
    async with Ground() as ground:
        alpha = ScriptedVehicle(ground, 1)
        await asyncio.sleep(3)
        fleet = ground.fleet
        fleet.set_origin(SOUTH)
        with pytest.raises(RefusedError, match="fix"):
            fleet.set_origin_from("1")
        alpha.tell(alpha.say(mav.MAVLink_gps_raw_int_message(0, 3, 1, 1, 0, 0, 0, 0, 0, 9)))
        await asyncio.sleep(0.5)
        fleet.set_origin_from("1")
        assert fleet.origin is not None
        assert (fleet.origin.lat_deg, fleet.origin.x_heading_deg) == (pytest.approx(HOME[0], abs=1e-7), 30.0)
        fleet.set_origin_from(1, heading=True)
        assert fleet.origin.x_heading_deg == 0.0
        assert ground.events[-1].data["source"] == "v1"
        with pytest.raises(TargetError):
            fleet.set_origin_from("2")
        fleet.set_duplicate(1 << 8 | 1, "on udp and on radio")
        with pytest.raises(RefusedError, match="two vehicles"):
            fleet.set_origin_from("1")


class Told(ScriptedVehicle):
    """Answers the question for its origin with ``origin``. A new one it takes if ``willing``, and misses ``deaf``."""

    def __init__(self, ground: Ground, sysid: int, autopilot: int, *, willing: bool, deaf: int = 0) -> None:
        super().__init__(ground, sysid, autopilot)
        self.origin = (0, 0, 0)
        self.willing, self.deaf = willing, deaf
        self.script = self._answer  # type: ignore[assignment]

    def _answer(self, vehicle: ScriptedVehicle, sent: Sent) -> None:
        if sent.name == "SET_GPS_GLOBAL_ORIGIN":
            self.deaf -= 1
            if self.willing and self.deaf < 0:
                self.origin = (sent.latitude, sent.longitude, sent.altitude)
        elif sent.name.startswith("COMMAND_"):
            self.reply(sent)
            if sent.command == 512:
                self.tell(self.say(mav.MAVLink_gps_global_origin_message(*self.origin)))


async def test_each_vehicle_is_told_as_itself_and_asked_what_it_has() -> None:
    async with Ground() as ground:
        vehicles = [Told(ground, 1, PX4, willing=True), Told(ground, 2, ARDUPILOT, willing=False)]
        vehicles[1].origin = (round(HOME[0] * 1e7) + 10_000, round(HOME[1] * 1e7), 0)
        await asyncio.sleep(3)
        ground.fleet.set_origin(HERE)
        outcomes = await ground.fleet.orders.push_origin("all")
        assert outcomes["v1"].ok, outcomes
        assert (outcomes["v2"].result, outcomes["v2"].attempts) == ("denied", 1)
        assert "ArduPilot has an origin already" in outcomes["v2"].message
        for sysid, vehicle in enumerate(vehicles, 1):
            reported = [s for s in vehicle.got if s.name == "SET_GPS_GLOBAL_ORIGIN"]
            assert {(s.target_system, s.latitude, s.altitude) for s in reported} == {
                (sysid, round(HOME[0] * 1e7), 488_100)
            }


async def test_one_that_got_lost_is_told_again_and_one_that_never_takes_it_fails_with_what_it_has() -> None:
    async with Ground() as ground:
        late = Told(ground, 1, PX4, willing=True, deaf=1)
        never = Told(ground, 2, PX4, willing=False)
        never.origin = (round(HOME[0] * 1e7) + 10_000, round(HOME[1] * 1e7), 488_100)
        await asyncio.sleep(3)
        ground.fleet.set_origin(HERE)
        outcomes = await ground.fleet.orders.push_origin("all")
        assert outcomes["v1"].ok and outcomes["v1"].attempts > 1
        assert (outcomes["v2"].ok, outcomes["v2"].attempts) == (False, 3)
        assert "it still has 47.3987420" in outcomes["v2"].message
        assert late.deaf < 0


async def test_home_is_set_there_only_if_asked_for_and_both_are_told() -> None:
    async with Ground() as ground:
        alpha = Told(ground, 1, PX4, willing=True)
        await asyncio.sleep(3)
        ground.fleet.set_origin(HERE)
        await ground.fleet.orders.push_origin("1")
        assert not [s for s in alpha.got if getattr(s, "command", 0) == 179]
        outcome = (await ground.fleet.orders.push_origin("1", home=True))["v1"]
        assert outcome.ok and "origin: " in outcome.message and "home: " in outcome.message
        assert [s for s in alpha.got if s.name.startswith("COMMAND") and s.command == 179]
