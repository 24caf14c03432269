"""One MAVLink command to one vehicle: sent, repeated, answered, in one outcome; and which may be repeated. Pure.

Rule: everything that decides how a command goes on is in this file.

    state        what came                                    next         effects
    ----------   ------------------------------------------   ----------   ------------------------------------------
    IDLE         start                                        WAITING      Transmit(0)
    WAITING      timer, repeats left                          WAITING      Transmit(n + 1)
    WAITING      postpone: a repeat might do it twice         WAITING      - (the same timer again a little later)
    WAITING      timer, none left                             DONE         Finish: timeout
    WAITING      ack in progress                              WORKING      Report
    WAITING      ack accepted                                 DONE         Finish: accepted
    WAITING      ack refusing (any other)                     SETTLING     - (the text that says why may follow)
    WORKING      ack in progress                              WORKING      Report
    WORKING      ack accepted / refusing                      DONE / SETTLING
    WORKING      timer: silent or too long                    DONE         Finish: timeout or in_progress
    SETTLING     timer                                        DONE         Finish: that refusal
    not DONE     stop (cancelled, vehicle lost, ...)          DONE         Finish: as given
    any          an ack of another command or for another     unchanged    -
    DONE         anything                                     DONE         -

`COMMANDS` has what may be repeated, over which link, and why. An order goes over the chosen link. When its answer does
not come, either the order or the answer was lost, and the sender cannot know which. A repeat is harmless where doing it
twice leaves what doing it once leaves. Elsewhere it is sent only once the vehicle's state, newer than the last
transmission, shows that it was not done, or never. Autopilots do not recognise a repeat: neither PX4 1.16 nor ArduPilot
4.6 looks at COMMAND_LONG.confirmation.

Protocol: https://mavlink.io/en/services/command.html
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, NamedTuple, Self

from skygcs.core.mavlink import mav_cmd
from skygcs.core.protocols.base import Effect, Finish, ProgressReport, ProtocolMachine, Transmit

# --- which may be repeated --------------------------------------------------------------------------------------------


class Repeat(Enum):
    """Choices when no answer came."""

    ANY_LINK = auto()
    """Harmless: repeated over every link that leads to the vehicle."""
    SAME_LINK = auto()
    """It concerns the link it came over, or what it does is not known: repeated while that is the chosen link."""
    IF_NOT_DONE = auto()
    """Repeated over every link, once the vehicle's state shows that it was not done."""
    NEVER = auto()
    """Sent once."""


class RepeatRule(NamedTuple):
    """``reason``: why, as the end of "... because". ``shows_after_s``: a heartbeat that came so long after the command
    reached the vehicle shows whether it was done."""

    repeat: Repeat
    reason: str
    shows_after_s: float = 0.0


SHOWS_AFTER_S = 0.5
"""Mode and armed state change within some tenths of a second. A vehicle that restarts is silent by then."""

LIFTS_OFF_AFTER_S = 3.0
"""A copter's motors spin up for one or two seconds before it lifts off."""

ITEM_SHOWS_AFTER_S = 5.0
"""MISSION_CURRENT comes at 0.2 to 1 Hz."""


def _any(reason: str, *commands: int) -> dict[int, RepeatRule]:
    return dict.fromkeys(commands, RepeatRule(Repeat.ANY_LINK, reason))


def _never(reason: str, *commands: int) -> dict[int, RepeatRule]:
    return dict.fromkeys(commands, RepeatRule(Repeat.NEVER, reason))


def _if_not_done(reason: str, *commands: int, shows_after_s: float = SHOWS_AFTER_S) -> dict[int, RepeatRule]:
    return dict.fromkeys(commands, RepeatRule(Repeat.IF_NOT_DONE, reason, shows_after_s))


def _same(reason: str, *commands: int) -> dict[int, RepeatRule]:
    return dict.fromkeys(commands, RepeatRule(Repeat.SAME_LINK, reason))


COMMANDS: Mapping[int, RepeatRule] = {
    # flight
    **_any(
        "the vehicle is in that mode already, and a newer order ends the repeats",
        mav_cmd.DO_SET_MODE,
        mav_cmd.NAV_RETURN_TO_LAUNCH,
        mav_cmd.NAV_LAND,
        mav_cmd.NAV_LAND_LOCAL,
        mav_cmd.NAV_VTOL_LAND,
        mav_cmd.NAV_LOITER_UNLIM,
        mav_cmd.NAV_GUIDED_ENABLE,
        mav_cmd.DO_PAUSE_CONTINUE,
        mav_cmd.OVERRIDE_GOTO,
        mav_cmd.DO_VTOL_TRANSITION,
    ),
    **_any("it is the same place", mav_cmd.DO_REPOSITION),
    **_any(
        "it is the same value",
        mav_cmd.DO_CHANGE_SPEED,
        mav_cmd.DO_CHANGE_ALTITUDE,
        mav_cmd.CONDITION_YAW,
        mav_cmd.GUIDED_CHANGE_SPEED,
        mav_cmd.GUIDED_CHANGE_ALTITUDE,
        mav_cmd.GUIDED_CHANGE_HEADING,
        mav_cmd.DO_GUIDED_LIMITS,
        mav_cmd.EXTERNAL_POSITION_ESTIMATE,
        mav_cmd.DO_SET_HOME,
    ),
    **_if_not_done(
        "a second one would climb again from the height reached by then",
        mav_cmd.NAV_TAKEOFF,
        mav_cmd.NAV_TAKEOFF_LOCAL,
        mav_cmd.NAV_VTOL_TAKEOFF,
        shows_after_s=LIFTS_OFF_AFTER_S,
    ),
    **_if_not_done("a second one would begin the mission again at its first item", mav_cmd.MISSION_START),
    **_if_not_done(
        "an item that was flown meanwhile would be flown again",
        mav_cmd.DO_SET_MISSION_CURRENT,
        shows_after_s=ITEM_SHOWS_AFTER_S,
    ),
    **_if_not_done("a vehicle that was disarmed meanwhile would be armed again", mav_cmd.COMPONENT_ARM_DISARM),
    **_if_not_done("a second one would restart it again as soon as it is up", mav_cmd.PREFLIGHT_REBOOT_SHUTDOWN),
    **_never("it would jump again", mav_cmd.DO_JUMP, mav_cmd.DO_JUMP_TAG),
    **_never("it would climb again", mav_cmd.DO_GO_AROUND),
    # safety: late is better than never
    **_any("there is nothing left to stop", mav_cmd.DO_FLIGHTTERMINATION, mav_cmd.DO_PARACHUTE),
    **_any("the fence is on, or off, already", mav_cmd.DO_FENCE_ENABLE),
    # payload
    **_any(
        "it is the same position, rate or state",
        mav_cmd.DO_SET_RELAY,
        mav_cmd.DO_SET_SERVO,
        mav_cmd.DO_SET_ACTUATOR,
        mav_cmd.DO_GRIPPER,
        mav_cmd.DO_SPRAYER,
        mav_cmd.DO_AUX_FUNCTION,
        mav_cmd.DO_ENGINE_CONTROL,
        mav_cmd.DO_MOUNT_CONFIGURE,
        mav_cmd.DO_MOUNT_CONTROL,
        mav_cmd.DO_GIMBAL_MANAGER_PITCHYAW,
        mav_cmd.DO_GIMBAL_MANAGER_CONFIGURE,
        mav_cmd.DO_SET_ROI,
        mav_cmd.DO_SET_ROI_LOCATION,
        mav_cmd.DO_SET_ROI_WPNEXT_OFFSET,
        mav_cmd.DO_SET_ROI_NONE,
        mav_cmd.DO_SET_CAM_TRIGG_DIST,
        mav_cmd.DO_SET_CAM_TRIGG_INTERVAL,
        mav_cmd.DO_TRIGGER_CONTROL,
        mav_cmd.SET_CAMERA_MODE,
        mav_cmd.SET_CAMERA_SOURCE,
        mav_cmd.IMAGE_STOP_CAPTURE,
        mav_cmd.VIDEO_STOP_CAPTURE,
    ),
    **_never(
        "it would be done again",
        mav_cmd.DO_REPEAT_RELAY,
        mav_cmd.DO_REPEAT_SERVO,
        mav_cmd.DO_DIGICAM_CONTROL,
        mav_cmd.IMAGE_START_CAPTURE,
        mav_cmd.VIDEO_START_CAPTURE,
        mav_cmd.SET_CAMERA_ZOOM,
        mav_cmd.SET_CAMERA_FOCUS,
        mav_cmd.DO_WINCH,
        mav_cmd.PAYLOAD_PREPARE_DEPLOY,
        mav_cmd.DO_SEND_SCRIPT_MESSAGE,
    ),
    **_never("the motors would run again", mav_cmd.DO_MOTOR_TEST, mav_cmd.ACTUATOR_TEST),
    **_never(
        "a button would be pressed again",
        mav_cmd.SOLO_BTN_FLY_CLICK,
        mav_cmd.SOLO_BTN_FLY_HOLD,
        mav_cmd.SOLO_BTN_PAUSE_CLICK,
    ),
    # set-up
    **_never("it would begin again", mav_cmd.PREFLIGHT_CALIBRATION, mav_cmd.DO_START_MAG_CAL),
    **_never("the pose that is asked for next would count as confirmed", mav_cmd.ACCELCAL_VEHICLE_POS),
    **_any("it is cancelled already", mav_cmd.DO_CANCEL_MAG_CAL),
    **_any("the same values are stored again", mav_cmd.PREFLIGHT_STORAGE, mav_cmd.PREFLIGHT_SET_SENSOR_OFFSETS),
    # questions
    **_any("it is only answered twice", *mav_cmd.QUESTIONS),
    **_same(
        "an autopilot has rates of its own for each of its ports",
        mav_cmd.SET_MESSAGE_INTERVAL,
        mav_cmd.GET_MESSAGE_INTERVAL,
    ),
}
"""Commands by id."""

UNLISTED = RepeatRule(Repeat.SAME_LINK, "it is not known what doing it twice does; MAVLink has it repeated")
"""Any other: vendors' commands, and those of other dialects."""

DISARM = RepeatRule(Repeat.ANY_LINK, "it is disarmed already")
RELATIVE_YAW = RepeatRule(Repeat.NEVER, "it would turn again")
HOME_HERE = RepeatRule(Repeat.NEVER, "its home would be where it is by then")


def repeat_rule(spec: CommandSpec) -> RepeatRule:
    """The rule for a command with these parameters."""
    params = (*spec.params, 0.0, 0.0, 0.0, 0.0)
    if spec.command == mav_cmd.COMPONENT_ARM_DISARM and params[0] == 0.0:
        return DISARM
    if spec.command == mav_cmd.CONDITION_YAW and params[3] == 1.0:
        return RELATIVE_YAW
    if spec.command == mav_cmd.DO_SET_HOME and params[0] == 1.0:
        return HOME_HERE
    return COMMANDS.get(spec.command, UNLISTED)


# --- command ----------------------------------------------------------------------------------------------------------


RETRY_TIMERS_S = (1.0, 1.5, 2.0, 2.5)
"""Waits after each transmission: four transmissions, 7 s in all. The first is longer than a full round of a nine-node
multipoint radio at 64 kbit/s (0.75 s) plus the vehicle's own answer; growing, because a busy radio gets worse when
everybody repeats at once. MAVSDK waits 0.5 s, Skybrush 2 s."""

EMERGENCY_TIMERS_S = (0.25, 0.25, 0.5, 0.5, 1.0, 1.0, 1.5)
"""Repeat intervals of a forced disarm: eight transmissions in five seconds; air time does not matter then."""

WORKING_SILENCE_S = 10.0
"""An in-progress report is expected again within this time (ArduPilot and PX4 report about once a second)."""

WORKING_LIMIT_S = 120.0
"""No command skygcs waits for takes longer; a calibration does not, a parachute test does not."""

POSTPONE_S = 0.25
"""Between two looks whether a repeat is harmless by now."""

SECOND_ACK_S = 0.5
"""Wait for the second answer of a command that is answered twice. It comes 8 to 15 ms later on board (own capture),
some tenths of a second later on a radio. Without it the first answer counts, and the state that shows the change
decides."""

SETTLE_S = 0.5
"""ArduPilot sends the STATUSTEXT that explains a refusal 0 to 8 ms after the ACK (own capture); a radio's next slot
may be some tenths of a second away."""

MAX_TEXTS = 8
"""Status texts kept with one outcome; a failing pre-arm check lists about six."""

RESULT_NAMES = {
    0: "accepted",
    1: "temporarily_rejected",
    2: "denied",
    3: "unsupported",
    4: "failed",
    5: "in_progress",
    6: "cancelled",
    7: "unsupported",
    8: "unsupported",
}
"""MAV_RESULT. 7 and 8 are COMMAND_LONG_ONLY and COMMAND_INT_ONLY: unsupported in the form it was sent."""

_DETAIL = {7: "as COMMAND_LONG only", 8: "as COMMAND_INT only"}

IN_PROGRESS = 5
"""MAV_RESULT of a command whose final answer is still to come."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How an order ended. ``message`` is for a person, ``result`` one of the words

    accepted temporarily_rejected denied unsupported failed in_progress cancelled timeout refused lost
    (refused: by skygcs itself, nothing was sent or the order was not carried on).
    """

    ok: bool
    result: str
    message: str
    attempts: int = 0
    elapsed_s: float = 0.0
    status_texts: tuple[str, ...] = ()
    order_number: int | None = None
    """Number of an order that moves the vehicle, among those of this daemon; None: it does not, or was not begun."""
    taken: bool = False
    """True for a setpoint that was refused as the vehicle follows another client, or an order, instead."""

    @classmethod
    def refused(cls, why: str) -> Self:
        """By skygcs, before anything was sent."""
        return cls(False, "refused", f"refused: {why}")

    def as_dict(self) -> dict[str, Any]:
        """Return its fields for the answers of methods; ``order_number`` and ``taken`` only if they are set."""
        number = {} if self.order_number is None else {"order_number": self.order_number}
        return {
            "ok": self.ok,
            "result": self.result,
            "message": self.message,
            "attempts": self.attempts,
            "elapsed_s": round(self.elapsed_s, 3),
            "status_texts": list(self.status_texts),
            **number,
            **({"taken": True} if self.taken else {}),
        }


@dataclass(frozen=True, slots=True)
class Location:
    """x, y, z of a COMMAND_INT, as on the wire (x, y: degrees * 1e7 or metres * 1e4), and their MAV_FRAME."""

    frame: int
    x: int
    y: int
    z: float


@dataclass(frozen=True, slots=True)
class CommandSpec:
    """A command and its parameters: COMMAND_LONG, or COMMAND_INT where there is a ``location``."""

    command: int
    params: tuple[float, ...] = ()
    location: Location | None = None
    answers_twice: bool = False
    """The first ACCEPTED only says that the command was received; the second answer is the result (PX4's DO_SET_MODE:
    mavlink_receiver.cpp, handle_message_command_both; then Commander.cpp, handle_command)."""

    def __post_init__(self) -> None:
        if len(self.params) > (7 if self.location is None else 4):
            raise ValueError(f"command {self.command} has too many parameters: {len(self.params)}")

    @property
    def message(self) -> str:
        return "COMMAND_LONG" if self.location is None else "COMMAND_INT"

    def values(self, sysid: int, compid: int, attempt: int) -> dict[str, Any]:
        """Field values of the message. COMMAND_INT has no confirmation count: it is repeated as it is."""
        values: dict[str, Any] = {
            "target_system": sysid,
            "target_component": compid,
            "command": self.command,
            **{f"param{n}": value for n, value in enumerate(self.params, 1)},
        }
        if self.location is None:
            values["confirmation"] = min(attempt, 255)
        else:
            at = self.location
            values.update(frame=at.frame, x=at.x, y=at.y, z=at.z)
        return values


@dataclass(frozen=True, slots=True)
class Ack:
    """A COMMAND_ACK. MAVLink 1 carries neither progress nor target: they are 0 then."""

    command: int
    result: int
    progress: int = 0
    target_system: int = 0
    target_component: int = 0

    @classmethod
    def from_fields(cls, fields: Mapping[str, Any]) -> Ack:
        return cls(
            fields["command"],
            fields["result"],
            fields.get("progress", 0),
            fields.get("target_system", 0),
            fields.get("target_component", 0),
        )

    def is_for(self, sysid: int, compid: int) -> bool:
        """True if it answers us; 0 is an autopilot that does not name the receiver."""
        return self.target_system in (0, sysid) and self.target_component in (0, compid)


class CommandState(Enum):
    IDLE = auto()
    WAITING = auto()
    WORKING = auto()
    SETTLING = auto()
    DONE = auto()


class CommandProtocol(ProtocolMachine):
    """See the table at the top. Only acks that answer us (`Ack.is_for`) and are of this vehicle may be handed in.

    ``timers`` are the waits after each transmission; their number is the number of transmissions.
    """

    def __init__(self, spec: CommandSpec, timers: tuple[float, ...] = RETRY_TIMERS_S) -> None:
        self.spec = spec
        self.state = CommandState.IDLE
        self.outcome: Outcome | None = None
        self.attempts = 0
        self.acks = 0
        self.last_sent = -math.inf
        self._timers = timers
        self._started = 0.0
        self._work_since = 0.0
        self._result = 0
        self._percent: int | None = None
        self._received = False
        self._texts: list[str] = []

    @property
    def done(self) -> bool:
        return self.state is CommandState.DONE

    @property
    def outstanding(self) -> int:
        """Transmissions that no ack was counted for: so many late ones may still come."""
        return max(0, self.attempts - self.acks)

    def start(self, now: float, *, transmitted: bool = False) -> tuple[Effect, ...]:
        """Begin; ``transmitted`` if a broadcast frame has just carried the command already."""
        assert self.state is CommandState.IDLE, "start is called once"
        self.state = CommandState.WAITING
        self._started = now
        effects = self._transmit(now)
        return () if transmitted else effects

    def on_ack(self, ack: Ack, now: float) -> tuple[Effect, ...]:
        if self.state in (CommandState.IDLE, CommandState.DONE) or ack.command != self.spec.command:
            return ()
        self.acks += 1
        if self.state is CommandState.SETTLING:
            return ()
        if ack.result == IN_PROGRESS:
            return self._on_progress(ack.progress, now)
        self._result = ack.result
        if ack.result == 0 and self.spec.answers_twice and not self._received:
            self._received = True
            self.deadline = now + SECOND_ACK_S
            return ()
        if ack.result == 0:
            return self._finish(now, "accepted", "accepted")
        self.state = CommandState.SETTLING
        self.deadline = now + SETTLE_S
        return ()

    def on_text(self, text: str) -> None:
        """A status text of this vehicle came: it may say why."""
        if self.state in (CommandState.IDLE, CommandState.DONE) or text in self._texts:
            return
        self._texts.append(text)
        del self._texts[:-MAX_TEXTS]

    def on_timer(self, now: float) -> tuple[Effect, ...]:
        if self.deadline is None or now < self.deadline:
            return ()
        if self._received and self.state is CommandState.WAITING:
            return self._finish(now, "accepted", "accepted")
        if self.state is CommandState.WAITING:
            if self.attempts < len(self._timers):
                return self._transmit(now)
            return self._finish(now, "timeout", f"no answer to {self.attempts} transmissions")
        if self.state is CommandState.SETTLING:
            return self._refuse(now)
        if now - self._work_since >= WORKING_LIMIT_S:
            return self._finish(now, "in_progress", f"still in progress{self._how_far()} after {WORKING_LIMIT_S:.0f} s")
        return self._finish(now, "timeout", f"in progress{self._how_far()}, then nothing for {WORKING_SILENCE_S:.0f} s")

    def may_transmit(self, now: float) -> bool:
        """True if `on_timer` would transmit again now."""
        due = self.deadline is not None and now >= self.deadline and not self._received
        return due and self.state is CommandState.WAITING and self.attempts < len(self._timers)

    def postpone(self, now: float, why: str) -> tuple[Effect, ...]:
        """Do not transmit again yet; once all timers together are over, finish with a time-out that says why."""
        if now - self._started < sum(self._timers):
            self.deadline = now + POSTPONE_S
            return ()
        return self._finish(now, "timeout", f"no answer to {self.attempts} transmissions; not sent again, {why}")

    def stop(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        """End it from outside: cancelled, lost, or no longer needed because the state shows what was wanted."""
        if self.state in (CommandState.IDLE, CommandState.DONE):
            return ()
        return self._finish(now, result, message)

    def _transmit(self, now: float) -> tuple[Effect, ...]:
        attempt = self.attempts
        self.attempts += 1
        self.last_sent = now
        self.deadline = now + self._timers[attempt]
        return (Transmit(attempt),)

    def _on_progress(self, progress: int, now: float) -> tuple[Effect, ...]:
        if self.state is not CommandState.WORKING:
            self.state = CommandState.WORKING
            self._work_since = now
        self._percent = progress if progress <= 100 else None
        self.deadline = min(now + WORKING_SILENCE_S, self._work_since + WORKING_LIMIT_S)
        return (ProgressReport(self._percent),)

    def _refuse(self, now: float) -> tuple[Effect, ...]:
        result = RESULT_NAMES.get(self._result, "failed")
        detail = _DETAIL.get(self._result) or (None if self._result in RESULT_NAMES else f"MAV_RESULT {self._result}")
        words = [result.replace("_", " ")]
        if detail:
            words.append(f"({detail})")
        reason = "; ".join(self._texts)
        return self._finish(now, result, " ".join(words) + (f": {reason}" if reason else ""))

    def _how_far(self) -> str:
        return "" if self._percent is None else f" ({self._percent} %)"

    def _finish(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        self.state = CommandState.DONE
        self.deadline = None
        self.outcome = Outcome(
            result == "accepted", result, message, self.attempts, now - self._started, tuple(self._texts)
        )
        return (Finish(),)
