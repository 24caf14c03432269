"""The model of one vehicle at one moment: all that decides which orders and frames it may get. Pure.

    part            evidence
    -------------   ----------------------------------------------------------------------------------------------
    family, kind    heartbeat, boot banner, Q_ENABLE, vtol_state (`mavlink.vehicle_class`)
    not disarmed    armed by its heartbeat; telemetry that contradicts a disarmed one; a second vehicle with its ids;
                    or nothing, as it is lost
    flying          EXTENDED_SYS_STATE, ArduPilot's system status
    sticks          SYS_STATUS (its receiver present and healthy), RC_CHANNELS (the throttle), and the fleet file's
                    ``transmitter = false``
    answers         the last final COMMAND_ACK to each command

It is made anew from the vehicle's state whenever it is asked for, so that nothing is kept twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from skygcs.core.mavlink.modes import Family
from skygcs.core.mavlink.vehicle_class import Program, VehicleClass, abilities_of
from skygcs.core.vehicle.flight_evidence import contradiction
from skygcs.core.vehicle.vehicle import Vehicle

STICKS_FRESH_S = 15.0
"""Oldest SYS_STATUS and RC_CHANNELS that say something of the sticks: three periods of the slowest stream (0.2 Hz)."""

THROTTLE_CHANNEL = 2
"""Index of the throttle among RC_CHANNELS: RCMAP_THROTTLE and RC_MAP_THROTTLE are 3 unless somebody changed them."""

THROTTLE_LOW_US = 1200
"""A throttle below it is at the bottom: receivers send 988 to 1100 us there, and half of the way is 1500 us."""

RECEIVER = "rc_receiver"
"""MAV_SYS_STATUS_SENSOR_RC_RECEIVER, as `decoding.decode_sensors` names it. ArduPilot has it present once it has seen
an input, and healthy outside of its radio failsafe (GCS::update_sensor_status_flags); PX4 while manual control is
there, also from a joystick (rcAndDataLinkCheck.cpp)."""


class Sticks(StrEnum):
    """State of a pilot's sticks: whether they reach the autopilot."""

    READY = "seen, throttle up"
    SEEN = "seen, throttle not known"
    """Its receiver is healthy, and no RC_CHANNELS has come: SITL's simulated transmitter lies there with its throttle
    down."""
    LOW = "seen, throttle down"
    ABSENT = "absent"
    UNKNOWN = "not known"


@dataclass(frozen=True, slots=True)
class VehicleModel:
    """Facts about one vehicle now by which its orders are gated; see the table of the module."""

    name: str
    family: Family
    version: str | None
    program: Program | None
    kind: VehicleClass
    mode: str
    custom_mode: int
    hovers: bool
    """It is a VTOL that is carried by its rotors."""
    not_disarmed: str | None
    """Why it is not known to be disarmed; None if it is."""
    flying: bool | None
    """None: not known."""
    sticks: Sticks
    answers: Mapping[int, int]
    """The last MAV_RESULT to a command since it started."""

    @property
    def may_fly(self) -> bool:
        """True if it may be under way (`Vehicle.under_way`), and also while a heartbeat that shows it disarmed is
        doubted."""
        return self.not_disarmed is not None and abilities_of(self.family, self.kind).may_move(self.flying)


def model_of(vehicle: Vehicle, now: float) -> VehicleModel:
    """The model of a vehicle now."""
    return VehicleModel(
        name=vehicle.name,
        family=vehicle.family,
        version=vehicle.firmware,
        program=vehicle.program,
        kind=vehicle.kind,
        mode=vehicle.mode,
        custom_mode=vehicle.custom_mode,
        hovers=vehicle.hovers(now),
        not_disarmed=why_not_disarmed(vehicle, now),
        flying=vehicle.in_air(now),
        sticks=sticks_of(vehicle, now),
        answers={command: result for command, (result, _) in vehicle.answers.items()},
    )


def why_not_disarmed(vehicle: Vehicle, now: float) -> str | None:
    """Why the vehicle is not known to be disarmed; None if it is."""
    if vehicle.duplicate:
        return f"shares system id {vehicle.sysid} with another"
    if vehicle.armed:
        return "is armed"
    if contradiction(vehicle, now) is not None or vehicle.in_air(now):
        return "is in the air"
    return None if vehicle.connected else "is lost"


def sticks_of(vehicle: Vehicle, now: float) -> Sticks:
    """Judge whether its pilot's sticks are seen in the telemetry. A fleet file without a transmitter rules them out;
    one with a transmitter does not make them seen."""
    if vehicle.transmitter is False:
        return Sticks.ABSENT
    sensors, rc = _fresh(vehicle, "sensors", now), _fresh(vehicle, "rc", now)
    throttle_us = None
    if rc is not None and len(rc["channels"]) > THROTTLE_CHANNEL:
        throttle_us = rc["channels"][THROTTLE_CHANNEL]
    if sensors is not None:
        if RECEIVER not in sensors["present"] or RECEIVER not in sensors["health"]:
            return Sticks.ABSENT
    elif throttle_us is None:
        return Sticks.UNKNOWN
    if throttle_us is None:
        return Sticks.SEEN
    return Sticks.LOW if throttle_us < THROTTLE_LOW_US else Sticks.READY


SEEN_AT_ALL = frozenset({Sticks.READY, Sticks.SEEN})
"""A pilot has the sticks, as far as the telemetry shows."""


def _fresh(vehicle: Vehicle, name: str, now: float) -> Mapping[str, Any] | None:
    values, at = vehicle.timed_telemetry(name)
    return None if values is None or at is None or now - at > STICKS_FRESH_S else values
