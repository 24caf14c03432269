"""The fence of an autopilot's parameters: a cylinder around home, and the action on leaving it.

    word       PX4, GF_ACTION   ArduCopter, FENCE_ACTION
    none       0                FENCE_ENABLE 0
    warn       1                0
    hold       2                4 (brake)
    return     3                1 (lands where it cannot)
    land       5                2
    terminate  4 (motors off)   -

Radius and height are GF_MAX_HOR_DIST and GF_MAX_VER_DIST, where 0 is no limit, or FENCE_RADIUS and FENCE_ALT_MAX with
a bit of FENCE_TYPE each. `FenceWatch` notices breaches, of its polygons and circles as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

from skygcs.core.geo import distance_m
from skygcs.core.mavlink.vehicle_class import VehicleClass
from skygcs.core.vehicle.flight_evidence import why_maybe_in_air, why_not_idle
from skygcs.core.vehicle.order_plan import FORCE_HINT
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.spelling import rounded

FenceAction = Literal["none", "warn", "hold", "return", "land", "terminate"]
ACTIONS: tuple[FenceAction, ...] = get_args(FenceAction)

PX4_ACTIONS: Mapping[str, int] = {"none": 0, "warn": 1, "hold": 2, "return": 3, "terminate": 4, "land": 5}
COPTER_ACTIONS: Mapping[str, int] = {"warn": 0, "return": 1, "land": 2, "hold": 4}

NAMES: Mapping[str, tuple[str, ...]] = {
    "px4": ("GF_MAX_HOR_DIST", "GF_MAX_VER_DIST", "GF_ACTION"),
    "ardupilot": ("FENCE_RADIUS", "FENCE_ALT_MAX", "FENCE_ACTION", "FENCE_TYPE", "FENCE_ENABLE"),
}
"""In the order in which they are set: the fence is complete before it is switched on."""

TYPE_HEIGHT, TYPE_CIRCLE, TYPE_LIST = 1, 2, 4
"""Bits of FENCE_TYPE; the last is for the polygons and circles of the fence list."""

GEOFENCE_BIT = 1 << 20
"""MAV_SYS_STATUS_GEOFENCE."""

CLEARANCE_M = 2.0
"""A vehicle that holds in the air wanders by so much: GPS noise and gusts. Nearer than this a new fence may be broken
by the time it is set."""

ACTS: Mapping[str, str] = {"hold": "stop", "terminate": "switch its motors off"}
"""Actions in words, where the word of the order is none."""

REACTIONS: Mapping[str, frozenset[str]] = {
    "hold": frozenset({"AUTO.LOITER", "BRAKE"}),
    "return": frozenset({"AUTO.RTL", "RTL", "SMART_RTL", "LAND"}),
    "land": frozenset({"AUTO.LAND", "LAND"}),
}
"""Modes that the autopilot enters by an action."""

PERIOD_S = 1.0
"""Between two looks: SYS_STATUS comes once or twice a second."""

FRESH_S = 5.0
"""Age at which its telemetry of the fence counts no longer: SYS_STATUS comes at 0.5 Hz over a full radio."""

INSIDE_S = 3.0
"""A vehicle at the border is outside and inside by turns; and SYS_STATUS is up to `PERIOD_S` older than a text."""


@dataclass(frozen=True, slots=True)
class FenceSettings:
    """``radius_m``, ``height_m``: None is no limit. ``follows_list``: polygons and circles are in force, too."""

    enabled: bool
    action: str
    radius_m: float | None
    height_m: float | None
    follows_list: bool

    def __str__(self) -> str:
        if not self.enabled:
            return "off"
        sizes = [f"{name} {size:g} m" for name, size in (("radius", self.radius_m), ("height", self.height_m)) if size]
        return f"{', '.join(sizes) or 'without radius and height'}, action {self.action}"

    def as_dict(self) -> dict[str, Any]:
        return {
            "enabled": self.enabled,
            "action": self.action,
            "radius_m": self.radius_m,
            "height_m": self.height_m,
            "follows_list": self.follows_list,
        }


def has_known_fence(vehicle: Vehicle) -> bool:
    """True if skygcs knows the fence parameters of this autopilot and kind of vehicle."""
    return vehicle.family in NAMES and (vehicle.family != "ardupilot" or vehicle.kind is VehicleClass.COPTER)


def names_of(vehicle: Vehicle) -> tuple[str, ...]:
    """Names of the fence parameters. Raises RefusedError for an autopilot or a kind of vehicle with other ones."""
    if vehicle.family in NAMES and not has_known_fence(vehicle):
        raise RefusedError("skygcs knows the fence parameters of an ArduPilot for copters only; set them yourself")
    if vehicle.family not in NAMES:
        raise RefusedError("skygcs knows the fence parameters of PX4 and ArduCopter only; set them yourself")
    return NAMES[vehicle.family]


def settings_of(family: str, held: Mapping[str, float]) -> FenceSettings:
    """The fence of these parameters, all of NAMES."""
    if family == "px4":
        number = int(held["GF_ACTION"])
        return FenceSettings(
            number != 0,
            _word(PX4_ACTIONS, number),
            held["GF_MAX_HOR_DIST"] or None,
            held["GF_MAX_VER_DIST"] or None,
            follows_list=number != 0,
        )
    kinds = int(held["FENCE_TYPE"])
    return FenceSettings(
        bool(held["FENCE_ENABLE"]),
        _word(COPTER_ACTIONS, int(held["FENCE_ACTION"])),
        held["FENCE_RADIUS"] if kinds & TYPE_CIRCLE else None,
        held["FENCE_ALT_MAX"] if kinds & TYPE_HEIGHT else None,
        follows_list=bool(kinds & TYPE_LIST),
    )


def known_ceiling_m(vehicle: Vehicle) -> float | None:
    """The height above its home at which the vehicle's own fence acts; None: it has none, or not all of its parameters
    have been read."""
    names = names_of(vehicle) if has_known_fence(vehicle) else ()
    held = {name: value for name in names if (value := vehicle.param(name)) is not None}
    if not names or len(held) < len(names):
        return None
    fence = settings_of(vehicle.family, held)
    return fence.height_m if fence.enabled and fence.action not in ("none", "warn") else None


def require_below_fence(vehicle: Vehicle, height_m: float) -> None:
    """Raises RefusedError for a height above its home at which its own fence is known to act."""
    ceiling_m = known_ceiling_m(vehicle)
    if ceiling_m is not None and height_m > ceiling_m:
        raise RefusedError(
            f"that is {rounded(height_m)} m above its home, and its own fence acts above {rounded(ceiling_m)} m: "
            f"choose a lower height, change the fence (skygcs-cli fence set), or {FORCE_HINT}"
        )


def _word(actions: Mapping[str, int], number: int) -> str:
    return next((word for word, value in actions.items() if value == number), str(number))


def changes(
    family: str, held: Mapping[str, float], *, radius_m: float | None, height_m: float | None, action: str | None
) -> dict[str, float]:
    """Parameters to set, in this order, for the arguments that are not None; a size of 0 removes that limit.

    Raises RefusedError for an action that the autopilot does not have.
    """
    if family == "px4":
        number = None if action is None else PX4_ACTIONS[action]
        sizes = {"GF_MAX_HOR_DIST": radius_m, "GF_MAX_VER_DIST": height_m, "GF_ACTION": number}
        return {name: float(value) for name, value in sizes.items() if value is not None}
    if action == "none":
        return {"FENCE_ENABLE": 0.0}
    if action is not None and action not in COPTER_ACTIONS:
        raise RefusedError(f"an ArduCopter has no fence action {action!r}; it has {', '.join(COPTER_ACTIONS)} and none")
    kinds = int(held["FENCE_TYPE"])
    reported: dict[str, float] = {}
    for name, size, bit in (("FENCE_RADIUS", radius_m, TYPE_CIRCLE), ("FENCE_ALT_MAX", height_m, TYPE_HEIGHT)):
        if size is None:
            continue
        kinds = kinds | bit if size > 0 else kinds & ~bit
        if size > 0:
            reported[name] = size
    if action is not None:
        reported["FENCE_ACTION"] = float(COPTER_ACTIONS[action])
    return {**reported, "FENCE_TYPE": float(kinds), "FENCE_ENABLE": 1.0}


def back_to(family: str, held: Mapping[str, float], changed: Mapping[str, float]) -> dict[str, float]:
    """Values of the changed parameters as they were, in the order in which they are restored: a fence that was off is
    switched off first."""
    back = {name: value for name, value in held.items() if name in changed and changed[name] != value}
    if family == "ardupilot" and not held["FENCE_ENABLE"]:
        return {"FENCE_ENABLE": 0.0, **back}
    return back


def reports_breach(text: str) -> bool:
    """True if a status text of either autopilot reports that the vehicle is outside its fence."""
    low = text.lower()
    if "cleared" in low or "outside geofence" in low:  # the end of a breach, or a refused target
        return "approaching or outside" in low
    reported = ("fence breach", "geofence violation", "breaching", "failsafe activated: fence", "fence breached")
    return any(words in low for words in reported)


def breach(vehicle: Vehicle, *, fresh_after: float) -> bool | None:
    """Breach by telemetry newer than that time: FENCE_STATUS, else the bit of SYS_STATUS; None if neither came."""
    slot = vehicle.slot("FENCE_STATUS")
    if slot is not None and slot.frame is not None and slot.at >= fresh_after:
        return bool(slot.frame.fields()["breach_status"])
    slot = vehicle.slot("SYS_STATUS")
    if slot is None or slot.frame is None or slot.at < fresh_after:
        return None
    fields = slot.frame.fields()
    if not fields["onboard_control_sensors_enabled"] & GEOFENCE_BIT:
        return None
    return not fields["onboard_control_sensors_health"] & GEOFENCE_BIT


def from_home_m(vehicle: Vehicle) -> float | None:
    """Horizontal distance from its home; None unless both positions are known."""
    home, here = vehicle.telemetry("home"), vehicle.telemetry("position")
    if home is None or here is None or here["lat_deg"] is None:
        return None
    return distance_m(home["lat_deg"], home["lon_deg"], here["lat_deg"], here["lon_deg"])


def require_inside(vehicle: Vehicle, now: float, fence: FenceSettings) -> None:
    """Raises RefusedError for a fence that a vehicle under way would be outside of at once, or might be."""
    if not fence.enabled or fence.action in ("none", "warn") or (why_not_idle(vehicle, now)) is None:
        return
    if vehicle.armed and not vehicle.under_way(now):
        return
    away_m, position = from_home_m(vehicle), vehicle.telemetry("position")
    if away_m is None or position is None:
        raise RefusedError(f"whether it is inside of that fence is not known; {FORCE_HINT}")
    does = f"and would {ACTS.get(fence.action, fence.action)} at once"
    if fence.radius_m is not None and away_m + CLEARANCE_M > fence.radius_m:
        raise RefusedError(
            f"it is {away_m:.1f} m from its home, outside of {rounded(fence.radius_m)} m less {CLEARANCE_M:g} m, "
            f"{does}: bring it nearer, or {FORCE_HINT}"
        )
    if fence.height_m is not None and position["alt_rel_m"] + CLEARANCE_M > fence.height_m:
        raise RefusedError(
            f"it is {position['alt_rel_m']:.1f} m above its home, outside of {rounded(fence.height_m)} m less "
            f"{CLEARANCE_M:g} m, {does}: bring it lower, or {FORCE_HINT}"
        )


def require_testable(vehicle: Vehicle, now: float, radius_m: float) -> None:
    """Raises RefusedError for a vehicle in the air, and for one that stands outside the test's fence already."""
    if (why := why_maybe_in_air(vehicle, now)) is not None:
        raise RefusedError(f"{why}: carry the vehicle over the fence by hand, with the propellers off")
    away_m = from_home_m(vehicle)
    if away_m is not None and away_m >= radius_m:
        raise RefusedError(
            f"it stands {away_m:.1f} m from its home, outside a fence of {rounded(radius_m)} m already: set home "
            f"where it stands (skygcs-cli home {vehicle.name}), and begin again"
        )


class FenceWatch:
    """Notices when a vehicle leaves its fence, and when it is inside again. One per vehicle; `look` several times a
    second; ``outside`` is what was seen last, ``testing``: the fence is tested, and no breach is reported.

    seen                                                        then
    ---------------------------------------------------------   ----------------------------------------------
    its telemetry shows a breach (`fence_params.breach`)        it is outside
    a status text reports one (all that a PX4 sends)            it is outside
    its telemetry shows none for `INSIDE_S`                     it is inside again
    no telemetry of its fence, and it is disarmed               it is inside again, or nobody flies it
    it is lost                                                  nothing changes
    """

    def __init__(self) -> None:
        self.outside = False
        self.testing = False
        self._looked_at: float | None = None
        self._text = ""
        """A report of a breach since the last look."""
        self._inside_since: float | None = None

    def on_text(self, text: str) -> None:
        """A status text of the vehicle."""
        if reports_breach(text) and not self.testing:
            self._text = text

    def look(self, vehicle: Vehicle, now: float) -> Event | None:
        """The event of a breach that has begun, or is over."""
        if self.testing or not vehicle.connected:
            return None
        if not self._text and self._looked_at is not None and now - self._looked_at < PERIOD_S:
            return None
        self._looked_at, text, self._text = now, self._text, ""
        shown = breach(vehicle, fresh_after=now - FRESH_S)
        if shown is None and not vehicle.armed:
            shown = False
        if shown or text:
            self._inside_since = None
            why = f'it reports "{text}"' if text else "its telemetry shows it"
            return None if self.outside else self._changed(vehicle, f"is outside its fence: {why}", outside=True)
        if not self.outside or shown is None:
            return None
        if self._inside_since is None:
            self._inside_since = now
        if now - self._inside_since < INSIDE_S:
            return None
        return self._changed(vehicle, "is inside its fence again", outside=False)

    def _changed(self, vehicle: Vehicle, text: str, *, outside: bool) -> Event:
        self.outside, self._inside_since = outside, None
        return Event("fence", vehicle.name, vehicle.sysid, text, {"outside": outside})
