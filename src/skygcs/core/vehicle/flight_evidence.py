"""Evidence that a disarmed vehicle flies, or has not landed: its heartbeat and its landed state alone show neither.

The armed bit of one heartbeat may be forged, or come from another vehicle. A disarmed autopilot reports itself on the
ground within two seconds (EXTENDED_SYS_STATE of ArduCopter and PX4), stands still and does not turn its motors. If
telemetry contradicts that, control by setpoints orders a hold before it ends, and orders that would be dangerous in the
air need `force`.

A disarmed vehicle on the ground is not one that has landed: every firmware reports itself there once it is disarmed,
wherever that was (ArduCopter: AP_Arming_Copter::disarm sets land_complete; PX4: MulticopterLandDetector).

    it has not landed if                                                         as shown by
    --------------------------------------------------------------------------   ---------------------------------------
    its autopilot says that it has crashed, or has been switched off             STATUSTEXT (`NOT_LANDED_TEXTS`)
    it leans by more than `LEANS_DEG` where it lies (a VTOL may stand so)        ATTITUDE, since it was disarmed
    it was `FELL_M` higher when it was last seen armed                           GLOBAL_POSITION_INT: altitude
    it came to the ground faster than any landing                                the same, while it was armed

A text may be lost, and a crash may end upright: each of them alone is enough, and what was seen once counts until the
watch ends. It has landed if none of them is there although position and attitude have come since the time in which it
would have fallen (`FALL_S`), and nothing shows it moving. Until then it is not known: silence is no evidence.

Heights are altitudes above sea level. Those above home do not do: both firmwares move home to where the vehicle is
when it is disarmed (PX4: HomePosition::update; ArduPlane: Plane::update_home), and a fall is gone then.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from skygcs.core.mavlink.vehicle_class import VehicleClass
from skygcs.core.vehicle.state import AIRBORNE
from skygcs.core.vehicle.vehicle import Vehicle

FRESH_S = 3.0
"""Older telemetry is not used: the slowest stream profile sends 0.5 Hz, and one message may be lost."""

HEIGHT_M = 5.0
"""Height over home that a vehicle on the ground never shows: barometers drift by 1 or 2 m."""

CLIMB_MPS = 1.0
SPEED_MPS = 3.0
"""Faster than a vehicle is carried by hand, and than GPS noise of a standing one."""

THROTTLE_PERCENT = 10

RECENTLY_ARMED_S = 3.0
"""Three heartbeats: by then the landed state has followed as well."""


def flight_evidence(vehicle: Vehicle, now: float) -> str | None:
    """Telemetry that shows the vehicle flying, whatever its armed bit says; None if there is none, or if its class does
    not fly."""
    if not vehicle.abilities.flies:
        return None
    if (state := _airborne_state(vehicle, now)) is not None:
        return state
    return height_evidence(vehicle, now) or motion_evidence(vehicle, now)


def _airborne_state(vehicle: Vehicle, now: float) -> str | None:
    state, at = vehicle.landed_state()
    if state in AIRBORNE and now - at <= FRESH_S:
        return f"it reports itself {'in the air' if state == 'in_air' else 'in ' + state}"
    return None


def height_evidence(vehicle: Vehicle, now: float) -> str | None:
    """Its height above home, where that shows it flying. Where the ground is higher than home it proves nothing."""
    position, at = vehicle.timed_telemetry("position")
    if position is None or at is None or now - at > FRESH_S or position["lat_deg"] is None:
        return None
    return f"it is {position['alt_rel_m']:.0f} m above its home" if position["alt_rel_m"] > HEIGHT_M else None


def motion_evidence(vehicle: Vehicle, now: float) -> str | None:
    """Its landed state, its speed or its throttle, where one of them shows it flying; None: none does."""
    if (state := _airborne_state(vehicle, now)) is not None:
        return state
    position, at = vehicle.timed_telemetry("position")
    if position is not None and at is not None and now - at <= FRESH_S:
        east, north, up = position["vel_enu_mps"]
        speed = math.hypot(east, north)
        if abs(up) > CLIMB_MPS:
            return f"it {'climbs' if up > 0 else 'sinks'} at {abs(up):.1f} m/s"
        if speed > SPEED_MPS:
            return f"it moves at {speed:.1f} m/s"
    vfr, vfr_at = vehicle.timed_telemetry("vfr")
    turning = vfr is not None and vehicle.abilities.hovers and vfr["throttle_percent"] >= THROTTLE_PERCENT
    if vfr is not None and turning and vfr_at is not None and now - vfr_at <= FRESH_S:
        return f"its throttle is at {vfr['throttle_percent']} %"
    return None


def contradiction(vehicle: Vehicle, now: float) -> str | None:
    """Why it may be flying although its heartbeat shows it disarmed; None if it is armed, or certainly disarmed."""
    if vehicle.armed:
        return None
    if vehicle.ids.beside:
        return "two vehicles send with its ids on one link"
    return flight_evidence(vehicle, now)


def moves_disarmed(vehicle: Vehicle, now: float, state_within_s: float = FRESH_S) -> str | None:
    """Why a disarmed vehicle may be in the air all the same. Its height above home counts only while it does not report
    itself on the ground, in this time: that may be higher than home, which ArduCopter keeps until it is armed again."""
    if not vehicle.abilities.flies:
        return None
    state, at = vehicle.landed_state()
    on_ground = state == "on_ground" and at > vehicle.armed_at and now - at <= state_within_s
    return motion_evidence(vehicle, now) or (None if on_ground else height_evidence(vehicle, now))


def why_maybe_flying(vehicle: Vehicle, now: float) -> str | None:
    """Why a heartbeat that shows the vehicle disarmed is doubted; None if it is not."""
    if (evidence := contradiction(vehicle, now)) is not None:
        return f"its heartbeat shows it disarmed, but {evidence}"
    if vehicle.ids.elsewhere is not None:
        return f"two vehicles have its system id ({vehicle.ids.elsewhere})"
    return None


def why_maybe_in_air(vehicle: Vehicle, now: float) -> str | None:
    """Why it may be in the air, armed or not; None: it stands on the ground."""
    if not vehicle.armed:
        return why_maybe_flying(vehicle, now)
    in_air = vehicle.in_air(now)
    return "it is in the air" if in_air else "it is armed, and may be in the air" if in_air is None else None


def is_being_armed(vehicle: Vehicle, now: float) -> bool:
    """True if an arming of ours may have armed it and no heartbeat has shown that yet."""
    return vehicle.armed_at < vehicle.arming_at and now <= vehicle.arming_until


def disarmed_since(vehicle: Vehicle, at: float) -> str | None:
    """Why what was ordered ``at`` that time, and arms, must not be sent now: the vehicle has been armed since, and is
    not any more. None: it may be."""
    again = vehicle.armed_at > at and not vehicle.armed
    return "it was armed since this was ordered, and is disarmed again" if again else None


def why_not_idle(vehicle: Vehicle, now: float) -> str | None:
    """Why the vehicle must be treated as armed, and orders dangerous in the air be refused; None: it is idle."""
    if vehicle.armed:
        return "it is armed"
    if is_being_armed(vehicle, now):
        return "it is being armed"
    if (why := why_maybe_flying(vehicle, now)) is not None:
        return why
    state, at = vehicle.landed_state()
    seen_on_ground = state == "on_ground" and at > vehicle.armed_at
    if 0.0 <= now - vehicle.armed_at <= RECENTLY_ARMED_S and not seen_on_ground:
        return f"it was armed {now - vehicle.armed_at:.1f} s ago: wait until it is seen on the ground"
    return None


# -- landings


NOT_LANDED_TEXTS = (
    "crash: ",  # ArduCopter/crash_check.cpp and Rover/crash_check.cpp: "Crash: Disarming", "Crash: Going to HOLD"
    "crash detected",  # ArduPlane/is_flying.cpp
    "hard landing detected",  # the same, near the place of the landing
    "parachute: released",  # AP_Parachute.cpp
    "kill engaged",  # PX4, Commander.cpp: executeActionRequest; it stays armed for COM_KILL_DISARM
    "disarmed by kill-switch",  # arm_disarm_reason_str
    "disarmed by lockdown",
    "disarmed by failure detector",
)
"""Beginnings of texts, in lower case."""

LEANS_DEG = 45.0
"""No vehicle that has landed leans so far: a copter on its arm or a plane on its wing tip is below 30 degrees."""

FELL_M = 4.0
"""More than what a landing sinks between the position that came last and the touch-down, with the drift of a barometer
(2 m): the last metres are flown with at most 0.7 m/s (LAND_SPEED, MPC_LAND_SPEED), and both firmwares disarm one second
and more after the touch-down."""

LOOKED_BACK_S = 2.0
"""Before it was last seen armed: a heartbeat comes each second and may be late, and then it was disarmed before."""

LOW_M = 3.0
"""Above where it lies: there every landing is slow (LAND_ALT_LOW is 10 m, MPC_LAND_ALT2 5 m, LAND_FLARE_ALT 3 m)."""

FALLS_MPS, GLIDES_DOWN_MPS = 3.0, 6.0
"""Faster than what hovers, and what flies on wings, comes down for a landing: LAND_SPEED is at most 2 m/s; a fall from
1 m ends at 4.4 m/s, and an approach of 10 degrees at 20 m/s sinks at 3.5 m/s."""

LEAST_APART_S = 0.2
"""Between two heights that give a speed: an error of 0.3 m makes 1.5 m/s then."""

LOW_KEPT_S = 60.0
"""From the touch-down until it is disarmed: PX4 may stand killed for COM_KILL_DISARM, at most 30 s."""

FALL_S = 5.0
"""A fall from 100 m takes 4.5 s, without the drag of the air."""

MAX_HEIGHTS = 400
"""More than `MissionTurns` notes in `LOW_KEPT_S`, and in the time without a heartbeat after which it is not heard."""


class Landed(NamedTuple):
    """``landed``: None: not known yet. ``why``: the evidence against it, or what is missing."""

    landed: bool | None
    why: str


class _Height(NamedTuple):
    at: float
    boot_s: float
    """By its own clock: positions that a radio delays come together."""
    alt_amsl_m: float
    sink_mps: float


class LandingWatch:
    """One flight's end: `look` a few times a second from its start on, then `verdict`."""

    def __init__(self, now: float) -> None:
        self._began_at = now
        self._heights: deque[_Height] = deque(maxlen=MAX_HEIGHTS)
        """Its positions while its heartbeats showed it armed, of `LOW_KEPT_S`."""
        self._disarmed_at: float | None = None
        """The first heartbeat that showed it disarmed, or one that came soon after."""
        self._against: str | None = None
        """The first evidence that it has not landed."""

    def look(self, vehicle: Vehicle, now: float) -> None:
        """Note what the vehicle shows about being landed."""
        silence_s = vehicle.silence_s(now)
        if vehicle.armed or silence_s is None:
            self._disarmed_at = None
            self._note_height(vehicle)
        elif self._disarmed_at is None:
            self._disarmed_at = now - silence_s
        self._against = self._against or self._evidence(vehicle)

    def verdict(self, vehicle: Vehicle, now: float) -> Landed:
        """Verdict by all that `look` has noted. While it is armed none is known, unless its autopilot has reported a
        crash."""
        if self._against is not None:
            return Landed(False, self._against)
        if self._disarmed_at is None or vehicle.armed:
            return Landed(None, "it is armed")
        if vehicle.ids.beside:
            return Landed(None, "two vehicles send with its ids on one link")
        since = self._disarmed_at + FALL_S
        for name in ("position", "attitude"):
            shown, at = vehicle.timed_telemetry(name)
            if shown is None or at is None or at < since:
                return Landed(None, f"no {name} has come since it was disarmed")
        if (moves := moves_disarmed(vehicle, now, math.inf)) is not None:
            return Landed(None, f"it is disarmed, but {moves}")
        return Landed(True, "")

    # -- internal

    def _note_height(self, vehicle: Vehicle) -> None:
        position, at = vehicle.timed_telemetry("position")
        if position is None or at is None:
            return
        heights, alt_m = self._heights, position["alt_amsl_m"]
        if not heights or at > heights[-1].at:
            sink_mps = -float(position["vel_enu_mps"][2])
            boot_s = float(position["time_boot_s"])
            if heights and (took_s := boot_s - heights[-1].boot_s) >= LEAST_APART_S:
                sink_mps = max(sink_mps, (heights[-1].alt_amsl_m - alt_m) / took_s)
            heights.append(_Height(at, boot_s, alt_m, sink_mps))
        # nothing is dropped that may be of the end of its flight: its heartbeats may be lost meanwhile
        kept_from = min(heights[-1].at - LOW_KEPT_S, vehicle.armed_at - LOOKED_BACK_S)
        while len(heights) > 1 and heights[1].at < kept_from:
            heights.popleft()

    def _evidence(self, vehicle: Vehicle) -> str | None:
        """Present evidence that it has not landed; None: nothing shows it."""
        for text in vehicle.texts:
            if text.at >= self._began_at and text.text.lower().startswith(NOT_LANDED_TEXTS):
                return f"its autopilot reports {text.text!r}"
        if self._disarmed_at is None:
            return None
        attitude, at = vehicle.timed_telemetry("attitude")
        stands_level = vehicle.kind is not VehicleClass.VTOL  # a tail-sitter's pitch may be given either way
        if stands_level and attitude is not None and at is not None and at > vehicle.armed_at:
            upright = math.cos(math.radians(attitude["roll_deg"])) * math.cos(math.radians(attitude["pitch_deg"]))
            if (lean_deg := math.degrees(math.acos(upright))) > LEANS_DEG:
                return f"it lies on its side (it leans by {lean_deg:.0f} degrees)"
        return self._fall(vehicle) if vehicle.abilities.flies else None

    def _fall(self, vehicle: Vehicle) -> str | None:
        """The fall that its positions show since shortly before it was last seen armed."""
        position, at = vehicle.timed_telemetry("position")
        if position is None or at is None or at <= vehicle.armed_at or not self._heights:
            return None
        lies_m = position["alt_amsl_m"]
        last = [height for height in self._heights if height.at >= vehicle.armed_at - LOOKED_BACK_S]
        fell_m = max(height.alt_amsl_m for height in last or [self._heights[-1]]) - lies_m
        if fell_m > FELL_M:
            return f"it was {fell_m:.0f} m higher when it was last seen armed"
        most_mps = GLIDES_DOWN_MPS if vehicle.abilities.circles else FALLS_MPS
        low = (height.sink_mps for height in self._heights if height.alt_amsl_m <= lies_m + LOW_M)
        if (sank_mps := max(low, default=0.0)) > most_mps:
            return f"it came to the ground at {sank_mps:.1f} m/s"
        return None


MAYBE_FLYING_S = 1800.0
"""A vehicle that was lost while armed may still fly for this time; few batteries last longer."""


def may_fly(vehicle: Vehicle, now: float) -> bool:
    """True if it may be under way now, in the air or on the ground, by what was heard of it last: in doubt it is.

    The one rule about the supply of a vehicle under way: no judgement about another vehicle cuts it. All these ask:

        what feeds it                    what would end it                                 while it may be under way
        ------------------------------   -----------------------------------------------   ---------------------------
        poses, on the channel that       another autopilot has its ids, on whatever link;  they go on, with an event
        carries them                     another one is heard on its channel; it is not
                                         heard
        its channel (a peer of a         silence; another peer needs the place             it stays
        server)
        its route                        silence; another source needs the place           it stays
        its entry in the fleet           another vehicle needs the place                   it stays

    What ends them all the same: the channel closes, a person removes the link or forgets the vehicle, it is heard
    disarmed, or on the ground unless it drives, or `MAYBE_FLYING_S` of silence. A forged heartbeat costs places, at
    most one for each system id, and no flight.
    """
    silence_s = vehicle.silence_s(now)
    if vehicle.replayed or silence_s is None or silence_s >= MAYBE_FLYING_S:
        return False
    return vehicle.under_way(now)
