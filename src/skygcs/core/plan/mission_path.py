"""QGroundControl's .plan as the path of one vehicle.

    item              what it is to the path
    ---------------   ------------------------------------------------------------------------------------------------
    NAV_TAKEOFF       the first item: the path begins at its height, above its place or the planned home
    NAV_WAYPOINT      a straight leg to it; param1 is the time there, in s
    DO_CHANGE_SPEED   ground speed (type 0 or 1), climb (2) or descent (3) of the legs that follow, within the limits
    NAV_LAND          the last: level to its place, if it has one; the path ends above it
    NAV_RETURN_…      the last: level to above the planned home; the path ends there

Everything else is refused. The path is in the air: take-off and landing are the flight's own, with certificates of
their own. Heights above home are above the planned home. Headings and acceptance radii are not read; a corner is a
stop, as in every path without times.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

from skygcs.core.geo import Origin, enu_from_geodetic
from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.item import GLOBAL, RELATIVE_ALT, MissionItem
from skygcs.core.mission.plan import MissionPlan, PlannedHome
from skygcs.core.mission.qgc import read_qgc
from skygcs.core.plan.file_reading import number_of, refused, require_unique_keys, text_of
from skygcs.core.trajectory import MotionLimits, Piece, Trajectory
from skygcs.core.trajectory.piecewise import MAX_DURATION_S, MIN_PIECE_S, Vector
from skygcs.core.trajectory.timing import hover, path_within
from skygcs.errors import PlanFileError, TrajectoryError

_NAMES = {number: name for name, number in vars(mav_cmd).items() if name.isupper() and isinstance(number, int)}

SPEED_OF_TYPE = {0: "speed_mps", 1: "speed_mps", 2: "climb_mps", 3: "descent_mps"}
"""SPEED_TYPE: airspeed, ground speed, climb, descent. A multicopter takes the first two alike."""

NO_CHANGE, DEFAULT = -1.0, -2.0
"""Values of DO_CHANGE_SPEED that do not give a speed."""


class MissionPath(NamedTuple):
    """``notes``: what was assumed or left out, for people."""

    trajectory: Trajectory
    origin: Origin
    notes: tuple[str, ...]


def read_mission_path(source: str, data: bytes, limits: MotionLimits, origin: Origin | None = None) -> MissionPath:
    """The path about ``origin``, or about the planned home (x east) without one. Raises PlanFileError."""
    text = text_of(source, data)
    require_unique_keys(source, text)
    mission, notes = read_qgc(text, source)
    home = mission.home
    if not mission.mission:
        raise PlanFileError(source, "", "it holds no mission")
    if home is None:
        todo = "save it in QGroundControl with one, or fly it as a mission: `skygcs-cli mission`"
        raise PlanFileError(source, "mission.plannedHomePosition", f"heights are above it, and it is missing; {todo}")
    own = _origin_at(source, home)
    reader = _PathReader(source, own if origin is None else origin, home, limits)
    for number, item in enumerate(mission.mission, 1):
        reader.take(number, item)
    return MissionPath(reader.trajectory(), reader.origin, (*notes, *reader.notes, *_left_out(mission)))


def _origin_at(source: str, home: PlannedHome) -> Origin:
    where = "mission.plannedHomePosition"
    number_of(source, where, "latitude", home.lat_deg, 90.0)
    number_of(source, where, "longitude", home.lon_deg, 180.0)
    number_of(source, where, "altitude", home.alt_amsl_m)
    return Origin(home.lat_deg, home.lon_deg, home.alt_amsl_m)


def _left_out(mission: MissionPlan) -> Iterable[str]:
    yield "take-off and landing are no part of the path"
    if mission.fence.polygons or mission.fence.circles:
        yield "its geofence is not read: give --fence, --ceiling"
    if mission.rally:
        yield "its rally points are not read"


class _PathReader:
    """Takes the items one after the other. All methods raise PlanFileError."""

    def __init__(self, source: str, origin: Origin, home: PlannedHome, limits: MotionLimits) -> None:
        self.origin = origin
        self.notes: list[str] = []
        self._source = source
        self._home = home
        self._limits = limits
        """The given limits; ``_now`` has the speeds that the mission has changed."""
        self._now = limits
        self._legs: list[Vector] = []
        """The points since the last stop that is in `_pieces`, beginning with that place; empty: before the first."""
        self._pieces: list[Piece] = []
        self._ended_by = 0
        """Number of the item after which nothing may come; 0: none yet."""

    def take(self, number: int, item: MissionItem) -> None:
        where = f"item {number}"
        if self._ended_by:
            raise self._not_flown(where, f"comes after item {self._ended_by}, which ends the path")
        match item.command:
            case mav_cmd.NAV_TAKEOFF:
                if self._legs:
                    raise self._not_flown(where, "is a take-off in the middle of the path")
                lat_deg, lon_deg = item.position or (self._home.lat_deg, self._home.lon_deg)
                self._legs = [self._place(where, lat_deg, lon_deg, self._altitude(where, item))]
            case mav_cmd.NAV_WAYPOINT:
                self._waypoint(where, item)
            case mav_cmd.DO_CHANGE_SPEED:
                self._change_speed(where, item)
            case mav_cmd.NAV_LAND | mav_cmd.NAV_RETURN_TO_LAUNCH:
                self._end(number, item)
            case _:
                name = _NAMES.get(item.command, f"command {item.command}")
                raise self._not_flown(
                    where, f"{name} is not a part of a path: it takes off, flies to waypoints and lands"
                )

    def trajectory(self) -> Trajectory:
        """The whole path."""
        if not self._legs:
            raise PlanFileError(self._source, "", "its mission has no take-off and no waypoint")
        self._stop("the end")
        try:
            if not self._pieces:
                return hover(self._legs[0], 1.0)
            return Trajectory(self._pieces)
        except TrajectoryError as error:
            raise refused(self._source, "", error) from None

    def _waypoint(self, where: str, item: MissionItem) -> None:
        if item.position is None:
            raise self._not_flown(where, "has no position")
        self._legs.append(self._place(where, *item.position, self._altitude(where, item)))
        stay_s = number_of(self._source, where, "param1 (time there)", item.params[0] or 0.0, MAX_DURATION_S)
        if stay_s >= MIN_PIECE_S:
            self._stop(where)
            self._pieces += hover(self._legs[-1], stay_s).pieces

    def _change_speed(self, where: str, item: MissionItem) -> None:
        kind, speed_mps = item.params[0], item.params[1]
        key = SPEED_OF_TYPE.get(-1 if kind is None else int(kind))
        if key is None or speed_mps is None or (speed_mps <= 0.0 and speed_mps not in (NO_CHANGE, DEFAULT)):
            raise self._not_flown(where, f"a speed of {speed_mps} of type {kind} is no speed")
        if speed_mps == NO_CHANGE:
            return
        if self._legs:
            self._stop(where)
        most_mps: float = getattr(self._limits, key)
        if speed_mps > most_mps:
            self.notes.append(
                f"{where}: {key.removesuffix('_mps')} of {speed_mps:g} m/s, flown at the limit, {most_mps:g}"
            )
        try:
            self._now = replace(self._now, **{key: most_mps if speed_mps == DEFAULT else min(speed_mps, most_mps)})
        except TrajectoryError as error:
            raise refused(self._source, where, error) from None

    def _end(self, number: int, item: MissionItem) -> None:
        where, self._ended_by = f"item {number}", number
        if not self._legs:
            raise self._not_flown(where, "comes before any take-off or waypoint")
        home = (self._home.lat_deg, self._home.lon_deg)
        place = home if item.command == mav_cmd.NAV_RETURN_TO_LAUNCH else item.position
        if place is not None:
            x, y, _ = self._place(where, *place, self._home.alt_amsl_m)
            self._legs.append((x, y, self._legs[-1][2]))

    def _stop(self, where: str) -> None:
        """Make pieces of the legs up to here."""
        if len(self._legs) < 2:
            return
        try:
            if any(point != self._legs[0] for point in self._legs):
                self._pieces += path_within(self._legs, self._now).pieces
        except TrajectoryError as error:
            raise refused(self._source, f"before {where}", error) from None
        self._legs = self._legs[-1:]

    def _altitude(self, where: str, item: MissionItem) -> float:
        """AMSL."""
        if item.frame not in (GLOBAL, RELATIVE_ALT):
            raise self._not_flown(where, f"its height is in frame {item.frame}, not above sea level or home")
        if item.z is None:
            raise self._not_flown(where, "has no height")
        return item.z + (self._home.alt_amsl_m if item.frame == RELATIVE_ALT else 0.0)

    def _place(self, where: str, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> Vector:
        number_of(self._source, where, "latitude", lat_deg, 90.0)
        number_of(self._source, where, "longitude", lon_deg, 180.0)
        x, y, up = enu_from_geodetic(lat_deg, lon_deg, alt_amsl_m, self.origin)
        for axis, value in (("x", x), ("y", y), ("up", up)):
            number_of(self._source, where, f"{axis} from the origin", value)
        return x, y, up

    def _not_flown(self, where: str, why: str) -> PlanFileError:
        return PlanFileError(self._source, where, f"{why}; fly it as a mission: `skygcs-cli mission`")
