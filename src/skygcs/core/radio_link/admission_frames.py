"""What others send to vehicles behind a radio, told apart by what it costs there: orders, streams, requests and the
answers that they bring down. Ids and layouts are those of common.xml and ardupilotmega.xml.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import NamedTuple

from skygcs.core.mavlink.dialect import MessageInfo
from skygcs.core.mavlink.header import CRC_BYTES, crc_offset, decode_header, payload_of
from skygcs.core.mavlink.msgids import (
    COMMAND_INT,
    COMMAND_LONG,
    FILE_TRANSFER_PROTOCOL,
    HEARTBEAT,
    MESSAGE_INTERVAL,
    MISSION_SET_CURRENT,
    PARAM_EXT_SET,
    PARAM_SET,
    REQUEST_DATA_STREAM,
    SET_MODE,
)

LOGS = frozenset({117, 119, 121})
"""LOG_REQUEST_LIST, LOG_REQUEST_DATA, LOG_ERASE. LOG_REQUEST_END only ends something."""

COMMANDS = frozenset({COMMAND_INT, COMMAND_LONG})
ORDERS = frozenset({SET_MODE, MISSION_SET_CURRENT})
"""What an operator orders by messages of their own; the rest of his orders are COMMANDS that are no REQUESTS."""

SET_MESSAGE_INTERVAL = 511
REQUESTS = frozenset({410, 510, 512, 519, 520, 521, 522, 525, 526, 527, 528, 2504, 2505})
"""MAV_CMDs that only ask: home, a message and its interval, versions, capabilities, what cameras are like. Ground
stations send a dozen of them to each vehicle as they connect."""

ARM_DISARM = 400
FORCED = 21196.0
"""param2 of a disarm that is obeyed in the air (common.xml, MAV_CMD_COMPONENT_ARM_DISARM)."""
FLIGHT_TERMINATION = 185

NEWEST_ONLY = frozenset(
    {
        33,  # GLOBAL_POSITION_INT of a station that is to be followed
        69,  # MANUAL_CONTROL
        70,  # RC_CHANNELS_OVERRIDE
        82,  # SET_ATTITUDE_TARGET
        84,  # SET_POSITION_TARGET_LOCAL_NED
        86,  # SET_POSITION_TARGET_GLOBAL_INT
        101,  # GLOBAL_VISION_POSITION_ESTIMATE
        102,  # VISION_POSITION_ESTIMATE
        103,  # VISION_SPEED_ESTIMATE
        104,  # VICON_POSITION_ESTIMATE
        132,  # DISTANCE_SENSOR
        138,  # ATT_POS_MOCAP
        139,  # SET_ACTUATOR_CONTROL_TARGET
        144,  # FOLLOW_TARGET
        149,  # LANDING_TARGET
        232,  # GPS_INPUT
        282,  # GIMBAL_MANAGER_SET_ATTITUDE
        287,  # GIMBAL_MANAGER_SET_PITCHYAW
        288,  # GIMBAL_MANAGER_SET_MANUAL_CONTROL
        330,  # OBSTACLE_DISTANCE
        331,  # ODOMETRY
    }
)
"""Streams, of which an older frame is worthless once a newer one is there."""


class RateClass(NamedTuple):
    """How often one source may send the messages of one group. ``waits``: what comes sooner waits for its turn, since
    it is part of a dialogue; else it is left out, since another will come."""

    group: str
    hz: float
    burst: float
    waits: bool


PARAMETERS = RateClass("parameters", 4.0, 8.0, True)
"""Each brings a PARAM_VALUE of 37 B down."""
MISSIONS = RateClass("missions", 4.0, 8.0, True)
"""Each brings an item of 50 B down or takes one up. Transfers stop and wait: no more than one frame per vehicle and
round trip. So they are slowed, never made to wait for each other as lists are: a station gives a transfer up after
some five repeats of 1.5 s, and repeats of what still waits cost nothing."""
FILES = RateClass("files", 1.0, 2.0, True)
"""Each brings 251 B down: half of a vehicle's timeslot among eleven nodes at 64 kbit/s carries 276 B/s."""
REQUEST = RateClass("requests", 4.0, 12.0, True)
"""A burst is what a station asks of one vehicle as it connects."""

BUILT_IN: dict[int, RateClass] = {
    HEARTBEAT: RateClass("HEARTBEAT", 0.5, 1.5, False),  # two in the 5 s after which ArduPilot misses them
    2: RateClass("SYSTEM_TIME", 0.1, 1.0, False),  # MAVROS sends 1 Hz, and vehicles with GPS do not take it
    4: RateClass("PING", 0.5, 2.0, False),
    111: RateClass("TIMESYNC", 0.2, 1.0, False),  # MAVROS sends 10 Hz: of ten vehicles' nodes 2.8 kB/s
    20: PARAMETERS,  # PARAM_REQUEST_READ
    PARAM_SET: PARAMETERS,
    320: PARAMETERS,  # PARAM_EXT_REQUEST_READ
    PARAM_EXT_SET: PARAMETERS,
    321: RateClass("PARAM_EXT_REQUEST_LIST", 0.05, 1.0, False),
    FILE_TRANSFER_PROTOCOL: FILES,
    **dict.fromkeys((37, 38, 39, 40, 43, 44, 45, 47, 51, 73), MISSIONS),
    **dict.fromkeys((160, 161, 175, 176), MISSIONS),  # fence and rally points of old
    REQUEST_DATA_STREAM: RateClass("REQUEST_DATA_STREAM", 0.5, 4.0, False),  # where they are let through at all
    **dict.fromkeys(LOGS, RateClass("logs", 1.0, 1.0, True)),  # the same
}
"""By message id, for each source."""

_CONFIRMATION_AT = 32
"""Last byte of a COMMAND_LONG's payload."""
_PARAM12 = struct.Struct("<ff")


class ThirdPartyFrame(NamedTuple):
    """A frame of somebody else, as far as it matters here. ``payload`` without trailing zeros."""

    raw: bytes
    msgid: int
    source: int
    """sysid << 8 | compid"""
    target: int
    component: int
    payload: bytes

    @property
    def identity(self) -> tuple[int, int, bytes]:
        """What a repeat has in common with it. Sequence numbers and a COMMAND_LONG's count of repeats differ."""
        payload = self.payload
        if self.msgid == COMMAND_LONG:
            payload = payload[:_CONFIRMATION_AT].rstrip(b"\0")
        return self.source, self.msgid, payload


def parse(raw: bytes, messages: Mapping[int, MessageInfo]) -> ThirdPartyFrame | None:
    """None for what is no whole frame. An id that the dialect does not have is for everybody."""
    header = decode_header(raw)
    if header is None or len(raw) < crc_offset(raw) + CRC_BYTES:
        return None
    _, _, _, _, sysid, compid, msgid, _ = header
    source = sysid << 8 | compid
    payload = payload_of(raw)
    info = messages.get(msgid)
    target = component = 0
    if info is not None:
        target = _byte(payload, info.target_system_offset)
        component = _byte(payload, info.target_component_offset)
    return ThirdPartyFrame(raw, msgid, source, target, component, payload.rstrip(b"\0"))


def command_of(frame: ThirdPartyFrame) -> int:
    """The MAV_CMD of a COMMAND_LONG or COMMAND_INT: both have it at the same place."""
    return _byte(frame.payload, 28) | _byte(frame.payload, 29) << 8


def is_emergency(frame: ThirdPartyFrame) -> bool:
    """Whether it stops motors in the air."""
    if frame.msgid not in COMMANDS:
        return False
    command = command_of(frame)
    if command == FLIGHT_TERMINATION:
        return True
    param1, param2 = _PARAM12.unpack_from(frame.payload.ljust(8, b"\0"))
    return command == ARM_DISARM and param1 == 0.0 and param2 == FORCED


def asks_for_streams(frame: ThirdPartyFrame) -> bool:
    """Whether it sets what a vehicle streams."""
    if frame.msgid in COMMANDS:
        return command_of(frame) == SET_MESSAGE_INTERVAL
    return frame.msgid == REQUEST_DATA_STREAM or frame.msgid == MESSAGE_INTERVAL


def is_order(frame: ThirdPartyFrame) -> bool:
    """Whether somebody waits for a vehicle to do something."""
    if frame.msgid in COMMANDS:
        command = command_of(frame)
        return command not in REQUESTS and command != SET_MESSAGE_INTERVAL
    return frame.msgid in ORDERS


def is_change(frame: ThirdPartyFrame) -> bool:
    """Whether what it leaves behind depends on what came after it: an order, a parameter that is set."""
    return is_order(frame) or frame.msgid in (PARAM_SET, PARAM_EXT_SET)


def rate_class_of(frame: ThirdPartyFrame, rates_hz: Mapping[int, float]) -> RateClass | None:
    """How often its source may send such frames; None: as often as there is room. ``rates_hz``, by message id, are
    laid over the built-in ones."""
    built_in = BUILT_IN.get(frame.msgid)
    if built_in is None and frame.msgid in COMMANDS and command_of(frame) in REQUESTS:
        built_in = REQUEST
    hz = rates_hz.get(frame.msgid)
    if hz is None or (built_in is REQUEST and frame.msgid not in BUILT_IN):
        return built_in
    if built_in is None:
        return RateClass(str(frame.msgid), hz, 1.5, False)
    return RateClass(str(frame.msgid), hz, max(1.0, built_in.burst * hz / built_in.hz), built_in.waits)


def _byte(payload: bytes, at: int) -> int:
    return payload[at] if 0 <= at < len(payload) else 0
