"""The flights of one vehicle: begun when it is armed, ended when it is disarmed or no longer recorded. Pure."""

from __future__ import annotations

import math

from skygcs.ext.logs.curves import Curve, Track
from skygcs.ext.logs.flight import VehicleFlight
from skygcs.ext.logs.report.day_figures import Drawing, FlightFigures

MOST_FLIGHTS = 300
"""Those of one vehicle on one day that are kept; further ones are counted."""

TRACK_POINTS = 500
CURVE_BUCKETS = 150
"""A panel of the page is some 330 dots wide; each bucket has up to four points."""

STEP_M = 0.5
"""A shorter step is noise of the receiver: a vehicle that hovers has flown nowhere."""

LONGEST_DARK_S = 60.0
"""A vehicle that was armed, was not heard for longer, and is armed again may have flown twice."""


LOCAL = "LOCAL_POSITION_NED"
POSITIONS = frozenset({"GLOBAL_POSITION_INT", LOCAL, "GPS_RAW_INT"})
BATTERIES = frozenset({"SYS_STATUS", "BATTERY_STATUS"})


class DrawingRoom:
    """How many more flights of all vehicles keep their lines: some 30 kB each."""

    def __init__(self, most: int) -> None:
        self._left = most

    def take(self) -> bool:
        """True if there is room for one more, which is taken."""
        self._left -= 1
        return self._left >= 0


class FlightBook:
    """`step` after every frame of the vehicle that `RecordedFlight` has taken; `close` at the end of a recording."""

    def __init__(self, room: DrawingRoom) -> None:
        self._room = room
        self.flights: list[FlightFigures] = []
        self.left_out = 0
        self._open: _OpenFlight | None = None
        self._armed_before: bool | None = None

    def step(self, now: float, vehicle: VehicleFlight, message: str) -> None:
        """A frame of this message came at ``now``, by the clock of the vehicle's own times."""
        armed = vehicle.armed
        if self._open is not None and (not armed or now - self._open.last_s > LONGEST_DARK_S):
            self._finish(whole=not armed)
        if self._open is None and armed and message == "HEARTBEAT":  # after a dark time it may be disarmed
            self._open = _OpenFlight(now, begun=self._armed_before is False)
        if self._open is not None:
            self._open.step(now, vehicle)
            if message in POSITIONS:
                self._open.placed(now, vehicle)
            elif message in BATTERIES:
                self._open.charged(now, vehicle)
        self._armed_before = armed

    def close(self) -> None:
        """The recording ends here; what is still armed is a flight that is not whole."""
        self._finish(whole=False)
        self._armed_before = None

    @property
    def in_air(self) -> bool:
        """True if the vehicle flew at the last step."""
        return self._open is not None and self._open.in_air

    def _finish(self, whole: bool) -> None:
        flight, self._open = self._open, None
        if flight is None or not flight.air_s:
            return
        if len(self.flights) < MOST_FLIGHTS:
            self.flights.append(flight.figures(len(self.flights) + 1, whole, drawn=self._room.take()))
        else:
            self.left_out += 1


class _OpenFlight:
    """A flight that goes on."""

    def __init__(self, now: float, begun: bool) -> None:
        self.begin_s = self.last_s = now
        self.begun = begun
        """False if it was armed already when it was first heard."""
        self.in_air = False
        self.air_s = 0.0
        self._distance_m = 0.0
        self._highest_m = -math.inf
        self._place: tuple[float, float, float] | None = None
        self._place_by = ""
        """The message that the path is made of, as `VehicleFlight.place`."""
        self._track = Track(TRACK_POINTS)
        self._height, self._percent, self._volts = (Curve(CURVE_BUCKETS) for _ in range(3))
        self._first_percent = self._last_percent = math.nan
        self._least_volts = math.inf

    def step(self, now: float, vehicle: VehicleFlight) -> None:
        if self.in_air:
            self.air_s += now - self.last_s
        self.in_air = vehicle.in_air(now)
        self.last_s = now

    def placed(self, now: float, vehicle: VehicleFlight) -> None:
        """A position has come: `VehicleFlight` has it as the end of its track."""
        if vehicle.place != self._place_by:
            self._begin_path(vehicle.place)
        height_m, ends = vehicle.altitude.newest, vehicle.track.ends
        if height_m is not None:
            self._height.add(now, height_m)
            self._highest_m = max(self._highest_m, height_m)
        if ends is None:
            return
        place = (*ends[1], height_m or 0.0)
        self._track.add(now, *ends[1])
        step_m = math.inf if self._place is None else math.dist(self._place, place)
        if self._place is None or step_m >= STEP_M:
            self._distance_m += 0.0 if self._place is None else step_m
            self._place = place

    def _begin_path(self, by: str) -> None:
        """A better message than before has come: the path begins anew, as places of the two differ. What was counted
        in a vehicle's own frame is dropped."""
        if self._place_by == LOCAL:
            self._distance_m, self._highest_m = 0.0, -math.inf
            self._height = Curve(CURVE_BUCKETS)
        self._place, self._place_by = None, by
        self._track = Track(TRACK_POINTS)

    def charged(self, now: float, vehicle: VehicleFlight) -> None:
        """Take in a battery message."""
        percent, volts = vehicle.percent.newest, vehicle.volts.newest
        if percent is not None:
            self._percent.add(now, percent)
            self._first_percent = percent if math.isnan(self._first_percent) else self._first_percent
            self._last_percent = percent
        if volts is not None:
            self._volts.add(now, volts)
            self._least_volts = min(self._least_volts, volts)

    def figures(self, number: int, whole: bool, *, drawn: bool) -> FlightFigures:
        return FlightFigures(
            number=number,
            begin_s=self.begin_s,
            end_s=self.last_s,
            air_s=self.air_s,
            distance_m=self._distance_m if self._place is not None else math.nan,
            highest_m=self._highest_m if math.isfinite(self._highest_m) else math.nan,
            first_percent=self._first_percent,
            last_percent=self._last_percent,
            least_volts=self._least_volts if math.isfinite(self._least_volts) else math.nan,
            whole=whole and self.begun,
            drawing=self._drawing() if drawn else None,
        )

    def _drawing(self) -> Drawing:
        return Drawing(self._track.line(), self._height.points(), self._percent.points(), self._volts.points())
