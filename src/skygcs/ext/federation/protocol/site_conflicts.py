"""Conflicts between our vehicles and those of other sites, predicted from what the sites publish. Pure.

The monitor of a daemon (`core.monitor`) compares the vehicles of its own site with each other; this module compares
each vehicle of ours with each vehicle of other sites. It sends no order: both sites report the conflict, and the
operators decide which vehicle gives way.

    level     predicted from the last positions of two vehicles, each continued with its last velocity
    -------   ---------------------------------------------------------------------------------------------------------
    none      neither of the following
    notice    within `HORIZON_S` their distance falls below the margin plus both balls
    warning   within `WARNING_S` their distance falls below the margin

    level     predicted level         for                            -> level
    -------   ---------------------   ----------------------------   --------------------------------------------------
    none      notice or warning       `CONFIRM_S` without a break    the predicted one
    notice    warning                 at once                        warning
    any       below the level         `CLEAR_S` without a break      the predicted one, with a margin wider by a tenth
    any       one is not watched      at once                        none, and an event that says so

The ball of a vehicle is the sphere about the predicted position in which it may be: it grows with the age of the
position, which for a vehicle of another site is the total age, the time in the hub included. Margin, balls and times
are those of the monitor.

    a vehicle that                                 counts as
    --------------------------------------------   --------------------------------------------------------------------
    flies                                          watched against all vehicles of the other side
    is on the ground                               an obstacle at rest for those that fly
    has no position, or one older than `TRACK_SILENT_S`  not watched: it may be anywhere
    is shared, and has the name of the other       the same vehicle, heard by two sites: no pair
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from statistics import median_low
from typing import Any, NamedTuple

from skygcs.core.geo import EnuFrame, Origin, is_on_earth
from skygcs.core.monitor.approach import REST, Approach, Vector, closest_approach
from skygcs.core.monitor.conflict_levels import (
    CLEAR_S,
    CONFIRM_S,
    HORIZON_S,
    HYSTERESIS,
    WARNING_S,
    Level,
    believed_velocity,
)
from skygcs.core.monitor.tracks import TRACK_SILENT_S
from skygcs.core.separation import Footprint, pair_margin, separation_m
from skygcs.events import Event

KIND = "separation"
"""Kind of the events: that of the monitor, with ``site`` in the data."""

MAX_CONFLICTS = 256
"""Pairs that are kept, the most urgent ones: more than a person can read. Further ones are counted."""

PAIRS_A_TURN = 50
"""Pairs compared before other tasks of the loop get their turn: 0.2 ms (measured)."""

FARTHEST_M = 1_000_000.0
"""Largest distance from the middle of our vehicles. A vehicle beyond it cannot come near within `HORIZON_S`, and its
coordinates in a plane about the middle would be meaningless."""

PairKey = tuple[str, str]
"""Name of our vehicle, and name of the other one with its site."""


@dataclass(frozen=True, slots=True)
class SiteVehicle:
    """A vehicle of this or of another site, as the prediction needs it."""

    name: str
    """``alpha`` for a vehicle of ours, ``south/bravo`` for one of another site."""
    lat_deg: float | None
    lon_deg: float | None
    alt_amsl_m: float | None
    vel_enu_mps: Vector | None
    """True east, north, up."""
    age_s: float
    """Age of its position now, the time on the way to this site included."""
    flying: bool
    footprint: Footprint = field(default_factory=Footprint)
    shared: bool = False
    """True if [federation.vehicles] names it: two sites may hear it under the same name."""

    @property
    def short_name(self) -> str:
        """The name without the site."""
        return self.name.rpartition("/")[2]


class _Box(NamedTuple):
    """Where a vehicle may be within the horizon, with its share of the margin; metres of the common frame."""

    low_x: float
    high_x: float
    low_y: float
    high_y: float
    low_z: float
    high_z: float
    ours: bool
    vehicle: SiteVehicle
    place_m: Vector
    velocity_mps: Vector
    ball_m: float


@dataclass(frozen=True, slots=True)
class Prediction:
    """The prediction for a pair now."""

    level: Level
    distance_m: float
    approach: Approach
    margin_m: float
    balls_m: float
    ages_s: tuple[float, float]
    """Ages of the two positions: ours, the other's."""

    def as_dict(self) -> dict[str, Any]:
        """Description for federation.sites and events, JSON-able."""
        enters_s = self.approach.enters_s
        return {
            "distance_m": round(self.distance_m, 2),
            "closest_m": round(self.approach.separation_m, 2),
            "closest_in_s": round(self.approach.at_s, 1),
            "enters_in_s": None if math.isinf(enters_s) else round(enters_s, 1),
            "margin_m": round(self.margin_m, 2),
            "balls_m": round(self.balls_m, 2),
            "ages_s": [round(age_s, 2) for age_s in self.ages_s],
        }


@dataclass(slots=True)
class SiteConflict:
    """A pair with a predicted conflict, also for a short time after the prediction has ended."""

    ours: str
    other: str
    predicted_at: float
    """Since when a conflict is predicted without a break."""
    level: Level = Level.NONE
    prediction: Prediction | None = None
    below_since: float | None = None
    """Since when a lower level than ``level`` is predicted."""

    @property
    def site(self) -> str:
        return self.other.partition("/")[0]

    def advance(self, prediction: Prediction | None, now: float) -> bool:
        """Take in the newest prediction; True if the level changed."""
        if prediction is not None and self.prediction is None:
            self.predicted_at = now
        self.prediction = prediction
        reached = Level.NONE if prediction is None else prediction.level
        if self.level is Level.NONE and now - self.predicted_at < CONFIRM_S:
            return False
        if reached >= self.level:
            self.below_since = None
        elif self.below_since is None:
            self.below_since = now
        if reached == self.level or (self.below_since is not None and now - self.below_since < CLEAR_S):
            return False
        self.level, self.below_since = reached, None
        return True

    @property
    def over(self) -> bool:
        return self.prediction is None and self.level is Level.NONE

    def describe(self) -> dict[str, Any]:
        """Description for federation.sites and events, JSON-able."""
        predicted = {} if self.prediction is None else self.prediction.as_dict()
        return {"vehicles": [self.ours, self.other], "site": self.site, "level": self.level.name.lower(), **predicted}

    def text(self) -> str:
        """A sentence for a person."""
        names, known = f"{self.ours} and {self.other}", self.prediction
        if known is None or self.level is Level.NONE:
            return f"{names} are clear of each other"
        age = f"the position of {self.other} is {known.ages_s[1]:.1f} s old"
        if known.approach.separation_m >= known.margin_m:
            return f"{names} may come near each other: {age}"
        if known.distance_m < known.margin_m:
            return (
                f"{names} are {known.distance_m:.1f} m apart, less than their margin of {known.margin_m:.1f} m; {age}"
            )
        return (
            f"{names} will come {known.approach.separation_m:.1f} m near each other in {known.approach.at_s:.0f} s "
            f"(margin {known.margin_m:.1f} m); {age}"
        )


@dataclass(slots=True)
class Counters:
    """Counts since the process began."""

    evaluations: int = 0
    pairs_checked: int = 0
    pairs_dropped: int = 0
    """Pairs beyond `MAX_CONFLICTS`."""
    notices: int = 0
    warnings: int = 0


class SiteConflicts:
    """Call `evaluate` about once a second, and take ``events`` after it."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.counters = Counters()
        self.watched = 0
        """Vehicles of other sites that were watched at the last evaluation."""
        self._conflicts: dict[PairKey, SiteConflict] = {}

    def evaluate(self, ours: Iterable[SiteVehicle], others: Iterable[SiteVehicle], now: float) -> Iterator[None]:
        """Predict all pairs and advance their levels. Yields between slices so that other tasks can run; the result is
        complete when it is exhausted."""
        ours, others = [v for v in ours if _watched(v)], [v for v in others if _watched(v)]
        self.watched = len(others)
        found: dict[PairKey, Prediction] = {}
        if ours and others:
            boxes: list[_Box] = []
            yield from _place(ours, others, boxes)
            yield from self._sweep(boxes, found)
        names = {v.name for v in ours}, {v.name for v in others}
        for key, prediction in _most_urgent(found).items():
            conflict = self._conflicts.get(key)
            if conflict is None:
                if len(self._conflicts) >= MAX_CONFLICTS:
                    self.counters.pairs_dropped += 1
                    continue
                conflict = self._conflicts[key] = SiteConflict(*key, now)
            self._step(conflict, prediction, now)
        self.counters.pairs_dropped += max(len(found) - MAX_CONFLICTS, 0)
        for key, conflict in list(self._conflicts.items()):
            if key[0] not in names[0] or key[1] not in names[1]:
                self._end(key, conflict, key[0] if key[0] not in names[0] else key[1])
            elif key not in found:
                self._step(conflict, None, now)
            if conflict.over:
                self._conflicts.pop(key, None)
        self.counters.evaluations += 1

    def conflicts(self) -> list[SiteConflict]:
        """The conflicts that have a level, the most urgent first."""
        rated = [conflict for conflict in self._conflicts.values() if conflict.level is not Level.NONE]
        return sorted(rated, key=lambda one: (-one.level, _enters_s(one.prediction)))

    def _sweep(self, boxes: list[_Box], found: dict[PairKey, Prediction]) -> Iterator[None]:
        """Sweep along x: only boxes that overlap in x are compared, one of ours with one of another site."""
        boxes.sort(key=lambda box: box.low_x)
        active: tuple[list[_Box], list[_Box]] = ([], [])
        """Boxes of ours, and of other sites, that may overlap with the following ones."""
        looked = 0
        for box in boxes:
            against = active[box.ours]
            against[:] = [other for other in against if other.high_x >= box.low_x]
            for other in against:
                looked += 1
                if looked % PAIRS_A_TURN == 0:
                    yield
                if not _overlap(box, other):
                    continue
                mine, theirs = (box, other) if box.ours else (other, box)
                key = mine.vehicle.name, theirs.vehicle.name
                known = self._conflicts.get(key)
                widened = HYSTERESIS if known is not None and known.level is not Level.NONE else 1.0
                self.counters.pairs_checked += 1
                prediction = _predict(mine, theirs, widened)
                if prediction is not None:
                    found[key] = prediction
            active[not box.ours].append(box)

    def _step(self, conflict: SiteConflict, prediction: Prediction | None, now: float) -> None:
        if conflict.advance(prediction, now):
            self.counters.notices += conflict.level is Level.NOTICE
            self.counters.warnings += conflict.level is Level.WARNING
            self._report(conflict, conflict.text())

    def _end(self, key: PairKey, conflict: SiteConflict, gone: str) -> None:
        """End a pair whose vehicle ``gone`` is not watched any more; the two may still be close to each other."""
        del self._conflicts[key]
        if conflict.level is Level.NONE:
            return
        conflict.level, conflict.prediction = Level.NONE, None
        self._report(conflict, f"{conflict.ours} and {conflict.other} are not watched any more: {gone} cannot be")

    def _report(self, conflict: SiteConflict, text: str) -> None:
        self.events.append(Event(KIND, conflict.ours, None, text, conflict.describe()))


def _watched(vehicle: SiteVehicle) -> bool:
    """True if the position is known. A vehicle on the ground may be silent: it stays an obstacle until its site forgets
    it."""
    numbers = (vehicle.lat_deg, vehicle.lon_deg, vehicle.alt_amsl_m)
    if any(number is None or not math.isfinite(number) for number in numbers):
        return False
    lat_deg, lon_deg, alt_m = (number or 0.0 for number in numbers)
    possible = is_on_earth(lat_deg, lon_deg, alt_m)
    return possible and not (vehicle.flying and not 0.0 <= vehicle.age_s <= TRACK_SILENT_S)


def _place(ours: list[SiteVehicle], others: list[SiteVehicle], boxes: list[_Box]) -> Iterator[None]:
    """Append the box of each vehicle to ``boxes``, in true ENU about the middle of ours. The middle is a median, so
    that one wrong position does not move it."""
    lat_deg = median_low(v.lat_deg or 0.0 for v in ours)
    lon_deg = median_low(v.lon_deg or 0.0 for v in ours)
    frame = EnuFrame(Origin(lat_deg, lon_deg, 0.0))
    ratio = max(v.footprint.downwash_ratio for v in (*ours, *others))
    for n, vehicle in enumerate((*ours, *others)):
        if n % PAIRS_A_TURN == PAIRS_A_TURN - 1:
            yield
        box = _box(vehicle, frame, ratio, ours=n < len(ours))
        if math.hypot(*box.place_m) <= FARTHEST_M:
            boxes.append(box)


def _box(vehicle: SiteVehicle, frame: EnuFrame, ratio: float, *, ours: bool) -> _Box:
    x, y, z = frame.from_geodetic(vehicle.lat_deg or 0.0, vehicle.lon_deg or 0.0, vehicle.alt_amsl_m or 0.0)
    velocity, ball_m = REST, 0.0
    if vehicle.flying:
        if vehicle.vel_enu_mps is not None and all(map(math.isfinite, vehicle.vel_enu_mps)):
            velocity = vehicle.vel_enu_mps
        age_s = vehicle.age_s
        ball_m = vehicle.footprint.ball_m(age_s)
        x, y, z = x + velocity[0] * age_s, y + velocity[1] * age_s, z + velocity[2] * age_s
    footprint = vehicle.footprint
    reach_m = (footprint.wingspan_m / 2 + footprint.position_error_m) * HYSTERESIS + ball_m
    ends = [end + rate * HORIZON_S for end, rate in zip((x, y, z), velocity, strict=True)]
    return _Box(
        min(x, ends[0]) - reach_m,
        max(x, ends[0]) + reach_m,
        min(y, ends[1]) - reach_m,
        max(y, ends[1]) + reach_m,
        min(z, ends[2]) - reach_m * ratio,
        max(z, ends[2]) + reach_m * ratio,
        ours,
        vehicle,
        (x, y, z),
        velocity,
        ball_m,
    )


def _overlap(a: _Box, b: _Box) -> bool:
    """True if two boxes that overlap in x are a pair. Two vehicles on the ground, or one vehicle heard by two sites,
    are no pair."""
    return (
        a.low_y <= b.high_y
        and b.low_y <= a.high_y
        and a.low_z <= b.high_z
        and b.low_z <= a.high_z
        and (a.vehicle.flying or b.vehicle.flying)
        and not (a.vehicle.shared and b.vehicle.shared and a.vehicle.short_name == b.vehicle.short_name)
    )


def _predict(mine: _Box, theirs: _Box, widened: float) -> Prediction | None:
    """The prediction for two vehicles; None: no conflict within `HORIZON_S`. ``widened``: factor of the margin."""
    margin = pair_margin(mine.vehicle.footprint, theirs.vehicle.footprint)
    ratio, certain_m, balls_m = margin.downwash_ratio, margin.total_m * widened, mine.ball_m + theirs.ball_m
    p, q = mine.place_m, theirs.place_m
    offset = (q[0] - p[0], q[1] - p[1], (q[2] - p[2]) / ratio)
    velocity = believed_velocity(mine.velocity_mps, theirs.velocity_mps, ratio)
    approach = closest_approach(offset, velocity, certain_m + balls_m, HORIZON_S)
    if math.isinf(approach.enters_s):
        return None
    certain = closest_approach(offset, velocity, certain_m, HORIZON_S)
    level = Level.WARNING if certain.enters_s <= WARNING_S else Level.NOTICE
    ages_s = mine.vehicle.age_s, theirs.vehicle.age_s
    shown = approach._replace(enters_s=certain.enters_s)
    return Prediction(level, separation_m(*offset, 1.0), shown, margin.total_m, balls_m, ages_s)


def _enters_s(prediction: Prediction | None) -> float:
    return math.inf if prediction is None else prediction.approach.enters_s


def _most_urgent(found: dict[PairKey, Prediction]) -> dict[PairKey, Prediction]:
    """The `MAX_CONFLICTS` most urgent predictions."""
    if len(found) <= MAX_CONFLICTS:
        return found
    items = heapq.nsmallest(MAX_CONFLICTS, found.items(), key=lambda item: (-item[1].level, _enters_s(item[1])))
    return dict(items)
