from __future__ import annotations

import asyncio
import itertools
import json
import math
import struct
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.models import FleetConfig
from skygcs.core.geo import Origin
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle.snapshot import take_snapshot
from skygcs.errors import RefusedError, TargetError
from skygcs.events import Event
from skygcs.runtime.fleet import MAX_VEHICLES_OF_LINK, Fleet
from skygcs.runtime.fleet_orders import MAX_KEPT, Order
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import MAX_VEHICLES
from support.examples import is_deep
from support.public_data import present, public_file
from support.services import KnownLinks
from support.vehicles import (
    ARDUPILOT,
    CAPTURE,
    HOME,
    PX4,
    PX4_LOITER,
    Ground,
    ScriptedVehicle,
    Sent,
    Voice,
    accept_everything,
    flight_dialect,
)

ORDERS: dict[str, Order] = {
    "arm": VehicleActor.arm,
    "disarm": VehicleActor.disarm,
    "set_mode": VehicleActor.set_mode,
    "land": VehicleActor.land,
    "rtl": VehicleActor.rtl,
    "hold": VehicleActor.hold,
    "command": VehicleActor.command,
}


def tlog(path: Path) -> Iterator[tuple[float, Frame]]:
    """(seconds, frame) of a tlog, told by the frames' own lengths."""
    data, parser, at = path.read_bytes(), FrameParser(flight_dialect()), 0
    while at + 11 < len(data):
        (stamp,) = struct.unpack_from(">Q", data, at)
        at += 8
        size = data[at + 1] + (12 + 13 * (data[at + 2] & 1) if data[at] == 0xFD else 8)
        for frame in parser.feed_datagram(data[at : at + size]):
            yield stamp / 1e6, frame
        at += size


class Listening:
    """A fleet that only listens, in the times of a recording."""

    def __init__(self, config: dict | None = None) -> None:  # type: ignore[type-arg]
        self.events: list[Event] = []
        self.sent = 0
        loop = asyncio.get_running_loop()
        self.fleet = Fleet(
            FleetConfig.model_validate(config or {}),
            flight_dialect(),
            self._send,
            loop,
            self.events.append,
            links=KnownLinks(),
        )

    def _send(self, *_: object, **__: object) -> bool:
        self.sent += 1
        return True

    def hear(self, frame: Frame, now: float = 1.0, link: str = "here") -> None:
        self.fleet.on_frame(frame.sysid << 8 | frame.compid, frame, link, now)

    def story(self, vehicle: str, kind: str, key: str) -> list[object]:
        return [e.data[key] for e in self.events if e.vehicle == vehicle and e.kind == kind]


async def replayed(config: dict | None = None) -> Listening:  # type: ignore[type-arg]
    listening = Listening(config)
    first, ticked = None, 0.0
    for at, frame in tlog(CAPTURE):
        first = at if first is None else first
        while ticked + 0.5 <= at - first:
            ticked += 0.5
            listening.fleet.tick(ticked)
        listening.hear(frame, at - first)
    return listening


@pytest.fixture
async def ground() -> AsyncIterator[Ground]:
    async with Ground() as made:
        yield made


async def test_an_autopilot_with_our_own_ids_is_refused_with_one_event() -> None:
    listening = Listening({"daemon": {"sysid": 3, "compid": 1}})
    frame = next(f for _, f in tlog(CAPTURE) if f.msgid == 0 and (f.sysid, f.compid) == (3, 1))
    for second in range(10):
        listening.hear(frame, float(second))
    assert not listening.fleet.vehicles and listening.fleet.refused_vehicles == 10
    (event,) = listening.events
    assert event.kind == "conflict" and "has our own ids 3/1" in event.text


async def test_the_captured_flights_are_told_as_they_happened() -> None:
    """Five vehicles, and a ground station that is none."""
    listening = await replayed({"origin": {"lat_deg": HOME[0], "lon_deg": HOME[1], "alt_amsl_m": HOME[2]}})
    fleet = listening.fleet
    assert sorted(fleet.vehicles) == [n << 8 | 1 for n in range(1, 6)]
    assert [v.vehicle.family for v in fleet.resolve("all")] == ["ardupilot"] * 3 + ["px4"] * 2
    assert Counter(e.kind for e in listening.events)["vehicle_discovered"] == 5
    assert not [e for e in listening.events if e.kind in ("vehicle_lost", "reboot", "conflict", "failsafe")]

    for name in ("v1", "v2", "v3"):
        assert listening.story(name, "mode", "mode") == ["GUIDED", "LAND"]
        assert listening.story(name, "landed", "landed") == ["takeoff", "in_air", "landing", "on_ground"]
    for name in ("v4", "v5"):
        px4 = ["AUTO.TAKEOFF", "AUTO.LOITER", "OFFBOARD", "AUTO.LOITER", "AUTO.LAND", "AUTO.LOITER"]
        assert listening.story(name, "mode", "mode") == px4
        assert listening.story(name, "landed", "landed") == ["takeoff", "in_air", "landing", "on_ground"]
    for name in ("v1", "v2", "v3", "v4", "v5"):
        kinds = [e.kind for e in listening.events if e.vehicle == name and e.kind in ("armed", "disarmed")]
        assert kinds == ["armed", "disarmed"]
    end = 75.0  # landed vehicles
    for actor in listening.fleet.resolve("all"):
        state = take_snapshot(actor.vehicle, end)
        assert (state["armed"], state["landed"], state["type"]) == (False, "on_ground", "QUADROTOR")
        position, home, battery = state["position"], state["home"], state["battery"]
        assert position is not None and home is not None and battery is not None
        assert abs(position["alt_rel_m"]) < 0.2
        assert max(map(abs, position["enu_m"][:2])) < 200
        assert abs(position["enu_m"][2]) < 2
        assert state["gps"] is not None and state["gps"]["satellites"] == 10
        assert 10 < battery["volts"] < 17
        assert state["messages"]["GLOBAL_POSITION_INT"]["rate_hz"] == pytest.approx(4, abs=0.5)
        json.dumps(state, allow_nan=False)


async def test_a_part_that_fails_in_a_tick_takes_no_other_part_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    listening, ticked = Listening(), list[str]()
    for part in ("components", "trajectories", "plans", "notes"):

        def tick(*now: float, part: str = part) -> None:
            ticked.append(part)
            raise ValueError(part)

        monkeypatch.setattr(getattr(listening.fleet, part), "tick", tick)
    with pytest.raises(ValueError, match="components"):
        listening.fleet.tick(1.0)
    assert ticked == ["components", "trajectories", "plans", "notes"]


async def test_the_next_control_tick_is_the_first_of_all_vehicles() -> None:
    listening = Listening()
    fleet = listening.fleet
    for sysid in (1, 2):
        listening.hear(Voice(sysid).beat())
    assert fleet.next_control_tick() == math.inf
    clocks = [actor.offboard.clock for actor in fleet.resolve("v1,v2")]
    for clock in clocks:
        clock.start()
    assert fleet.next_control_tick() == min(clock.due for clock in clocks)
    first, last = sorted(clocks, key=lambda clock: clock.due)
    assert first.due < last.due
    first.stop()
    assert fleet.next_control_tick() == last.due
    last.stop()
    assert fleet.next_control_tick() == math.inf


async def test_the_capture_flew_up_and_never_down_on_the_way_up() -> None:
    """vz of GLOBAL_POSITION_INT is positive down: while the height grows, our up velocity has to be positive."""
    listening = Listening()
    signs: Counter[bool] = Counter()
    heights: dict[int, float] = {}
    for at, frame in tlog(CAPTURE):
        listening.hear(frame, at)
        if frame.name != "GLOBAL_POSITION_INT" or frame.sysid << 8 | 1 not in listening.fleet.vehicles:
            continue
        position = listening.fleet.vehicles[frame.sysid << 8 | 1].vehicle.telemetry("position")
        assert position is not None
        climbed = position["alt_rel_m"] - heights.get(frame.sysid, position["alt_rel_m"])
        heights[frame.sysid] = position["alt_rel_m"]
        if abs(climbed) > 0.15:
            signs[position["vel_enu_mps"][2] * climbed > 0] += 1
    assert signs[True] > 300
    assert signs[False] < 0.03 * signs[True]  # an estimator corrects itself by a jump now and then


MOST_FRAMES = 2000
"""Frames of a capture that `make test` reads: by then all its vehicles were heard."""

OWN_FLEET = {**dict.fromkeys(("1/1", "2/1", "3/1"), "ardupilot"), **dict.fromkeys(("11/1", "12/1"), "px4")}
EXPECTED_VEHICLES = {
    "dronekit-v1-sik.tlog": {"1/1": "ardupilot"},
    "dronekit-2012-16k-truncated.tlog": {"1/1": "ardupilot"},
    "eagle-c2-v2-sik-mp-mavproxy.tlog": {"1/1": "ardupilot"},
    "qgc-ardusub-v2-badcrc.tlog": {"1/1": "ardupilot"},
    "made-flood.tlog": {"1/1": "ardupilot"},
    "made-v1-v2-mixed.tlog": {"1/1": "ardupilot"},
    "made-signed.tlog": {"1/1": "px4"},
    "made-unknown-ids.tlog": {"1/1": "ardupilot"},
    "made-everything.tlog": {"1/1": "ardupilot"},
    "made-plane.tlog": {"1/1": "ardupilot"},
    "made-submarine.tlog": {"1/1": "ardupilot"},
    "made-indoors.tlog": {"1/1": "px4"},
    "sitl-3ardupilot-2px4.tlog": {
        **dict.fromkeys(("1/1", "2/1", "3/1"), "ardupilot"),
        **dict.fromkeys(("4/1", "5/1"), "px4"),
    },
    "forged-heartbeat-50hz.tlog": OWN_FLEET,
    "second-heartbeat-1hz.tlog": OWN_FLEET,
    "bluerobotics-mavlink-server.tlog": {"1/1": "ardupilot"},
    "px4-v2-2020.tlog": {"1/1": "px4"},
    "wlichon-flood-sysid2-v1.tlog": {"1/1": "ardupilot"},
    "danonishe-gcs252-v2.tlog": {"1/1": "ardupilot"},
    "binus-hexa-5src-mixed.tlog": {"1/1": "ardupilot"},
    "interop-testdata-v1.tlog": {"1/1": "ardupilot"},
}


@pytest.mark.parametrize("name", present("tlog", sorted(EXPECTED_VEHICLES)))
async def test_in_captures_only_their_autopilots_are_vehicles(name: str) -> None:
    path = public_file(f"tlog/{name}")
    listening = Listening()
    for at, frame in itertools.islice(tlog(path), None if is_deep() else MOST_FRAMES):
        listening.hear(frame, at)
    found = {f"{a.sysid}/{a.compid}": a.vehicle.family for a in listening.fleet.vehicles.values()}
    assert found == EXPECTED_VEHICLES[name]
    for actor in listening.fleet.vehicles.values():
        json.dumps(take_snapshot(actor.vehicle, at), allow_nan=False)


async def test_names_groups_and_origin_come_from_the_fleet_file() -> None:
    config = {
        "vehicles": {
            "alpha": {"sysid": 1, "group": ["red", "lead"]},
            "bravo": {"sysid": 2, "group": "red"},
            "bravo2": {"sysid": 5, "group": "spare"},
        },
        "origin": {"lat_deg": HOME[0], "lon_deg": HOME[1], "alt_amsl_m": 480.0},
    }
    listening = Listening(config)
    for sysid in (1, 2, 3):
        listening.hear(Voice(sysid).beat())
        listening.hear(Voice(sysid).position())
    fleet = listening.fleet
    assert [a.name for a in fleet.resolve("all")] == ["alpha", "bravo", "v3"]
    assert [a.name for a in fleet.resolve("red")] == ["alpha", "bravo"]
    assert fleet.find("alpha").state(1.0)["position"]["enu_m"][2] == pytest.approx(8.1, abs=0.01)
    fleet.set_origin(Origin(HOME[0], HOME[1], 488.1))
    listening.hear(Voice(9).beat())
    listening.hear(Voice(9).position())
    assert [a.state(1.0)["position"]["enu_m"] for a in fleet.resolve("2,9")] == [[0.0, 0.0, 0.0]] * 2
    with pytest.raises(TargetError, match="names 2 vehicles"):
        fleet.find("red")
    # one that is expected and silent: "did you mean 'bravo'?" was the answer to its stop
    for target in ("bravo2", "5", "spare", ["1", "bravo2"]):
        with pytest.raises(TargetError, match="nothing was heard of bravo2"):
            fleet.resolve_any(target)


async def test_an_unexpected_autopilot_is_told_once() -> None:
    listening = Listening({"vehicles": {"alpha": {"sysid": 1, "autopilot": "ardupilot"}}})
    for _ in range(3):
        listening.hear(Voice(1).beat(PX4))
    conflicts = [e for e in listening.events if e.kind == "conflict"]
    assert [e.data for e in conflicts] == [{"expected": "ardupilot", "autopilot": "px4"}]


async def test_frames_before_the_first_heartbeat_make_no_vehicle() -> None:
    listening = Listening()
    listening.hear(Voice(1).position())
    listening.hear(Voice(1).text("hello"))
    assert not listening.fleet.vehicles
    with pytest.raises(TargetError, match="no vehicle has been heard"):
        listening.fleet.resolve("all")
    listening.hear(Voice(1).beat())
    assert [e.kind for e in listening.events] == ["statustext", "vehicle_discovered"]
    assert listening.events[0].text == "1/1: hello"
    assert listening.events[1].text == "px4 quadrotor, system 1, AUTO.LOITER, over here"


async def test_other_components_of_a_vehicles_system_do_not_touch_its_state() -> None:
    listening = Listening()
    listening.hear(Voice(1).beat())
    listening.hear(Voice(1, 100).position())
    listening.hear(Voice(1, 100).say(mav.MAVLink_heartbeat_message(30, 8, 0, 0, 4, 3)))
    assert len(listening.fleet.vehicles) == 1
    assert listening.fleet.find(1).state(1.0)["position"] is None


async def test_a_second_autopilot_of_one_system_gets_a_name_of_its_own() -> None:
    listening = Listening({"vehicles": {"alpha": {"sysid": 1}}})
    listening.hear(Voice(1, 1).beat())
    listening.hear(Voice(1, 2).beat())
    assert [a.name for a in listening.fleet.resolve("1")] == ["alpha", "alpha-2"]


async def test_forged_vehicles_leave_room_for_those_of_another_link_and_of_the_fleet_file() -> None:
    listening = Listening({"vehicles": {"alpha": {"sysid": 254}}})
    for sysid in range(1, 254):
        listening.hear(Voice(sysid).beat())
        listening.hear(Voice(sysid, 2).beat())
    assert len(listening.fleet.vehicles) == MAX_VEHICLES_OF_LINK
    assert listening.fleet.refused_vehicles == 253 * 2 - MAX_VEHICLES_OF_LINK
    assert [e.kind for e in listening.events].count("conflict") == 1
    listening.hear(Voice(201, 77).beat(), link="radio")
    assert listening.fleet.find(201).vehicle.connected
    for compid in range(100, 200):
        listening.hear(Voice(202, compid).beat(), link="other")
    assert len(listening.fleet.vehicles) == MAX_VEHICLES
    listening.hear(Voice(254).beat())
    assert listening.fleet.find("alpha").sysid == 254
    listening.hear(Voice(254, 2).beat())
    assert len(listening.fleet.vehicles) == MAX_VEHICLES + 1, "one place for each vehicle of the file"


async def test_a_lost_vehicle_gives_its_place_to_one_that_is_heard() -> None:
    listening = Listening()
    for compid in (1, 2):
        for sysid in range(1, 126):
            listening.hear(Voice(sysid, compid).beat())
    assert len(listening.fleet.vehicles) == MAX_VEHICLES_OF_LINK
    listening.fleet.tick(60.0)
    listening.hear(Voice(1).beat(), 60.0)
    listening.hear(Voice(250).beat(), 60.0)
    assert len(listening.fleet.vehicles) == MAX_VEHICLES_OF_LINK
    assert listening.fleet.find(250).vehicle.connected
    assert 1 << 8 | 1 in listening.fleet.vehicles, "which is heard"
    assert 2 << 8 | 1 not in listening.fleet.vehicles, "which was lost, and met before all others"
    listening.hear(Voice(249).beat(), 60.9)
    assert [e.vehicle for e in listening.events if e.data.get("forgotten")] == ["v2"], "one a second"
    listening.hear(Voice(249).beat(), 61.0)
    assert [e.vehicle for e in listening.events if e.data.get("forgotten")] == ["v2", "v3"]


async def test_made_up_ids_keep_no_vehicle_out_that_goes_on_sending() -> None:
    listening, made_up = Listening(), ((s, c) for c in range(2, 200) for s in range(1, 251))
    for _ in range(MAX_VEHICLES_OF_LINK):
        listening.hear(Voice(*next(made_up)).beat())
    for second in range(60, 64):
        listening.fleet.tick(float(second))
        for k in range(200):
            if second >= 62 and k == 75:
                listening.hear(Voice(77).beat(), second + 0.372)
            listening.hear(Voice(*next(made_up)).beat(), second + k / 200)
    assert listening.fleet.vehicles[77 << 8 | 1].vehicle.connected
    assert len([e for e in listening.events if e.data.get("forgotten")]) <= 5, "one a second, and this one"


async def test_a_vehicle_that_fades_for_a_moment_is_not_the_first_to_go() -> None:
    listening = Listening()
    for compid in (1, 2):
        for sysid in range(1, 126):
            listening.hear(Voice(sysid, compid).beat())
    listening.hear(Voice(1).beat(), 50.0)
    listening.fleet.tick(60.0)
    for sysid in range(126, 254):
        listening.hear(Voice(sysid).beat(), 60.0)
    assert 1 << 8 | 1 in listening.fleet.vehicles, "it was heard last of those that are lost"


@given(st.lists(st.binary(max_size=40), max_size=5))
def test_noise_makes_no_vehicle(noise: list[bytes]) -> None:
    parser = FrameParser(flight_dialect())

    async def listen() -> None:
        listening = Listening()
        for data in noise:
            for frame in parser.feed(data):
                listening.hear(frame)
        assert not listening.fleet.vehicles

    asyncio.run(listen())


@pytest.mark.looptime
class TestOrdersForMany:
    async def swarm(self, ground: Ground, px4: int = 2, copters: int = 2) -> list[ScriptedVehicle]:
        vehicles = [ScriptedVehicle(ground, n + 1, PX4) for n in range(px4)]
        vehicles += [ScriptedVehicle(ground, px4 + n + 1, ARDUPILOT, mode=4) for n in range(copters)]
        for vehicle in vehicles:
            vehicle.armed, vehicle.flying, vehicle.status = True, True, 4
        await asyncio.sleep(1.5)
        return vehicles

    def commands(self, ground: Ground) -> list[Sent]:
        return [s for s in ground.sent if s.priority is not Priority.PROTOCOL]

    async def test_one_broadcast_lands_the_ardupilots_of_a_mixed_fleet_and_each_outcome_is_known(
        self, ground: Ground
    ) -> None:
        """PX4 takes commands for its own system id only, so each PX4 is sent its own, at once."""
        await self.swarm(ground)
        outcomes = await ground.fleet.orders.command_all("all", VehicleActor.land)
        assert {n: o.result for n, o in outcomes.items()} == {f"v{n}": "accepted" for n in range(1, 5)}
        *own, sent = self.commands(ground)
        assert [s.sysid for s in own] == [1, 2]
        assert (sent.sysid, sent.compid, sent.target_system, sent.command) == (0, 0, 0, 21)

    async def test_who_did_not_answer_a_broadcast_is_sent_its_own(self, ground: Ground) -> None:
        vehicles = await self.swarm(ground)
        heard: list[int] = []

        def deaf_once(v: ScriptedVehicle, sent: Sent) -> None:
            heard.append(sent.sysid)
            if sent.sysid:
                accept_everything(v, sent)

        vehicles[2].script = deaf_once
        outcomes = await ground.fleet.orders.command_all("all", VehicleActor.rtl)
        assert outcomes["v1"].attempts == 1
        assert outcomes["v3"].attempts == 2
        assert heard == [0, 3]
        assert [s.sysid for s in self.commands(ground)] == [1, 2, 0, 3]

    async def test_a_refusal_of_one_is_not_the_others(self, ground: Ground) -> None:
        vehicles = await self.swarm(ground)
        vehicles[1].script = lambda v, sent: v.reply(sent, 2)
        outcomes = await ground.fleet.orders.command_all("all", VehicleActor.land)
        assert [outcomes[f"v{n}"].result for n in range(1, 5)] == ["accepted", "denied", "accepted", "accepted"]

    async def test_hold_of_a_mixed_fleet_is_sent_to_each_because_it_is_another_command(self, ground: Ground) -> None:
        await self.swarm(ground)
        outcomes = await ground.fleet.orders.command_all("all", VehicleActor.hold)
        assert all(o.ok for o in outcomes.values())
        # BRAKE and then GUIDED to the copters
        assert sorted(s.sysid for s in self.commands(ground)) == [1, 2, 3, 3, 4, 4]

    @pytest.mark.parametrize(("order", "force"), [("hold", {}), ("disarm", {"force": True}), ("disarm", {})])
    async def test_a_mode_and_a_disarming_are_never_broadcast(
        self, ground: Ground, order: str, force: dict[str, bool]
    ) -> None:
        """Nobody knows who else listens: a broadcast disarming drops a vehicle that flies and is not ours."""
        vehicles = await self.swarm(ground, px4=0, copters=3)
        for vehicle in vehicles:
            vehicle.flying, vehicle.status = order == "hold", 3
        await asyncio.sleep(1.5)
        assert all(o.ok for o in (await ground.fleet.orders.command_all("all", ORDERS[order], **force)).values())
        # BRAKE and then GUIDED, to each as soon as it has answered
        assert sorted(s.sysid for s in self.commands(ground)) == sorted([1, 2, 3] * (2 if order == "hold" else 1))

    async def test_nothing_is_broadcast_where_others_may_hear_it(self, ground: Ground) -> None:
        await self.swarm(ground, px4=0, copters=3)
        ground.links.broadcast = False
        assert all(o.ok for o in (await ground.fleet.orders.command_all("all", VehicleActor.land)).values())
        assert [s.sysid for s in self.commands(ground)] == [1, 2, 3]
        ground.links.broadcast = True
        ground.fleet.refused_vehicles = 1  # an autopilot was met that found no place in the fleet
        assert all(o.ok for o in (await ground.fleet.orders.command_all("all", VehicleActor.rtl)).values())
        assert [s.sysid for s in self.commands(ground)] == [1, 2, 3] * 2
        ground.fleet.refused_vehicles = 0
        ground.fleet.set_duplicate(2 << 8 | 1, "on udp and on radio")
        assert all(o.ok for o in (await ground.fleet.orders.command_all("all", VehicleActor.land)).values())
        assert [s.sysid for s in self.commands(ground)] == [1, 2, 3] * 3
        ground.fleet.set_duplicate(2 << 8 | 1, None)
        outcomes = await ground.fleet.orders.command_all("1-2", VehicleActor.rtl)  # some of them
        assert list(outcomes) == ["v1", "v2"]
        assert sorted(s.sysid for s in self.commands(ground)[9:]) == [1, 2]

    @pytest.mark.parametrize(("order", "command"), [("land", 21), ("rtl", 20), ("hold", 192), ("disarm", 400)])
    async def test_an_order_that_ends_a_flight_is_carried_on_when_its_caller_is_gone(
        self, ground: Ground, order: str, command: int
    ) -> None:
        (vehicle,) = await self.swarm(ground, px4=1, copters=0)
        vehicle.mode = 3 << 16
        if order == "disarm":
            vehicle.flying = False
        await asyncio.sleep(1.5)
        vehicle.script = lambda v, sent: accept_everything(v, sent) if sent.confirmation == 2 else None
        caller = asyncio.create_task(ground.fleet.orders.command_all("1", ORDERS[order]))
        await asyncio.sleep(0.3)
        caller.cancel()
        with pytest.raises(asyncio.CancelledError):
            await caller
        await asyncio.sleep(10)
        assert [c for c, _ in vehicle.commands()] == [command] * 3
        (reported,) = [e for e in ground.events if e.kind == "command"]
        assert (reported.data["order"], reported.data["ok"]) == (order, True)
        assert not ground.fleet.orders._kept

    async def test_other_orders_end_with_their_caller_and_that_is_told(self, ground: Ground) -> None:
        (vehicle,) = await self.swarm(ground, px4=1, copters=0)
        vehicle.script = lambda v, sent: None
        caller = asyncio.create_task(ground.fleet.orders.command_all("1", VehicleActor.reboot, force=True))
        await asyncio.sleep(0.3)
        caller.cancel()
        await asyncio.gather(caller, return_exceptions=True)
        await asyncio.sleep(5)
        assert len(vehicle.got) == 1
        (reported,) = [e for e in ground.events if e.kind == "command"]
        assert (reported.data["order"], reported.data["result"]) == ("reboot", "cancelled")

    async def test_orders_that_are_kept_are_bounded_and_end_with_the_fleet(self, ground: Ground) -> None:
        (vehicle,) = await self.swarm(ground, px4=1, copters=0)
        vehicle.script = lambda v, sent: None
        callers = [
            asyncio.create_task(ground.fleet.orders.command_all("1", VehicleActor.land)) for _ in range(MAX_KEPT + 5)
        ]
        await asyncio.sleep(0)
        assert len(ground.fleet.orders._kept) == MAX_KEPT
        ground.fleet.close()
        await asyncio.sleep(0.1)
        assert not ground.fleet.orders._kept
        for caller in callers:
            caller.cancel()
        await asyncio.gather(*callers, return_exceptions=True)

    async def test_a_landing_that_was_kept_gives_way_to_a_newer_order(self, ground: Ground) -> None:
        (vehicle,) = await self.swarm(ground, px4=1, copters=0)
        vehicle.script = lambda v, sent: None
        for _ in range(3):  # one in flight, two that wait for it
            caller = asyncio.create_task(ground.fleet.orders.command_all("1", VehicleActor.land))
            await asyncio.sleep(0.1)
            caller.cancel()
        vehicle.script = accept_everything
        there = {"lat_deg": HOME[0] + 1e-4, "lon_deg": HOME[1]}
        assert (await ground.fleet.orders.command_all("1", VehicleActor.goto, **there))["v1"].ok
        await asyncio.sleep(10)
        assert [c for c, _ in vehicle.commands()] == [21, 192]
        reported = [e.data["result"] for e in ground.events if e.kind == "command" and e.data["order"] == "land"]
        assert reported == ["cancelled"] * 3

    async def test_two_vehicles_of_one_id_are_given_only_orders_that_end_a_flight(self, ground: Ground) -> None:
        (vehicle,) = await self.swarm(ground, px4=1, copters=0)
        vehicle.mode = 3 << 16
        await asyncio.sleep(1.5)
        fleet, actor = ground.fleet, ground.fleet.find(1)
        fleet.set_duplicate(1 << 8 | 1, "on udp and on radio")
        assert actor.state(ground.loop.time())["duplicate_sysid"] is True
        arguments = {"set_mode": ("POSCTL",), "command": (183, [1.0])}
        for order in ("arm", "set_mode", "command"):
            outcome = (await fleet.orders.command_all("1", ORDERS[order], *arguments.get(order, ())))["v1"]
            assert outcome.result == "refused"
            said = "two vehicles with system id 1 are on the air (on udp and on radio); give one of them another"
            assert said in outcome.message
        assert vehicle.got == []
        for order in ("land", "rtl", "hold"):
            assert (await fleet.orders.command_all("1", ORDERS[order]))["v1"].ok
        for force in (False, True):
            with pytest.raises(RefusedError, match=r"v1 \(two vehicles: on udp and on radio\).*'disarm-2'"):
                await fleet.orders.command_all("1", VehicleActor.disarm, force=force)
        assert 400 not in [c for c, _ in vehicle.commands()]
        assert (await fleet.orders.command_all("1", VehicleActor.disarm, force=True, confirm="disarm-2"))["v1"].ok
        fleet.set_duplicate(1 << 8 | 1, None)
        assert actor.state(ground.loop.time())["duplicate_sysid"] is False
        assert (await fleet.orders.command_all("1", VehicleActor.set_mode, "AUTO.RTL"))["v1"].ok

    async def test_a_duplicate_found_in_the_middle_of_a_takeoff_ends_it(self, ground: Ground) -> None:
        vehicle = ScriptedVehicle(ground, 1, ARDUPILOT)
        await ground.met(vehicle)
        takeoff = asyncio.create_task(ground.fleet.orders.command_all("1", VehicleActor.takeoff, 5.0))
        await asyncio.sleep(0.3)
        ground.fleet.set_duplicate(1 << 8 | 1, "on udp and on radio")
        outcome = (await takeoff)["v1"]
        assert "two vehicles with system id 1" in outcome.message
        assert [c for c, _ in vehicle.commands()] == [176]

    async def test_a_duplicate_known_before_its_heartbeat_is_one_from_the_start(self, ground: Ground) -> None:
        ground.fleet.set_duplicate(1 << 8 | 1, "on udp and on radio")
        await self.swarm(ground, px4=1, copters=0)
        assert ground.fleet.find(1).vehicle.duplicate

    async def test_arming_is_never_broadcast(self, ground: Ground) -> None:
        vehicles = await self.swarm(ground)
        for vehicle in vehicles:
            vehicle.armed, vehicle.flying, vehicle.status = False, False, 3
        await asyncio.sleep(1.5)
        assert all(o.ok for o in (await ground.fleet.orders.command_all("all", VehicleActor.arm)).values())
        assert sorted(s.sysid for s in self.commands(ground)) == [1, 2, 3, 4]

    async def test_who_was_busy_with_the_same_command_is_sent_its_own_after_the_broadcast(self, ground: Ground) -> None:
        vehicles = await self.swarm(ground, px4=0, copters=3)
        vehicles[0].script = lambda v, sent: ground.loop.call_later(0.5, accept_everything, v, sent)
        alone = asyncio.create_task(ground.fleet.find(1).land())
        await asyncio.sleep(0.1)
        outcomes = await ground.fleet.orders.command_all("all", VehicleActor.land)
        assert (await alone).ok
        assert [o.attempts for o in outcomes.values()] == [1, 1, 1]
        assert [s.sysid for s in self.commands(ground)] == [1, 0, 1]

    async def test_a_disarming_that_one_would_be_refused_is_not_broadcast(self, ground: Ground) -> None:
        vehicles = await self.swarm(ground)
        vehicles[0].armed, vehicles[0].flying = True, False
        await asyncio.sleep(1.5)
        outcomes = await ground.fleet.orders.command_all("all", VehicleActor.disarm)
        assert outcomes["v1"].ok
        assert [outcomes[f"v{n}"].result for n in (2, 3, 4)] == ["refused"] * 3
        assert [s.sysid for s in self.commands(ground)] == [1]

    async def test_an_emergency_stop_is_sent_to_each_and_repeated_to_each_that_is_silent(self, ground: Ground) -> None:
        vehicles = await self.swarm(ground)
        vehicles[3].silent = True
        await asyncio.sleep(8)
        assert not ground.fleet.find(4).vehicle.connected
        outcomes = await ground.fleet.orders.command_all("all", VehicleActor.disarm, force=True)
        sent = self.commands(ground)
        assert [(s.sysid, s.param2) for s in sent[:4]] == [(n, 21196.0) for n in (1, 2, 3, 4)]
        assert {s.priority for s in sent} == {Priority.EMERGENCY}
        assert [outcomes[f"v{n}"].ok for n in range(1, 5)] == [True, True, True, False]
        assert {s.sysid for s in sent[4:]} == {4}
        assert not any(v.armed for v in vehicles[:3])

    async def test_the_carrier_is_gone_after_an_order_that_was_cancelled(self, ground: Ground) -> None:
        vehicles = await self.swarm(ground)
        for vehicle in vehicles:
            vehicle.script = lambda v, sent: None
        task = asyncio.create_task(ground.fleet.orders.command_all("all", VehicleActor.land))
        await asyncio.sleep(0.5)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        for vehicle in vehicles:
            vehicle.script = accept_everything
        assert (await ground.fleet.find(1).land()).ok
        assert self.commands(ground)[-1].sysid == 1

    async def test_every_vehicle_gets_its_own_mode_number(self, ground: Ground) -> None:
        vehicles = await self.swarm(ground)
        outcomes = await ground.fleet.orders.command_all("all", VehicleActor.set_mode, "LOITER", force=True)
        assert all(o.ok for o in outcomes.values())
        assert vehicles[0].mode == PX4_LOITER
        assert vehicles[2].mode == 5

    async def test_a_fault_of_ours_in_one_order_does_not_touch_the_others(
        self, ground: Ground, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        await self.swarm(ground)
        broken = ground.fleet.find(2)

        async def fail(*_: object, **__: object) -> None:
            raise ZeroDivisionError

        monkeypatch.setattr(broken.commands, "run", fail)
        outcomes = await ground.fleet.orders.command_all("all", VehicleActor.land)
        assert [outcomes[f"v{n}"].ok for n in range(1, 5)] == [True, False, True, True]
        assert "ZeroDivisionError" in outcomes["v2"].message
        assert [e.kind for e in ground.events if e.vehicle == "v2"].count("fault") == 1

    async def test_vehicles_sent_to_one_place_keep_apart_unless_told(self, ground: Ground) -> None:
        vehicles = await self.swarm(ground, px4=2, copters=0)
        for n, vehicle in enumerate(vehicles):
            vehicle.place = (HOME[0], HOME[1] + n * 1e-4)
        await asyncio.sleep(1.5)
        there = {"lat_deg": HOME[0] + 1e-3, "lon_deg": HOME[1]}
        assert all(o.ok for o in (await ground.fleet.orders.command_all("all", VehicleActor.goto, **there)).values())
        first, second = (s.y / 1e7 for s in self.commands(ground)[:2])
        assert second - first == pytest.approx(1e-4, abs=2e-7)
        assert (first + second) / 2 == pytest.approx(HOME[1], abs=1e-7)
        await ground.fleet.orders.command_all("all", VehicleActor.goto, **there, same_place=True)
        assert {s.y for s in self.commands(ground)[2:]} == {round(HOME[1] * 1e7)}
        refused = await ground.fleet.orders.command_all("all", VehicleActor.goto, lat_deg=91.0, lon_deg=8.0, force=True)
        assert {o.result for o in refused.values()} == {"refused"}

    async def spread(self, ground: Ground, *east_deg: float) -> list[ScriptedVehicle]:
        """Flying PX4s that many degrees of longitude east of home."""
        vehicles = await self.swarm(ground, px4=len(east_deg), copters=0)
        for vehicle, east in zip(vehicles, east_deg, strict=True):
            vehicle.place = (HOME[0], HOME[1] + east)
        await asyncio.sleep(1.5)
        return vehicles

    async def test_only_who_flies_and_is_known_to_be_somewhere_has_a_say_in_the_middle(self, ground: Ground) -> None:
        vehicles = await self.spread(ground, 0.0, 1e-4, 1e-3, 2e-3, 3e-3)
        vehicles[2].flying = False
        vehicles[3].silent = True
        unplaced = vehicles[4]
        unplaced.pulse = lambda: unplaced.tell(unplaced.beat(PX4, armed=True, status=4))  # type: ignore[method-assign]
        await asyncio.sleep(11)
        there = {"lat_deg": HOME[0] + 1e-3, "lon_deg": HOME[1]}
        outcomes = await ground.fleet.orders.command_all("all", VehicleActor.goto, **there)
        assert list(outcomes) == [f"v{n}" for n in range(1, 6)]
        assert [o.result for o in outcomes.values()] == ["accepted"] * 2 + ["refused"] * 3
        for name, said in {"v3": "on the ground", "v4": "lost", "v5": "position is not known"}.items():
            assert said in outcomes[name].message
        first, second = (s.y / 1e7 for s in self.commands(ground))
        assert (first + second) / 2 == pytest.approx(HOME[1], abs=1e-7)
        assert len([e for e in ground.events if e.kind == "command"]) == 5

    async def test_vehicles_that_would_end_too_close_are_not_sent_unless_insisted_on(self, ground: Ground) -> None:
        await self.spread(ground, 0.0, 2e-5)  # 1.5 m
        there = {"lat_deg": HOME[0] + 1e-3, "lon_deg": HOME[1]}
        outcomes = await ground.fleet.orders.command_all("all", VehicleActor.goto, **there)
        assert {o.result for o in outcomes.values()} == {"refused"}
        assert "v1 and v2 would end 1.5 m apart" in outcomes["v1"].message
        assert self.commands(ground) == []
        for insisted in ({"force": True}, {"same_place": True}):
            outcomes = await ground.fleet.orders.command_all("all", VehicleActor.goto, **there, **insisted)
            assert all(o.ok for o in outcomes.values())

    async def test_an_order_to_a_vehicle_that_does_not_exist_is_refused(self, ground: Ground) -> None:
        await self.swarm(ground)
        with pytest.raises(TargetError):
            await ground.fleet.orders.command_all("77", VehicleActor.land)
        assert self.commands(ground) == []
