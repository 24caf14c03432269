"""Whose hands a vehicle is in: a pilot's, by a mode of his, or its own."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.vehicle.stick_modes import hands, taken_since
from skygcs.core.vehicle.vehicle import Vehicle
from support.table import each
from support.vehicles import ARDUPILOT, PX4, Voice, flight_dialect

NOW = 100.0
ROVER, QUADROTOR = 10, 2
STABILIZE, GUIDED, LOITER, MANUAL = 0, 4, 5, 0
POSCTL, OFFBOARD = 3 << 16, 6 << 16
ACTIVE, CRITICAL = mav.MAV_STATE_ACTIVE, mav.MAV_STATE_CRITICAL


def shown(vehicle: Vehicle, autopilot: int, kind: int, mode: int, armed: bool, status: int = ACTIVE) -> None:
    beat = mav.MAVLink_heartbeat_message(kind, autopilot, 0x81 if armed else 0x01, mode, status, 3)
    vehicle.on_frame(Voice(1).say(beat), NOW)


@each(
    ("firmware", "kind", "before", "after", "status", "taken"),
    [
        (ARDUPILOT, QUADROTOR, (GUIDED, True), (LOITER, True), ACTIVE, "switched to LOITER"),
        (ARDUPILOT, QUADROTOR, (STABILIZE, True), (LOITER, True), ACTIVE, "switched to LOITER"),
        (ARDUPILOT, QUADROTOR, (GUIDED, False), (LOITER, False), ACTIVE, "switched to LOITER"),
        (ARDUPILOT, QUADROTOR, (STABILIZE, False), (STABILIZE, True), ACTIVE, "armed in STABILIZE"),
        (ARDUPILOT, QUADROTOR, (STABILIZE, False), (STABILIZE, False), ACTIVE, None),
        (ARDUPILOT, QUADROTOR, (STABILIZE, True), (STABILIZE, False), ACTIVE, None),
        (ARDUPILOT, QUADROTOR, (STABILIZE, False), (GUIDED, True), ACTIVE, None),
        (ARDUPILOT, ROVER, (MANUAL, True), (MANUAL, True), ACTIVE, None),
        (PX4, QUADROTOR, (OFFBOARD, True), (POSCTL, True), ACTIVE, "switched to POSCTL"),
        (PX4, QUADROTOR, (OFFBOARD, True), (POSCTL, True), CRITICAL, None),
    ],
)
def test_what_its_pilot_has_taken(
    firmware: int, kind: int, before: tuple[int, bool], after: tuple[int, bool], status: int, taken: str | None
) -> None:
    vehicle = Vehicle(1, 1, flight_dialect())
    shown(vehicle, firmware, kind, *before)
    were_in = hands(vehicle, NOW)
    shown(vehicle, firmware, kind, *after, status)
    why = taken_since(vehicle, NOW, were_in)
    assert why == (None if taken is None else f"it was {taken} since, which its pilot flies")


@each(("healthy", "taken"), [(True, True), (False, False)])
def test_in_a_failsafe_it_is_his_where_his_sticks_are_seen(healthy: bool, taken: bool) -> None:
    """A low battery's failsafe brought it home, and he took it to land it himself."""
    vehicle, receiver = Vehicle(1, 1, flight_dialect()), mav.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    shown(vehicle, ARDUPILOT, QUADROTOR, GUIDED, True)
    were_in = hands(vehicle, NOW)
    health = receiver if healthy else 0
    beat = mav.MAVLink_sys_status_message(receiver, receiver, health, 0, 12000, 0, 50, 0, 0, 0, 0, 0, 0)
    vehicle.on_frame(Voice(1).say(beat), NOW)
    shown(vehicle, ARDUPILOT, QUADROTOR, LOITER, True, CRITICAL)
    assert (taken_since(vehicle, NOW, were_in) is not None) == taken
