"""Third-party frames by what they cost on a radio: orders, streams, requests and the answers that these bring down.

Ids and layouts are those of common.xml and ardupilotmega.xml.
"""

from __future__ import annotations

import struct
from enum import Enum, auto
from typing import NamedTuple, Self

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import (
    COMMAND_INT,
    COMMAND_LONG,
    FILE_TRANSFER_PROTOCOL,
    GPS_RTCM_DATA,
    HEARTBEAT,
    MESSAGE_INTERVAL,
    MISSION_SET_CURRENT,
    PARAM_EXT_REQUEST_LIST,
    PARAM_EXT_REQUEST_READ,
    PARAM_EXT_SET,
    PARAM_REQUEST_LIST,
    PARAM_REQUEST_READ,
    PARAM_SET,
    PING,
    REQUEST_DATA_STREAM,
    SET_MODE,
    SYSTEM_TIME,
    TIMESYNC,
)

LOGS = frozenset({117, 119, 121})
"""LOG_REQUEST_LIST, LOG_REQUEST_DATA, LOG_ERASE. LOG_REQUEST_END only ends something."""

COMMANDS = frozenset({COMMAND_INT, COMMAND_LONG})
ORDERS = frozenset({SET_MODE, MISSION_SET_CURRENT})
"""Orders with messages of their own; all others are COMMANDS that are no REQUESTS."""

REQUESTS = mav_cmd.QUESTIONS | {mav_cmd.GET_MESSAGE_INTERVAL}
"""MAV_CMDs that only ask."""

FORCED = 21196.0
"""param2 of a disarm that is obeyed in the air (common.xml, MAV_CMD_COMPONENT_ARM_DISARM)."""

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
        HEARTBEAT,
    }
)
"""Streams: an older frame is worthless once a newer one has come."""

MAX_HZ = {
    HEARTBEAT: 0.5,  # two in the 5 s after which ArduPilot's ground station failsafe acts
    SYSTEM_TIME: 0.1,  # MAVROS sends 1 Hz, and vehicles with GPS ignore it
    PING: 0.5,
    TIMESYNC: 0.2,  # MAVROS sends 10 Hz: 2.8 kB/s from ten vehicles' nodes
    PARAM_EXT_REQUEST_LIST: 0.05,
}
"""Rates of each source, by message id; what is sent more often is left out, since another will come."""

REQUEST_ANSWER_BYTES = 50
ANSWER_BYTES = {
    **dict.fromkeys((PARAM_REQUEST_READ, PARAM_SET), 37),  # PARAM_VALUE
    **dict.fromkeys((PARAM_EXT_REQUEST_READ, PARAM_EXT_SET), 161),  # PARAM_EXT_VALUE
    **dict.fromkeys((37, 38, 39, 40, 43, 44, 45, 47, 51, 73), 50),  # missions: an item or the request for one
    **dict.fromkeys((160, 161, 175, 176), 50),  # fence and rally points of old
    **dict.fromkeys(LOGS, 109),  # LOG_DATA
    FILE_TRANSFER_PROTOCOL: 263,
}
"""Bytes that a frame brings down, by message id. They are charged to the third-party share as well: what a request
costs on a radio is its answer. A MAV_CMD that only asks brings REQUEST_ANSWER_BYTES on average."""

_CONFIRMATION_AT = 32
"""Last byte of a COMMAND_LONG's payload."""
_COMMAND_AT = 28
"""The MAV_CMD in the payload of a COMMAND_LONG and of a COMMAND_INT."""
_OPCODE_AT = 6
"""In the payload of a FILE_TRANSFER_PROTOCOL: target network, system, component, then the FTP header's seq_number (2),
session and opcode."""
_TERMINATE_SESSION, _RESET_SESSIONS = 1, 2
_PARAM12 = struct.Struct("<ff")


class Kind(Enum):
    """Kind of a third-party frame to a radio."""

    EMERGENCY = auto()
    """It stops motors in the air."""
    ORDER = auto()
    """Somebody waits for a vehicle to do something."""
    STREAM_RATE = auto()
    """It sets what a vehicle streams."""
    LOG = auto()
    PARAMETER_LIST = auto()
    FILE = auto()
    FILE_END = auto()
    """It ends a file transfer."""
    CORRECTION = auto()
    STREAM = auto()
    """The newest is enough."""
    OTHER = auto()


_KINDS = {
    **dict.fromkeys(ORDERS, Kind.ORDER),
    **dict.fromkeys(NEWEST_ONLY, Kind.STREAM),
    **dict.fromkeys(LOGS, Kind.LOG),
    PARAM_REQUEST_LIST: Kind.PARAMETER_LIST,
    GPS_RTCM_DATA: Kind.CORRECTION,
    REQUEST_DATA_STREAM: Kind.STREAM_RATE,
    MESSAGE_INTERVAL: Kind.STREAM_RATE,
}
"""The kind of messages that have only one."""


class ThirdPartyFrame(NamedTuple):
    """Parts of another program's frame that admission looks at. ``payload`` has no trailing zeros."""

    frame: Frame
    kind: Kind
    source: int
    """sysid << 8 | compid"""
    target: int
    component: int
    payload: bytes

    @classmethod
    def of(cls, frame: Frame) -> Self:
        payload = frame.payload.rstrip(b"\0")
        return cls(frame, _kind(frame.msgid, payload), frame.sysid << 8 | frame.compid, *frame.target(), payload)

    @property
    def msgid(self) -> int:
        return self.frame.msgid

    @property
    def size(self) -> int:
        return len(self.frame.raw)

    @property
    def command(self) -> int:
        """The MAV_CMD of a COMMAND_LONG or COMMAND_INT."""
        return _command(self.payload)

    @property
    def answer_bytes(self) -> int:
        """Bytes that it brings down, about."""
        if self.msgid in COMMANDS and self.command in REQUESTS:
            return REQUEST_ANSWER_BYTES
        return ANSWER_BYTES.get(self.msgid, 0)

    @property
    def identity(self) -> tuple[int, int, bytes]:
        """Return what a repeat has in common with it. Sequence numbers and a COMMAND_LONG's count of repeats differ."""
        payload = self.payload
        if self.msgid == COMMAND_LONG:
            payload = payload[:_CONFIRMATION_AT].rstrip(b"\0")
        return self.source, self.msgid, payload

    @property
    def is_change(self) -> bool:
        """True if its effect depends on what follows it: an order, a parameter that is set."""
        return self.kind is Kind.ORDER or self.msgid in (PARAM_SET, PARAM_EXT_SET)


def _kind(msgid: int, payload: bytes) -> Kind:
    if msgid in COMMANDS:
        return _command_kind(payload)
    if msgid == FILE_TRANSFER_PROTOCOL:
        opcode = payload[_OPCODE_AT] if len(payload) > _OPCODE_AT else 0
        return Kind.FILE_END if opcode in (_TERMINATE_SESSION, _RESET_SESSIONS) else Kind.FILE
    return _KINDS.get(msgid, Kind.OTHER)


def _command_kind(payload: bytes) -> Kind:
    command = _command(payload)
    if command == mav_cmd.DO_FLIGHTTERMINATION:
        return Kind.EMERGENCY
    param1, param2 = _PARAM12.unpack_from(payload.ljust(_PARAM12.size, b"\0"))
    if command == mav_cmd.COMPONENT_ARM_DISARM and param1 == 0.0 and param2 == FORCED:
        return Kind.EMERGENCY
    if command == mav_cmd.SET_MESSAGE_INTERVAL:
        return Kind.STREAM_RATE
    return Kind.OTHER if command in REQUESTS else Kind.ORDER


def _command(payload: bytes) -> int:
    return int.from_bytes(payload[_COMMAND_AT : _COMMAND_AT + 2], "little")
