"""Identifies an autopilot's HEARTBEATs: one rule for the daemon, its router, replays and the log tools.

    heartbeat                                                belongs to
    -----------------------------------------------------    ---------------------------------------------------------
    autopilot INVALID; type GCS, companion, gimbal, ...      another component ("other"): never a vehicle
    autopilot GENERIC and type GENERIC, or type GENERIC      the same; a PX4Flow (81/50) says autopilot PX4, type
    and not of component 1                                   GENERIC; a PX4 without an airframe does so as component 1
    any other heartbeat of unknown ids                       a new vehicle
    known ids, same autopilot and type                       that vehicle ("own")
    known ids, another autopilot or type                     another vehicle ("contradicts"), until the known one has
                                                             been silent for so long that it counts as lost
    known ids, mode or arming state that alternates          two senders: the first one stays the vehicle, the
                                                             other one contradicts

Seen: 2/2 flooding heartbeats with autopilot INVALID, 1/0 as ADS-B and as a second quadrotor with autopilot INVALID, a
GCS 255/190 that calls its autopilot ArduPilot, a companion computer with the ids of its vehicle.
"""

from __future__ import annotations

from typing import Literal

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.frame import HEADER_BYTES, Frame
from skygcs.core.mavlink.modes import SAFETY_ARMED
from skygcs.core.mavlink.msgids import COMMAND_ACK, HEARTBEAT, SET_MODE

AUTOPILOT_GENERIC = 0
AUTOPILOT_INVALID = 8

TYPE_GENERIC = 0

COMPID_AUTOPILOT = 1

NOT_VEHICLES = frozenset({6, 18, 26, 27, 30, 31, 32, 33, 34, 36, 38, 39, 40, 41, 42, 44, 48})
"""MAV_TYPE: GCS, onboard controller, gimbal, ADS-B, camera, charging station, FLARM, servo, Open Drone ID, battery,
log, OSD, IMU, GPS, winch, illuminator, gripper. Parachute (37) and undefined values count as airframes."""

DEFAULT_LOST_S = 5.0
"""Without a heartbeat of its own for this time the vehicle is lost, and the next one identifies it again.
The default of ``vehicle_timeout_s`` in the fleet file. Heartbeats come at 1 Hz; on a multipoint radio several in a row
may be lost (Skybrush uses 5 s, too)."""

HIGH_LATENCY_FACTOR = 4
"""HIGH_LATENCY2 replaces the heartbeat and comes every 5 s: such a vehicle is lost after 20 s."""

TYPE_CHANGE_S = 4.0
"""How long the known type must be silent before another type of the same autopilot is accepted (PX4 changes MAV_TYPE
without a restart)."""

ALTERNATION_S = 6.0
RETURNS = 3
RETURNS_SPREAD_S = 1.9
"""A mode or arming state that was left and comes back within 6 s has returned. One or two returns are normal, and so is
a quick series: a switch moved too far, late heartbeats. Three returns with 1.9 s between the first and the last mean
two senders: at 1 Hz each they are found after 3 s."""

EXPECTED_S = 3.0
EXPECTED_BEFORE_S = 1.0
"""A vehicle that has acknowledged a change of mode or arming shows it in a heartbeat up to 3 s later, or up to 1 s
before (both firmwares send a heartbeat with the change, ArduCopter 4.6 before the acknowledgement). Such returns are
not evidence of two senders: ArduCopter went GUIDED, RTL, GUIDED, BRAKE, GUIDED within 2 s by five orders."""

STATE_COMMANDS = frozenset(
    {
        SET_MODE,
        mav_cmd.NAV_RETURN_TO_LAUNCH,
        mav_cmd.NAV_LAND,
        mav_cmd.NAV_TAKEOFF,
        mav_cmd.NAV_TAKEOFF_LOCAL,
        mav_cmd.DO_SET_MODE,
        mav_cmd.DO_REPOSITION,
        mav_cmd.OVERRIDE_GOTO,
        mav_cmd.MISSION_START,
        mav_cmd.COMPONENT_ARM_DISARM,
    }
)
"""Commands whose acceptance changes mode or arming. ArduPilot acknowledges the message SET_MODE by its id."""

MAV_RESULT_ACCEPTED = 0

ALTERNATION_OVER_S = 4.0
"""When only one of the two states was shown for this time, four heartbeats, there is one sender again."""

SETTLED_S = 2.5
"""A state shown for this time without a break was the vehicle's: of two that alternate, the one with the same arming
state is taken for the vehicle's."""

CHANGED_S = 1.5
"""While two senders alternate: if the vehicle's state was not shown for this time (one heartbeat may be lost) and a
state comes that neither sender had, the vehicle has changed its state."""

MAX_STATES = 8
"""States remembered, the present one among them. A sender that shows more states within ALTERNATION_S is recognised by
these alone."""

MAX_SOURCES = 1024
"""Sources whose heartbeats are distinguished in one log; four times as many as there can be vehicles."""

HeartbeatOrigin = Literal["own", "other", "contradicts"]


def is_vehicle(vehicle_type: int, autopilot: int, compid: int = COMPID_AUTOPILOT) -> bool:
    """True if the sender of a HEARTBEAT with these fields is a vehicle."""
    if autopilot == AUTOPILOT_INVALID or vehicle_type in NOT_VEHICLES:
        return False
    return vehicle_type != TYPE_GENERIC or (autopilot != AUTOPILOT_GENERIC and compid == COMPID_AUTOPILOT)


def discovers(frame: Frame) -> bool:
    """True for a verified HEARTBEAT of an autopilot: its sender is a vehicle. Never raises."""
    if frame.msgid != HEARTBEAT or frame.info is None or frame.sysid == 0:
        return False
    _, vehicle_type, autopilot, _ = heartbeat_fields(frame)
    return is_vehicle(vehicle_type, autopilot, frame.compid)


def heartbeat_fields(frame: Frame) -> tuple[int, int, int, int]:
    """(custom_mode, type, autopilot, base_mode); trimmed bytes are 0."""
    shown = shown_by(frame)
    return int.from_bytes(shown[:4], "little"), shown[4], shown[5], shown[6]


def shown_by(heartbeat: Frame) -> bytes:
    """Custom mode, type, autopilot and base mode: the first seven bytes of the payload."""
    raw = heartbeat.raw
    at = HEADER_BYTES[raw[0]]
    shown = raw[at : at + min(raw[1], 7)]
    return shown if len(shown) == 7 else shown.ljust(7, b"\0")


class HeartbeatCheck:
    """Separates a vehicle's own heartbeats from those that others send with its ids. It needs all of them, in order.

    ``contradicted_at``: time of the last heartbeat of another vehicle; ``other_at``: of another component.
    """

    __slots__ = (
        "_alternating",
        "_compid",
        "_expected_until",
        "_kept",
        "_kept_at",
        "_left",
        "_lost_s",
        "_own_at",
        "_settled_armed",
        "_since",
        "contradicted_at",
        "identity",
        "other_at",
    )

    def __init__(self, compid: int = COMPID_AUTOPILOT, lost_s: float = DEFAULT_LOST_S) -> None:
        self.identity: tuple[int, int] | None = None
        """(type, autopilot) as known; None until the next heartbeat of an autopilot."""
        self.contradicted_at = self.other_at = float("-inf")
        self._compid = compid
        self._lost_s = lost_s
        self._own_at = float("-inf")
        self._kept = (False, 0)
        self._since = float("-inf")
        """When the vehicle's present state was first shown."""
        self._settled_armed = False
        """True if it was armed when it had shown one state for SETTLED_S."""
        self._kept_at = float("-inf")
        self._left: dict[tuple[bool, int], tuple[float, list[float]]] = {}
        """By state: when it was left, and when it came back."""
        self._alternating = False
        self._expected_until = float("-inf")

    @property
    def alternating(self) -> bool:
        """True while two senders show different states."""
        return self._alternating

    def forget(self) -> None:
        """The vehicle is lost or has restarted: the next heartbeat with its ids is its own."""
        self.identity = None
        self._left.clear()
        self._alternating = False

    def heard(self, now: float) -> None:
        """Another message that identifies the vehicle came (HIGH_LATENCY2)."""
        self._own_at = now

    def expect_change(self, command: int, result: int, now: float) -> None:
        """Note a COMMAND_ACK of the vehicle: a change of state that it accepted is its own."""
        if result != MAV_RESULT_ACCEPTED or command not in STATE_COMMANDS:
            return
        self._expected_until = now + EXPECTED_S
        for _, returns in self._left.values():
            while returns and now - returns[-1] <= EXPECTED_BEFORE_S:
                returns.pop()

    def judge(self, vehicle_type: int, autopilot: int, base_mode: int, custom_mode: int, now: float) -> HeartbeatOrigin:
        """Classify a heartbeat with the vehicle's ids."""
        if not is_vehicle(vehicle_type, autopilot, self._compid):
            self.other_at = now
            return "other"
        state = bool(base_mode & SAFETY_ARMED), custom_mode
        if self.identity is None or now - self._own_at > self._lost_s:
            self.forget()
            self.identity, self._own_at = (vehicle_type, autopilot), now
            self._kept, self._kept_at, self._since = state, now, now
            self._settled_armed = state[0]
            return "own"
        if self.identity != (vehicle_type, autopilot) and not self._becomes(vehicle_type, autopilot, now):
            self.contradicted_at = now
            return "contradicts"
        if not self._shows(state, now):
            self.contradicted_at = now
            return "contradicts"
        self._own_at = now
        return "own"

    def _becomes(self, vehicle_type: int, autopilot: int, now: float) -> bool:
        """True if the known autopilot may have changed its type."""
        assert self.identity is not None
        known_type, known_autopilot = self.identity
        if autopilot != known_autopilot or vehicle_type == TYPE_GENERIC:
            return False
        if known_type != TYPE_GENERIC and now - self._own_at <= TYPE_CHANGE_S:
            return False
        self.identity = vehicle_type, autopilot
        return True

    def _shows(self, state: tuple[bool, int], now: float) -> bool:
        """True if this mode and arming state is the vehicle's own."""
        if self._alternating:
            return self._alternates(state, now)
        if state == self._kept:
            self._kept_at = now
            return True
        # Note the return, the states of now last: the one that was left longest ago goes first
        left_at, returns = self._left.pop(state, (float("-inf"), []))
        returns = [at for at in returns if now - at <= ALTERNATION_S]
        if now - left_at <= ALTERNATION_S and now > self._expected_until:
            returns.append(now)
        self._left[self._kept] = now, self._left.pop(self._kept, (now, []))[1]
        self._left[state] = left_at, returns
        while len(self._left) > MAX_STATES:
            del self._left[next(iter(self._left))]

        # Two senders?
        if now - self._since >= SETTLED_S:
            self._settled_armed = self._kept[0]
        before = self._kept
        self._kept, self._kept_at, self._since = state, now, now
        if len(returns) < RETURNS or returns[-1] - returns[0] < RETURNS_SPREAD_S:
            return True
        self._alternating = True
        self.contradicted_at = now
        # The first sender's state is the first to return so often, but its mode may have changed meanwhile.
        if state[0] != self._settled_armed == before[0]:
            self._kept = before
        del self._left[self._kept]
        return self._kept == state

    def _alternates(self, state: tuple[bool, int], now: float) -> bool:
        """`_shows` while there are two senders."""
        if state == self._kept:
            self._kept_at = now
            if now - self.contradicted_at > ALTERNATION_OVER_S:
                self._end()
            return True
        silent_s = now - self._kept_at
        if silent_s <= CHANGED_S or (state in self._left and silent_s <= ALTERNATION_OVER_S):
            return False
        if state in self._left:
            self._end()  # only the other sender is left
        self._kept, self._kept_at = state, now
        return True

    def _end(self) -> None:
        self._alternating = False
        self._left.clear()


class HeartbeatChecks:
    """A `HeartbeatCheck` for each source of a log."""

    def __init__(self) -> None:
        self._checks: dict[tuple[int, int], HeartbeatCheck] = {}

    def judge(self, frame: Frame, now: float) -> HeartbeatOrigin | None:
        """Classify a frame's heartbeat; None for other frames and for sources that are not known as vehicles.

        Every frame of the log must be given: an acknowledged command explains a change of state.
        """
        if frame.info is None or frame.msgid not in (HEARTBEAT, COMMAND_ACK):
            return None
        key = frame.sysid, frame.compid
        check = self._checks.get(key)
        if frame.msgid == COMMAND_ACK:
            if check is not None:
                fields = frame.fields()
                check.expect_change(fields["command"], fields["result"], now)
            return None
        if check is None:
            if not discovers(frame) or len(self._checks) >= MAX_SOURCES:
                return None
            check = self._checks[key] = HeartbeatCheck(frame.compid)
        custom_mode, vehicle_type, autopilot, base_mode = heartbeat_fields(frame)
        return check.judge(vehicle_type, autopilot, base_mode, custom_mode, now)

    def own(self, frame: Frame, now: float) -> bool:
        """True if this is a vehicle's own heartbeat."""
        return self.judge(frame, now) == "own"
