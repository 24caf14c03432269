"""Missions, fences and rally points on simulated vehicles: how each firmware takes them in, and how it flies them."""

from __future__ import annotations

from math import hypot, nan
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mission.item import MissionType
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from skygcs.sim.vehicle import SimVehicle
from support.sim_pilot import COPTER_GUIDED, FIELD, Pilot, copter, px4
from support.table import each

BOTH = pytest.mark.parametrize("make", [px4, copter])
REL, MISSION, GLOBAL = 3, 2, 0

Item = tuple[int, int, tuple[float, float, float, float], float, float, float]
"""command, frame, param1..4, metres east and north of the FIELD, z."""


def at(command: int, east: float, north: float, up: float, *p: float) -> Item:
    four = (*p, 0.0, 0.0, 0.0, 0.0)[:4]
    return command, REL, (four[0], four[1], four[2], four[3]), east, north, up


def do(command: int, *p: float) -> Item:
    four = (*p, 0.0, 0.0, 0.0, 0.0)[:4]
    return command, MISSION, (four[0], four[1], four[2], four[3]), 0.0, 0.0, 0.0


def message(seq: int, item: Item, kind: int = 0, sysid: int = 1) -> Any:
    command, frame, p, east, north, z = item
    lat, lon = FIELD.to_geodetic(east, north)
    x, y = (0, 0) if frame == MISSION else (round(lat * 1e7), round(lon * 1e7))
    return mav.MAVLink_mission_item_int_message(sysid, 1, seq, frame, command, 0, 1, *p, x, y, z, kind)


HOME = at(16, 0, 0, 0)


class Uploader(Pilot):
    """Sends lists as a plain ground station does."""

    def wire(self, items: list[Item], kind: int = 0) -> list[Item]:
        first = [HOME] if kind == 0 and self.vehicles[0].autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA else []
        return first + items

    def upload(self, items: list[Item], kind: int = 0) -> int:
        """The result of the acknowledgement."""
        wire = self.wire(items, kind)
        answers = self.send(mav.MAVLink_mission_count_message(1, 1, len(wire), kind))
        for _ in range(len(wire) + 1):
            asked = [a for a in answers if a.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT")]
            if not asked:
                break
            answers = self.send(message(asked[-1].seq, wire[asked[-1].seq], kind))
        (ack,) = [a for a in answers if a.get_type() == "MISSION_ACK"]
        assert ack.mission_type == kind
        return int(ack.type)

    def ack_of(self, message: Any) -> int | None:
        acks = [a.type for a in self.send(message) if a.get_type() == "MISSION_ACK"]
        return acks[-1] if acks else None

    def reached(self) -> list[int]:
        return [x.seq for x in self.all("MISSION_ITEM_REACHED")]

    def start(self) -> None:
        """Into the mission from the ground, each its own way."""
        v = self.vehicles[0]
        if v.autopilot == mav.MAV_AUTOPILOT_PX4:
            assert self.command(mav.MAV_CMD_MISSION_START) == 0
            return
        assert self.command(mav.MAV_CMD_DO_SET_MODE, 1, COPTER_GUIDED) == 0
        assert self.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
        assert self.command(mav.MAV_CMD_MISSION_START) == 0


SQUARE = [at(22, 0, 0, 10), at(16, 0, 20, 10), at(16, 20, 20, 12, 2.0), at(21, 20, 0, 0)]


@BOTH
def test_a_list_that_was_taken_is_given_back(make: type[SimVehicle]) -> None:
    pilot = Uploader(make())
    assert pilot.upload(SQUARE) == mav.MAV_MISSION_ACCEPTED
    (count,) = pilot.send(mav.MAVLink_mission_request_list_message(1, 1, 0))
    wire = pilot.wire(SQUARE)
    assert count.count == len(wire)
    for seq in range(len(wire) - len(SQUARE), len(wire)):
        (item,) = pilot.send(mav.MAVLink_mission_request_int_message(1, 1, seq, 0))
        sent = message(seq, wire[seq])
        assert (item.seq, item.command, item.x, item.y, item.z) == (seq, sent.command, sent.x, sent.y, sent.z)


@pytest.fixture
def pilot() -> Uploader:
    return Uploader(px4())


def test_a_px4_answers_only_the_next_item_and_the_last_and_gives_up_after_five_seconds(pilot: Uploader) -> None:
    pilot.upload(SQUARE)
    pilot.send(mav.MAVLink_mission_request_list_message(1, 1, 0))
    assert pilot.send(mav.MAVLink_mission_request_int_message(1, 1, 0, 0))[0].seq == 0
    assert pilot.send(mav.MAVLink_mission_request_int_message(1, 1, 0, 0))[0].seq == 0
    assert pilot.ack_of(mav.MAVLink_mission_request_int_message(1, 1, 3, 0)) == mav.MAV_MISSION_ERROR
    assert pilot.send(mav.MAVLink_mission_request_int_message(1, 1, 1, 0)) == [], "the transfer is over"
    pilot.send(mav.MAVLink_mission_count_message(1, 1, 4, 0))
    pilot.forget()
    pilot.run(4.9)
    assert len(pilot.all("MISSION_REQUEST_INT")) > 10
    pilot.run(0.3)
    assert "Operation timeout" in pilot.texts()
    pilot.forget()
    pilot.run(2.0)
    assert not pilot.all("MISSION_REQUEST_INT")
    assert len(pilot.vehicles[0].lists.mission) == 4, "it keeps what it had"


def test_a_px4_repeats_its_last_word_when_the_last_item_comes_again(pilot: Uploader) -> None:
    pilot.upload(SQUARE)
    assert pilot.ack_of(message(3, SQUARE[3])) == mav.MAV_MISSION_ACCEPTED
    assert pilot.ack_of(message(1, SQUARE[1])) == mav.MAV_MISSION_ERROR


def test_a_px4_tells_a_number_that_changes_with_the_list(pilot: Uploader) -> None:
    numbers = set()
    for items in (SQUARE, SQUARE[:3], SQUARE):
        pilot.upload(items)
        pilot.run(6.0)
        raw = pilot.last("MISSION_CURRENT").get_msgbuf()
        numbers.add(bytes(raw[16:20]))
    assert len(numbers) == 2 and b"\0\0\0\0" not in numbers


def test_an_ardupilot_writes_item_over_item_and_gives_up_after_eight_seconds() -> None:
    pilot = Uploader(copter())
    pilot.upload(SQUARE)
    pilot.send(mav.MAVLink_mission_count_message(1, 1, 4, 0))
    pilot.send(message(0, HOME))
    pilot.send(message(1, at(16, 5, 5, 5)))
    assert pilot.ack_of(message(1, at(16, 5, 5, 5))) == mav.MAV_MISSION_INVALID_SEQUENCE
    assert pilot.ack_of(mav.MAVLink_mission_request_list_message(1, 1, 0)) == mav.MAV_MISSION_DENIED
    pilot.forget()
    pilot.run(7.5)
    assert 6 <= len(pilot.all("MISSION_REQUEST")) <= 8
    pilot.run(1.0)
    assert pilot.last("MISSION_ACK").type == mav.MAV_MISSION_OPERATION_CANCELLED
    assert "Mission upload timeout" in pilot.texts()
    held = pilot.vehicles[0].lists.mission
    assert [item.command for item in held] == [16, 16, 16], "its first item is new, it is as long as was announced"
    assert pilot.ack_of(message(2, SQUARE[1])) == mav.MAV_MISSION_ERROR


def test_an_ardupilot_denies_a_second_uploader() -> None:
    pilot = Uploader(copter())
    pilot.send(mav.MAVLink_mission_count_message(1, 1, 4, 0))
    other = mav.MAVLink_mission_count_message(1, 1, 4, 0).pack(mav.MAVLink(None, 250, 190))
    for frame in pilot.uplink.feed(other):
        pilot.vehicles[0].on_frame(frame, pilot.now)
    pilot.collect()
    assert pilot.last("MISSION_ACK").type == mav.MAV_MISSION_DENIED
    assert pilot.last("MISSION_ACK").target_system == 250


def test_an_ardupilot_keeps_its_own_home_and_what_it_has_a_use_for() -> None:
    pilot = Uploader(copter())
    pilot.get_ready()
    assert pilot.upload([at(22, 0, 0, 10.126, 0, 0, 0, nan), do(178, 1, 3)]) == mav.MAV_MISSION_ACCEPTED
    pilot.send(mav.MAVLink_mission_request_list_message(1, 1, 0))
    home, takeoff, speed = (pilot.send(mav.MAVLink_mission_request_int_message(1, 1, s, 0))[0] for s in range(3))
    assert (home.frame, round(home.z)) == (GLOBAL, 180)
    assert (takeoff.param4, round(takeoff.z, 3)) == (0.0, 10.13)
    assert speed.frame == GLOBAL


@each(
    ("make", "items", "kind", "result"),
    [
        (px4, [at(22, 0, 0, 10)] * 501, 0, mav.MAV_MISSION_NO_SPACE),
        (copter, [at(22, 0, 0, 10)] * 725, 0, mav.MAV_MISSION_NO_SPACE),
        (px4, [do(999)], 0, mav.MAV_MISSION_UNSUPPORTED),
        (copter, [do(999)], 0, mav.MAV_MISSION_UNSUPPORTED),
        (px4, [(16, 10, (0, 0, 0, 0), 1, 1, 1)], 0, mav.MAV_MISSION_UNSUPPORTED_FRAME),
        (px4, [(178, REL, (1, 3, 0, 0), 1, 1, 1)], 0, mav.MAV_MISSION_UNSUPPORTED),
        (copter, [at(19, 0, 0, 10, 1, 0, 0, nan)], 0, mav.MAV_MISSION_INVALID_PARAM4),
        (copter, [do(177, 9, 1)], 0, mav.MAV_MISSION_ERROR),
        (px4, [at(5001, 0, 0, 0, 2)] * 2, 1, mav.MAV_MISSION_ERROR),
        (px4, [at(5001, 0, 0, 0, 4)] * 3, 1, mav.MAV_MISSION_ERROR),
        (copter, [at(5001, 0, 0, 0, 4)] * 3, 1, mav.MAV_MISSION_ERROR),
        (copter, [at(5002, 0, 0, 0, 2)] * 2, 1, mav.MAV_MISSION_INVALID_PARAM1),
        (copter, [at(16, 0, 0, 0)], 2, mav.MAV_MISSION_UNSUPPORTED),
        (px4, [at(5100, 0, 0, 0)], 0, mav.MAV_MISSION_ERROR),
    ],
)
def test_what_cannot_be_taken_is_refused(make: type[SimVehicle], items: list[Item], kind: int, result: int) -> None:
    assert Uploader(make()).upload(items, kind) == result


@BOTH
def test_a_mission_is_flown_item_by_item_and_told(make: type[SimVehicle]) -> None:
    pilot = Uploader(make())
    pilot.get_ready()
    pilot.upload(SQUARE)
    pilot.start()
    v = pilot.vehicles[0]
    corners: list[tuple[int, int]] = []
    for _ in range(120):
        pilot.run(1.0)
        here = (round(v.motion.east_m / 20), round(v.motion.north_m / 20))
        if not corners or corners[-1] != here:
            corners.append(here)
    assert corners == [(0, 0), (0, 1), (1, 1), (1, 0)]
    assert not v.armed and v.landed
    first = v.run.first_seq
    assert pilot.reached()[:3] == [first, first + 1, first + 2]
    assert {x.seq for x in pilot.all("MISSION_CURRENT")} >= {first + 1, first + 2, first + 3}


@BOTH
def test_pausing_holds_and_the_mission_goes_on_with_the_same_item(make: type[SimVehicle]) -> None:
    pilot = Uploader(make())
    pilot.get_ready()
    pilot.upload([at(22, 0, 0, 10), at(16, 0, 60, 10), at(17, 0, 0, 10)])
    pilot.start()
    v = pilot.vehicles[0]
    while v.motion.north_m < 20:
        pilot.run(0.5)
    hold, auto = (
        ((1, 4, 3), (1, 4, 4))
        if v.autopilot == mav.MAV_AUTOPILOT_PX4
        else ((1, CopterMode.BRAKE), (1, CopterMode.AUTO))
    )
    assert pilot.command(mav.MAV_CMD_DO_SET_MODE, *hold) == 0
    pilot.run(10.0)
    assert v.motion.groundspeed_mps < 0.2 and v.motion.north_m < 50
    assert pilot.command(mav.MAV_CMD_DO_SET_MODE, *auto) == 0
    pilot.run(25.0)
    pilot.send(mav.MAVLink_mission_set_current_message(1, 1, v.run.first_seq + 2))
    pilot.run(30.0)
    assert hypot(v.motion.north_m, v.motion.east_m) < 1
    assert v.run.seq == 2, "it loiters there for good"
    assert v.armed


@BOTH
def test_jumps_speeds_and_waits_are_flown(make: type[SimVehicle]) -> None:
    pilot = Uploader(make())
    pilot.get_ready()
    second = 1 + make(1).run.first_seq
    mission = [at(22, 0, 0, 10), at(16, 0, 15, 10), do(178, 1, 2.0), at(19, 0, 0, 10, 4.0), do(177, second, 2), do(20)]
    pilot.upload(mission)
    pilot.start()
    v = pilot.vehicles[0]
    top = 0.0
    for _ in range(900):
        pilot.run(0.2)
        if v.run.reached >= 3:
            top = max(top, v.motion.groundspeed_mps)
        if v.landed and not v.armed and pilot.reached():
            break
    assert pilot.reached().count(second + 2) == 3, "once, and two jumps back to it"
    assert top < 2.6
    assert not v.armed and v.motion.on_ground


def test_an_armed_copter_on_the_ground_does_not_begin_without_a_takeoff() -> None:
    pilot = Uploader(copter())
    pilot.get_ready()
    pilot.upload(SQUARE[1:])
    assert pilot.command(mav.MAV_CMD_MISSION_START) == mav.MAV_RESULT_ACCEPTED, "a disarmed one enters any mode"
    assert pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, COPTER_GUIDED) == 0
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    assert pilot.command(mav.MAV_CMD_MISSION_START) == mav.MAV_RESULT_FAILED
    pilot.run(0.1)
    assert "Auto: Missing Takeoff Cmd" in pilot.texts()


@BOTH
def test_jumps_that_lead_nowhere_end_the_mission(make: type[SimVehicle]) -> None:
    pilot = Uploader(make())
    pilot.get_ready()
    second = 1 + make(1).run.first_seq
    pilot.upload([at(22, 0, 0, 5), do(177, second, -1)])
    pilot.start()
    pilot.run(30.0)
    v = pilot.vehicles[0]
    assert v.run.state == mav.MISSION_STATE_COMPLETE and v.armed and abs(v.motion.up_m - 5) < 1


@BOTH
def test_a_polygon_is_a_fence(make: type[SimVehicle]) -> None:
    pilot = Uploader(make())
    v = pilot.vehicles[0]
    for name, value in (("GF_ACTION", 3), ("FENCE_ENABLE", 1), ("FENCE_ACTION", 1)):
        found = v.params.find(name)
        if found is not None:
            found[1].value = value
    corners = [(-20, -20), (20, -20), (20, 20), (-20, 20)]
    fence = [at(5001, e, n, 0, 4) for e, n in corners] + [at(5004, 0, 10, 0, 3.0)]
    assert pilot.upload(fence, MissionType.FENCE) == mav.MAV_MISSION_ACCEPTED
    pilot.get_ready()
    pilot.upload([at(22, 0, 0, 10), at(16, 0, 40, 10)])
    pilot.start()
    farthest, modes = 0.0, set()
    for _ in range(200):
        pilot.run(0.2)
        farthest = max(farthest, v.motion.north_m)
        modes.add(v.mode)
    assert 6.5 < farthest < 15, "it returns where the exclusion begins"
    assert modes & {Px4Mode.RTL, CopterMode.RTL}
    assert any("fence" in text.lower() for text in pilot.texts())


def fence_flags(pilot: Uploader) -> tuple[bool, bool, bool]:
    """Present, enabled and healthy, of the last SYS_STATUS."""
    status = pilot.last("SYS_STATUS")
    sensors = (
        status.onboard_control_sensors_present,
        status.onboard_control_sensors_enabled,
        status.onboard_control_sensors_health,
    )
    present, enabled, healthy = (bool(flags & mav.MAV_SYS_STATUS_GEOFENCE) for flags in sensors)
    return present, enabled, healthy


@each(
    ("parameters", "flags"),
    [
        ({}, (True, False, True)),  # without the last one MAVProxy reports a breach
        ({"FENCE_TYPE": 0, "FENCE_ENABLE": 1}, (False, False, True)),
        ({"FENCE_TYPE": 4, "FENCE_ENABLE": 1}, (False, False, True)),  # no polygon in the list
        ({"FENCE_ENABLE": 1, "FENCE_ACTION": 0}, (True, False, True)),
        ({"FENCE_ENABLE": 1}, (True, True, True)),
    ],
)
def test_an_ardupilot_reports_a_fence_that_is_off_as_present_and_healthy(
    parameters: dict[str, float], flags: tuple[bool, bool, bool]
) -> None:
    """AC_Fence::sys_status_present, _enabled and _failed."""
    pilot = Uploader(copter())
    for name, value in parameters.items():
        found = pilot.vehicles[0].params.find(name)
        assert found is not None
        found[1].value = value
    pilot.get_ready()
    assert fence_flags(pilot) == flags


def test_an_ardupilot_tells_of_its_fence_also_on_the_ground() -> None:
    pilot = Uploader(copter())
    v = pilot.vehicles[0]
    for name, value in (("FENCE_ENABLE", 1), ("FENCE_RADIUS", 2), ("FENCE_TYPE", 2)):
        found = v.params.find(name)
        assert found is not None
        found[1].value = value
    pilot.get_ready()
    geofence = mav.MAV_SYS_STATUS_GEOFENCE
    assert pilot.last("FENCE_STATUS").breach_status == 0
    assert pilot.last("SYS_STATUS").onboard_control_sensors_health & geofence
    v.motion.east_m = 3.0
    pilot.run(3.0)
    reported = pilot.last("FENCE_STATUS")
    assert (reported.breach_status, reported.breach_count, reported.breach_type) == (1, 1, mav.FENCE_BREACH_BOUNDARY)
    assert pilot.last("SYS_STATUS").onboard_control_sensors_enabled & geofence
    assert not pilot.last("SYS_STATUS").onboard_control_sensors_health & geofence


@BOTH
def test_lists_survive_a_reboot_and_transfers_do_not(make: type[SimVehicle]) -> None:
    pilot = Uploader(make())
    pilot.upload(SQUARE)
    pilot.send(mav.MAVLink_mission_count_message(1, 1, 5, 0))
    pilot.vehicles[0].faults.reboot = True
    pilot.run(4.0)
    pilot.forget()
    pilot.run(3.0)
    assert not pilot.all("MISSION_REQUEST") and not pilot.all("MISSION_REQUEST_INT")
    assert len(pilot.vehicles[0].lists.mission) == 4


@BOTH
def test_clearing_empties_one_list(make: type[SimVehicle]) -> None:
    pilot = Uploader(make())
    pilot.upload(SQUARE)
    pilot.upload([at(5100, 0, 0, 20)], MissionType.RALLY)
    assert pilot.ack_of(mav.MAVLink_mission_clear_all_message(1, 1, 0)) == mav.MAV_MISSION_ACCEPTED
    lists = pilot.vehicles[0].lists
    assert not lists.mission and len(lists.items[MissionType.RALLY]) == 1
    if make is px4:
        assert pilot.command(mav.MAV_CMD_MISSION_START) == mav.MAV_RESULT_DENIED


def test_a_px4s_hash_changes_with_a_parameter_and_back(pilot: Uploader) -> None:

    def reported() -> bytes:
        (value,) = pilot.send(mav.MAVLink_param_request_read_message(1, 1, b"_HASH_CHECK", -1))
        assert (value.param_type, value.param_index) == (mav.MAV_PARAM_TYPE_UINT32, 65535)
        return bytes(value.get_msgbuf()[10:14])

    before = reported()
    pilot.send(mav.MAVLink_param_set_message(1, 1, b"MPC_XY_CRUISE", 7.5, mav.MAV_PARAM_TYPE_REAL32))
    assert reported() != before
    pilot.send(mav.MAVLink_param_set_message(1, 1, b"MPC_XY_CRUISE", 5.0, mav.MAV_PARAM_TYPE_REAL32))
    assert reported() == before
    pilot.send(mav.MAVLink_param_request_list_message(1, 1))
    pilot.send(mav.MAVLink_param_set_message(1, 1, b"_HASH_CHECK", 0.0, mav.MAV_PARAM_TYPE_UINT32))
    pilot.forget()
    pilot.run(2.0)
    assert not pilot.all("PARAM_VALUE"), "whoever sends the hash back needs no list"


# -- as older programs ask (DroneKit), and integer frames


def float_message(seq: int, item: Item, current: int = 0) -> Any:
    command, frame, p, east, north, z = item
    lat, lon = FIELD.to_geodetic(east, north)
    x, y = (0.0, 0.0) if frame == MISSION else (lat, lon)
    return mav.MAVLink_mission_item_message(1, 1, seq, frame, command, current, 1, *p, x, y, z, 0)


@BOTH
def test_a_float_request_is_answered_with_a_float_item_to_a_metre(make: type[SimVehicle]) -> None:
    """ArduPilot's handle_mission_request; PX4's _int_mode."""
    pilot = Uploader(make())
    assert pilot.upload(SQUARE) == mav.MAV_MISSION_ACCEPTED
    wire = pilot.wire(SQUARE)
    pilot.send(mav.MAVLink_mission_request_list_message(1, 1, 0))
    seq = len(wire) - len(SQUARE)
    for n in range(len(wire)):
        (item,) = pilot.send(mav.MAVLink_mission_request_message(1, 1, n, 0))
        assert item.get_type() == "MISSION_ITEM" and item.seq == n
        if n >= seq:
            sent = message(n, wire[n])
            assert (item.x, item.y) == pytest.approx((sent.x / 1e7, sent.y / 1e7), abs=1e-5)
            assert (item.frame, item.command, item.z) == (REL, sent.command, sent.z)


@BOTH
def test_a_list_of_float_items_is_taken(make: type[SimVehicle]) -> None:
    pilot = Uploader(make())
    wire = pilot.wire(SQUARE)
    answers = pilot.send(mav.MAVLink_mission_count_message(1, 1, len(wire), 0))
    for n in range(len(wire)):
        asked = [a for a in answers if a.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT")]
        assert asked[-1].seq == n and asked[-1].get_type() == "MISSION_REQUEST"
        answers = pilot.send(float_message(n, wire[n]))
    (ack,) = [a for a in answers if a.get_type() == "MISSION_ACK"]
    assert ack.type == mav.MAV_MISSION_ACCEPTED
    kept = pilot.vehicles[0].lists.mission
    assert [item.command for item in kept] == [item[0] for item in SQUARE]
    lat, lon = FIELD.to_geodetic(20, 20)
    assert kept[2].position == pytest.approx((lat, lon), abs=1e-5)


def test_px4_names_the_frames_of_integer_items_as_such(pilot: Uploader) -> None:
    pilot.upload(SQUARE)
    pilot.send(mav.MAVLink_mission_request_list_message(1, 1, 0))
    (item,) = pilot.send(mav.MAVLink_mission_request_int_message(1, 1, 0, 0))
    assert (item.get_type(), item.frame) == ("MISSION_ITEM_INT", mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)


def test_px4_reports_items_that_do_not_move_it_as_reached(pilot: Uploader) -> None:
    """MissionBase::on_active; the last item of a MAVSDK mission is a change of speed."""
    pilot.get_ready()
    pilot.upload([do(178, 1, 4.0), at(22, 0, 0, 10), do(178, 1, 5.0), at(16, 0, 10, 10), do(178, 1, 3.0)])
    pilot.start()
    pilot.run(60)
    assert pilot.reached() == [0, 1, 2, 3, 4]


def test_the_home_of_an_arducopter_without_a_mission_can_be_read() -> None:
    """get_item: "always allow HOME to be read"; DroneKit asks for item 0 of a list of 0."""
    pilot = Uploader(copter())
    pilot.get_ready()
    (count,) = pilot.send(mav.MAVLink_mission_request_list_message(1, 1, 0))
    (item,) = pilot.send(mav.MAVLink_mission_request_message(1, 1, 0, 0))
    assert count.count == 0 and (item.get_type(), item.seq, item.command) == ("MISSION_ITEM", 0, 16)
    assert abs(item.x) > 1, "a place"
    assert pilot.send(mav.MAVLink_mission_request_message(1, 1, 1, 0))[-1].type == mav.MAV_MISSION_ERROR


def test_px4_asks_otherwise_if_its_partner_does_not_know_the_request(pilot: Uploader) -> None:
    """handle_mission_ack: MAVSDK answers the first MISSION_REQUEST with MAV_MISSION_UNSUPPORTED, and again back."""
    assert pilot.send(mav.MAVLink_mission_count_message(1, 1, 1, 0))[-1].get_type() == "MISSION_REQUEST"
    unsupported = mav.MAVLink_mission_ack_message(1, 1, mav.MAV_MISSION_UNSUPPORTED, 0)
    assert [a.get_type() for a in pilot.send(unsupported)] == ["MISSION_REQUEST_INT"]
    assert [a.get_type() for a in pilot.send(unsupported)] == ["MISSION_REQUEST"]
    assert pilot.send(message(0, SQUARE[0]))[-1].type == mav.MAV_MISSION_ACCEPTED


def test_px4_asks_as_its_partner_answers(pilot: Uploader) -> None:
    """_int_mode is off when it boots, and follows the items that come."""
    answers = pilot.send(mav.MAVLink_mission_count_message(1, 1, 4, 0))
    assert answers[-1].get_type() == "MISSION_REQUEST"
    assert pilot.send(message(0, SQUARE[0]))[-1].get_type() == "MISSION_REQUEST_INT"
    assert pilot.send(float_message(1, SQUARE[1]))[-1].get_type() == "MISSION_REQUEST"


@each("as_float", [True, False])
def test_an_arducopter_in_guided_flies_to_an_item_that_is_no_part_of_a_mission(as_float: bool) -> None:
    """`current` = 2, what DroneKit's simple_goto sends."""
    pilot = Uploader(copter())
    pilot.hovering()
    goal = at(16, 15, -5, 12)
    sent = float_message(0, goal, current=2) if as_float else message(0, goal)
    sent.current = 2
    assert pilot.ack_of(sent) == mav.MAV_MISSION_ACCEPTED
    pilot.run(20)
    motion = pilot.vehicles[0].motion
    assert motion.distance_m(15, -5, 12) < 1.0
    assert not pilot.vehicles[0].lists.mission
    assert pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, CopterMode.LOITER) == 0
    assert pilot.ack_of(sent) == mav.MAV_MISSION_ERROR, "in GUIDED only"


@BOTH
@each("bad", [nan, float("inf"), 1e30])
def test_a_float_item_without_a_place_is_refused_and_harms_nothing(make: type[SimVehicle], bad: float) -> None:
    pilot = Uploader(make())
    pilot.send(mav.MAVLink_mission_count_message(1, 1, 2, 0))
    item = mav.MAVLink_mission_item_message(1, 1, 0, REL, 16, 0, 1, 0, 0, 0, 0, bad, bad, 10, 0)
    pilot.send(item)
    item.current = 2
    pilot.send(item)
    assert pilot.run(1.0)
