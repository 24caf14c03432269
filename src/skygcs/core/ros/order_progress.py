"""Orders of one vehicle as goals of actions: their parameters, how far they are, and why they end. Pure.

A goal is under way from the daemon's acceptance of its order until one of these:

    it has arrived                                             succeeded
    a newer order was accepted, whoever gave it                aborted
    its mode is another than the order's, or it was disarmed   aborted: a transmitter, or a failsafe
    flight control leads it elsewhere                          aborted: setpoints, a trajectory
    it comes no nearer for STALLED_S                           aborted: something that nobody reported keeps it
    it is not heard, or the daemon is silent for SILENT_S      aborted

The daemon reports each order's outcome as an event of kind command, the goal's own, too; that one is expected once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.ros.action_goals import ABORTED, SUCCEEDED

Order = Literal["goto", "takeoff", "land"]

ACTIONS: Mapping[Order, str] = {
    "goto": "skygcs_msgs/action/Goto",
    "takeoff": "skygcs_msgs/action/Takeoff",
    "land": "skygcs_msgs/action/Land",
}
"""The action of each order, whose name it has below a vehicle's namespace."""

MODES: Mapping[Order, frozenset[str]] = {
    "goto": frozenset({"AUTO.LOITER", "GUIDED", "OFFBOARD"}),
    "takeoff": frozenset({"AUTO.TAKEOFF", "AUTO.VTOL_TAKEOFF", "AUTO.LOITER", "GUIDED", "OFFBOARD"}),
    "land": frozenset({"AUTO.LAND", "AUTO.PRECLAND", "LAND", "QLAND", "SURFACE", "AUTO"}),
}
"""Modes in which the order is carried out."""

MOVING = frozenset(
    {"mode", "disarm", "takeoff", "land", "rtl", "hold", "goto", "reboot", "stop", "control", "release", "mission"}
)
"""Orders that replace the one before: those of the daemon's order runner."""

FRAME_MAP, FRAME_GEODETIC = 0, 1

ARRIVED_M = 2.0
"""Distance of arrival where a goal gives none: a receiver's noise, and an ArduCopter's WPNAV_RADIUS."""

SMALLEST_TOLERANCE_M, LARGEST_TOLERANCE_M = 0.2, 100.0

HEIGHT_SHARE = 0.1
"""Share of a take-off's height that may be missing at its end; half a metre at least."""

SLOW_MPS = 0.7
"""It stays there: faster than a vehicle drifts that holds."""

SETTLE_S = 3.0
"""From the acceptance until states show the order's mode: a vehicle behind a radio reports it once a second."""

STALLED_S = 30.0
NEARER_M = 0.5
"""Progress below this in STALLED_S counts as no progress."""

SILENT_S = 3.0
"""Without a state of the vehicle, which is sent five times a second."""

OLD_S = 3.0
"""An older position is not used."""

ASTRAY_M = 2.0
"""Flight control's reference leads elsewhere when it is so much farther from the place than it was."""

MOST_OUTCOMES = 8
"""Outcomes of other orders that are kept while one is not answered; the newest decide."""

GROUND_S = 10.0
"""On the ground, still armed: landed."""

Fields = Mapping[str, Any]


class GoalError(ValueError):
    """Why a goal is not an order, for the log."""


class End(NamedTuple):
    """How a goal has ended: its GoalStatus, and why."""

    status: int
    reason: str


def order_params(order: Order, goal: Fields) -> dict[str, Any]:
    """The parameters of the daemon's method, vehicles.goto, takeoff or land. Raises GoalError."""
    if order == "land":
        return {}
    if order == "takeoff":
        height_m = _finite(goal["height_m"], "height_m")
        if height_m < 0:
            raise GoalError("height_m is below the ground")
        return {"height_m": height_m or None, "arm": goal["arm"]}
    tolerance_m(goal)
    place: dict[str, Any] = {}
    if goal["use_heading"]:
        place["yaw_deg"] = _finite(goal["heading_deg"], "heading_deg")
    if goal["frame"] == FRAME_MAP:
        return place | {"enu_m": [_finite(goal["position"][axis], f"position.{axis}") for axis in "xyz"]}
    if goal["frame"] != FRAME_GEODETIC:
        raise GoalError(f"frame {goal['frame']} is neither FRAME_MAP nor FRAME_GEODETIC")
    if goal["use_height"]:
        place["height_m"] = _finite(goal["height_m"], "height_m")
    return place | {name: _finite(goal[name], name) for name in ("lat_deg", "lon_deg")}


def tolerance_m(goal: Fields) -> float:
    """The distance at which a goto has arrived. Raises GoalError."""
    given = _finite(goal["tolerance_m"], "tolerance_m") or ARRIVED_M
    if not SMALLEST_TOLERANCE_M <= given <= LARGEST_TOLERANCE_M:
        raise GoalError(f"tolerance_m is not from {SMALLEST_TOLERANCE_M} to {LARGEST_TOLERANCE_M}, or 0")
    return given


def _finite(value: float, name: str) -> float:
    if not math.isfinite(value):
        raise GoalError(f"{name} is not finite")
    return float(value)


class OrderProgress:
    """One order, from before it is sent. `accepted`, then `on_state` and `on_event` as they come, `on_time` some times
    a second; the first End that one of them returns is the goal's."""

    def __init__(self, order: Order, goal: Fields, state: Fields, takeoff_height_m: float | None = None) -> None:
        """``state``: of the vehicle, as the daemon sent it last. ``takeoff_height_m``: where a take-off gives none.
        Raises GoalError."""
        # what is shown
        self.order = order
        self.distance_m = math.nan
        """To the place, or of height; NaN: not known."""
        self.height_m = math.nan
        # where it begins and where it is to end
        self._vehicle: str = state["name"]
        self._state = state
        self._begin_m = _number((state.get("position") or {}).get("alt_rel_m"))
        self._tolerance_m = ARRIVED_M
        self._rise_m = math.nan
        self._placed = False
        """A position has come since the acceptance."""
        self._present_m = math.nan
        """The height that a goto without one keeps: that of its execution, which may follow a take-off."""
        self._place_m: list[float] | None = None
        """A goto's place in the frame map; None: it is given otherwise."""
        # measure of what is left, by order
        self._measure: Callable[[Fields], float] = lambda position: max(self.height_m, 0.0)
        if order == "goto":
            self._tolerance_m = tolerance_m(goal)
            self._measure = self._goto(goal)
        elif order == "takeoff":
            self._rise_m = goal["height_m"] or takeoff_height_m or math.nan
            self._measure = lambda position: max(self._rise_m - self.height_m, 0.0)
        # the order's acceptance and its end
        self._outcomes: list[str] = []
        """Orders that were accepted since this one was sent, until its own outcome is known."""
        self._own_due = 0
        """Own outcomes that are still to come: 0 after SETTLE_S, when it was lost."""
        self._accepted_at = math.inf
        self._heard_at = -math.inf
        self._mode_seen = self._was_armed = False
        self._nearest_m, self._nearest_at = math.inf, -math.inf
        self._reference_m = math.inf
        self._grounded_at: float | None = None

    def feedback(self) -> dict[str, Any]:
        """Fields of the action's feedback."""
        return {"distance_m": self.distance_m, "height_m": self.height_m}

    def result(self, end: End) -> dict[str, Any]:
        """Fields of the action's result."""
        left = {"goto": {"distance_m": self.distance_m}, "takeoff": {"height_m": self.height_m}, "land": {}}
        return {"ok": end.status == SUCCEEDED, "reason": end.reason, **left[self.order]}

    # -- what ends it

    def accepted(self, now: float) -> End | None:
        """The daemon has accepted the order."""
        self._accepted_at = self._heard_at = self._nearest_at = now
        own = self._outcomes.count(self.order)
        self._own_due = 1 - min(own, 1)
        if own > 1 or (own and self._outcomes[-1] != self.order):
            return End(ABORTED, f"replaced: {self._outcomes[-1]} was ordered at the same time")
        return None

    def on_event(self, event: Fields) -> End | None:
        """An event of the daemon, of any vehicle, of kind command."""
        data = event.get("data") or {}
        mine = event.get("vehicle") == self._vehicle
        if (event.get("dropped") or (mine and data.get("withheld"))) and self._accepted_at < math.inf:
            return End(ABORTED, "outcomes of orders came too fast to be followed")
        order = data.get("order")
        if not mine:
            return None
        if order not in MOVING or not data.get("ok"):
            return None
        if self._accepted_at == math.inf:
            self._outcomes = [*self._outcomes[1 - MOST_OUTCOMES :], order]
            return None
        if self._own_due and order == self.order:
            self._own_due = 0
            return None
        return End(ABORTED, f"replaced: {order} was ordered")

    def on_time(self, now: float) -> End | None:
        """Return how the goal ended by its time limits; call this a few times a second."""
        if now - self._accepted_at > SETTLE_S:
            self._own_due = 0
        if now - self._heard_at > SILENT_S:
            return End(ABORTED, f"the daemon reports no state of it for {SILENT_S:g} s")
        if now - self._nearest_at > STALLED_S:
            return End(ABORTED, f"it came no nearer for {STALLED_S:g} s; it was not stopped")
        return None

    def on_state(self, state: Fields, now: float) -> End | None:
        """A state of the vehicle that came after the acceptance."""
        self._state, self._heard_at = state, now
        if not state.get("connected"):
            return End(ABORTED, "the vehicle is not heard")
        self._take_position(now)
        return self._arrived(now) or self._changed(now)

    # -- private

    def _take_position(self, now: float) -> None:
        position = self._state.get("position") or {}
        known = _number(position.get("age_s")) <= OLD_S
        self.height_m = self._height(position) if known else math.nan
        if known and not self._placed:
            self._placed, self._present_m = True, self.height_m
        self.distance_m = self._measure(position) if known else math.nan
        # ground may lie below home: a landing goes on there, although its distance is 0
        left_m = self.height_m if self.order == "land" else self.distance_m
        if left_m < self._nearest_m - NEARER_M:
            self._nearest_m, self._nearest_at = left_m, now

    def _height(self, position: Fields) -> float:
        above_home_m = _number(position.get("alt_rel_m"))
        if self.order != "takeoff":
            return above_home_m
        above_ground_m = _number(position.get("alt_takeoff_m"))
        return above_home_m - self._begin_m if math.isnan(above_ground_m) else above_ground_m

    def _arrived(self, now: float) -> End | None:
        """None: it is still under way, or its mode is not known to be the order's."""
        if self.order == "land":
            return self._landed(now)
        if not self._in_mode():
            return None
        speed_mps = math.hypot(*map(_number, (self._state.get("position") or {}).get("vel_enu_mps") or (math.nan,)))
        if self.order == "goto":
            near = self.distance_m <= self._tolerance_m and speed_mps <= SLOW_MPS
        elif math.isnan(self._rise_m):  # the fleet file's height, which is not known here
            near = self._state.get("landed") == "in_air" and speed_mps <= SLOW_MPS
        else:
            near = self.distance_m <= max(HEIGHT_SHARE * self._rise_m, 0.5) and self._state.get("landed") == "in_air"
        return End(SUCCEEDED, "arrived") if near else None

    def _landed(self, now: float) -> End | None:
        if self._state.get("landed") != "on_ground":
            self._grounded_at = None
            return None
        if not self._state.get("armed"):
            return End(SUCCEEDED, "landed and disarmed")
        if self._grounded_at is None:
            self._grounded_at = now
        return End(SUCCEEDED, "landed, still armed") if now - self._grounded_at >= GROUND_S else None

    def _changed(self, now: float) -> End | None:
        """Why it is not this order any more by which it flies."""
        settled = now - self._accepted_at > SETTLE_S
        if self._in_mode():
            self._mode_seen = True
        elif self._mode_seen or settled:
            return End(ABORTED, f"replaced: its mode is {self._state.get('mode')}")
        armed = bool(self._state.get("armed"))
        if not armed and (self._was_armed or settled):
            return End(ABORTED, "it was disarmed")
        self._was_armed = armed
        return self._astray() if self.order == "goto" else None

    def _astray(self) -> End | None:
        """Why flight control, which moves its reference to a goto's place, leads it elsewhere."""
        control = self._state.get("control") or {}
        if control.get("state") not in ("engaging", "flying"):
            return None
        if control.get("trajectory") is not None:
            return End(ABORTED, "replaced: it follows a trajectory")
        reference = (control.get("reference") or {}).get("pos_enu_m") or ()
        if None in reference:
            return End(ABORTED, "replaced: it is flown by setpoints")
        if len(reference) != 3 or self._place_m is None:
            return None
        away_m = math.dist(reference, self._place_m)
        if away_m > self._reference_m + ASTRAY_M:
            return End(ABORTED, "replaced: setpoints lead elsewhere")
        self._reference_m = min(self._reference_m, away_m)
        return None

    def _in_mode(self) -> bool:
        return self._state.get("mode") in MODES[self.order]

    def _goto(self, goal: Fields) -> Callable[[Fields], float]:
        """The distance to a goto's place from a position group."""
        if goal["frame"] == FRAME_MAP:
            place = self._place_m = [goal["position"][axis] for axis in "xyz"]
            return lambda position: math.dist(position["enu_m"], place) if position.get("enu_m") else math.nan
        given_m = goal["height_m"] if goal["use_height"] else None
        frame = EnuFrame(Origin(goal["lat_deg"], goal["lon_deg"], 0.0))

        def measure(position: Fields) -> float:
            lat_deg, lon_deg = position.get("lat_deg"), position.get("lon_deg")
            if lat_deg is None or lon_deg is None:
                return math.nan
            east_m, north_m, _ = frame.from_geodetic(lat_deg, lon_deg, 0.0)
            height_m = self._present_m if given_m is None else given_m
            return math.hypot(east_m, north_m, height_m - _number(position.get("alt_rel_m")))

        return measure


def _number(value: Any) -> float:
    """A number of a state; NaN if it is not known."""
    return math.nan if value is None else float(value)
