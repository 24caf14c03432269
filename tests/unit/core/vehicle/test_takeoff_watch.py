"""Verdicts about a take-off that was ordered here, by what the vehicle shows."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.takeoff_watch import TakeoffWatch, WrongHeight, reports_takeoff
from skygcs.core.vehicle.vehicle import Vehicle
from support.table import each
from support.vehicles import ARDUPILOT, HOME, PX4, PX4_LOITER, Voice, flight_dialect

DECODER = Decoder(flight_dialect())
PX4_TAKEOFF, PX4_RTL = 4 << 16 | 2 << 24, 4 << 16 | 5 << 24
GUIDED, PLANE_TAKEOFF, RTL = 4, 13, 6
ON_GROUND, IN_AIR, TAKEOFF = 1, 2, 3
NOW = 100.0
COPTER, PLANE = (PX4, 2), (PX4, 1)
ARDUCOPTER, ARDUPLANE = (ARDUPILOT, 2), (ARDUPILOT, 1)


class Climb:
    """A take-off to ``height_m`` from HOME's altitude, ordered at NOW; `show` is what the vehicle says and the verdict
    then."""

    def __init__(self, kind: tuple[int, int], height_m: float = 10.0) -> None:
        (self.autopilot, self.type), self.now = kind, NOW
        self.voice = Voice(1)
        self.vehicle = Vehicle(1, 1, flight_dialect(), decoder=DECODER)
        plane = self.type == 1
        self.mode = PX4_TAKEOFF if self.autopilot == PX4 else PLANE_TAKEOFF if plane else GUIDED
        self.say()
        if self.autopilot == ARDUPILOT and plane:
            self.hear(mav.MAVLink_param_value_message(b"Q_ENABLE", 0.0, 9, 900, 1))
        self.watch = TakeoffWatch(self.vehicle, HOME[2], height_m, NOW)

    def hear(self, message: mav.MAVLink_message) -> None:
        self.vehicle.on_frame(self.voice.say(message), self.now)

    def say(
        self,
        up_m: float | None = None,
        climb_mps: float = 1.0,
        *,
        state: int = IN_AIR,
        armed: bool = True,
        status: int = 4,
    ) -> None:
        beat = self.voice.beat(self.autopilot, self.mode, armed=armed, status=status, kind=self.type)
        self.vehicle.on_frame(beat, self.now)
        self.vehicle.on_frame(self.voice.landed(state), self.now)
        if up_m is not None:
            velocity = (0, 0, -round(climb_mps * 100))
            frame = self.voice.position(alt_amsl_m=HOME[2] + up_m, rel_m=up_m, velocity=velocity)
            self.vehicle.on_frame(frame, self.now)

    def show(self, at_s: float, *shown: Any, **more: Any) -> Any:
        """The verdict ``at_s`` after the order, with this said then."""
        self.now = NOW + at_s
        self.say(*shown, **more)
        return self.watch.look(self.now)


@each(
    ("kind", "height_m", "up_m", "climb_mps", "verdict"),
    [
        # copters: SHORT_M or a tenth below it, level; above it OVER_M and a twentieth
        (ARDUCOPTER, 10.0, 9.4, 0.0, "climbs"),
        (ARDUCOPTER, 10.0, 9.6, 0.0, "reached"),
        (ARDUCOPTER, 10.0, 9.6, 0.3, "reached"),
        (ARDUCOPTER, 10.0, 9.6, 0.5, "climbs"),
        (ARDUCOPTER, 10.0, 10.4, -0.5, "climbs"),
        (ARDUCOPTER, 2.0, 1.7, 0.0, "climbs"),
        (ARDUCOPTER, 2.0, 1.85, 0.0, "reached"),
        (ARDUCOPTER, 10.0, 11.4, 0.0, "reached"),
        (ARDUCOPTER, 10.0, 11.6, 1.0, "wrong"),
        (ARDUCOPTER, 100.0, 105.9, 1.0, "climbs"),
        (ARDUCOPTER, 100.0, 106.1, 1.0, "wrong"),
        (COPTER, 10.0, 10.0, 0.0, "climbs"),  # in AUTO.TAKEOFF still
        # planes: 3 m below it, level or not; 20 m above
        (ARDUPLANE, 50.0, 46.5, 2.0, "climbs"),
        (ARDUPLANE, 50.0, 47.5, 2.0, "reached"),
        (ARDUPLANE, 50.0, 72.0, 2.0, "reached"),
        (ARDUPLANE, 50.0, 73.0, 2.0, "wrong"),
        (ARDUPLANE, 20.0, 17.9, 2.0, "climbs"),
    ],
)
def test_its_height_and_its_climb_decide(
    kind: tuple[int, int], height_m: float, up_m: float, climb_mps: float, verdict: str
) -> None:
    climb = Climb(kind, height_m)
    found = climb.show(3.0, up_m, climb_mps)
    if verdict == "wrong":
        assert found == WrongHeight(found.height_m, height_m) and abs(found.height_m - up_m) < 0.01
        assert str(found) == f"it is {up_m:.1f} m above the ground it stood on; {height_m:.1f} m were ordered"
    else:
        assert found == verdict


@each(
    ("kind", "change", "said"),
    [
        (ARDUCOPTER, {"armed": False}, "it was disarmed"),
        (ARDUCOPTER, {"status": 5}, "its own failsafe is active"),
        (ARDUCOPTER, {"state": ON_GROUND}, "it is on the ground again"),
        (ARDUCOPTER, {"mode": RTL}, "its mode became RTL"),
        (COPTER, {"mode": PX4_RTL}, "its mode became AUTO.RTL"),
        (ARDUPLANE, {"mode": 11}, "its mode became RTL"),
        (ARDUPLANE, {"mode": 15}, "its mode became GUIDED"),
        (ARDUCOPTER, {}, "climbs"),
        (COPTER, {}, "climbs"),
        (COPTER, {"mode": PX4_LOITER}, "climbs"),  # the last part of its climb
    ],
)
def test_what_somebody_else_decides_disturbs_it(kind: tuple[int, int], change: dict[str, Any], said: str) -> None:
    climb = Climb(kind)
    assert climb.show(3.0, 2.0) == "climbs"
    climb.mode = change.get("mode", climb.mode)
    shown = {name: value for name, value in change.items() if name != "mode"}
    assert climb.show(4.0, 3.0, **shown) == said


def test_one_that_is_still_on_the_ground_is_no_landing_and_one_that_is_not_heard_is_lost() -> None:
    climb = Climb(ARDUCOPTER)
    for at_s in (1.0, 12.0):
        assert climb.show(at_s, 0.0, 0.0, state=ON_GROUND) == "climbs"
    climb.vehicle.disconnect()
    assert climb.watch.look(climb.now) == "the vehicle was lost"


def test_it_has_the_time_of_the_slowest_climb() -> None:
    """SPOOL_S, and its height at SLOWEST_MPS."""
    climb = Climb(ARDUCOPTER, 6.0)
    up_m = 0.0
    for at_s in range(1, 40):
        up_m += 0.1
        verdict = climb.show(float(at_s), up_m, 0.1)
        assert verdict == "climbs", at_s
    assert climb.show(40.0, up_m + 0.1, 0.1) == "climbs"
    assert climb.show(40.2, up_m + 0.3, 0.1) == "it did not reach its height in time"


@each(("kind", "settle_s"), [(ARDUCOPTER, 5.0), (ARDUPLANE, 20.0)])
def test_one_that_stops_climbing_goes_to_a_wrong_height(kind: tuple[int, int], settle_s: float) -> None:
    climb = Climb(kind, 30.0)
    assert climb.show(1.0, 4.0) == "climbs"
    assert climb.show(2.0, 4.1) == "climbs"  # RISE_M less: no climb
    assert climb.show(1.0 + settle_s, 4.1) == "climbs"
    found = climb.show(1.1 + settle_s, 4.15)
    assert isinstance(found, WrongHeight)
    assert str(found) == "it stopped climbing 4.1 m above the ground it stood on; 30.0 m were ordered"
    assert climb.show(2.0 + settle_s, 4.3) == "climbs"
    assert climb.show(6.9 + settle_s, 4.3) == "climbs"


def test_what_it_did_while_its_position_was_old_is_not_known() -> None:
    climb = Climb(ARDUCOPTER)
    assert climb.show(1.0, 4.0) == "climbs"
    assert climb.show(4.0) == "climbs"  # as old as FRESH_S
    for at_s in (4.5, 8.0, 11.0):
        assert climb.show(at_s) == "climbs"
    assert climb.show(11.5, 4.0) == "climbs"  # from now on it counts again
    assert climb.show(16.5, 4.0) == "climbs"
    assert isinstance(climb.show(16.6, 4.0), WrongHeight)
    old = Climb(ARDUCOPTER)
    assert old.show(1.0, 30.0) != "climbs"
    assert old.show(4.1) == "climbs", "too high was 3.1 s ago"


def test_a_px4_that_loiters_below_its_height_has_five_seconds_for_the_rest() -> None:
    climb = Climb(COPTER)
    assert climb.show(3.0, 8.0) == "climbs"
    climb.mode = PX4_LOITER
    assert climb.show(4.0, 9.0, 0.3) == "climbs"
    assert climb.show(9.0, 9.3, 0.0) == "climbs"
    assert climb.show(9.1, 9.4, 0.0) == "its mode became AUTO.LOITER below its height"
    climb.mode = PX4_TAKEOFF
    assert climb.show(9.2, 9.4, 0.3) == "climbs"
    climb.mode = PX4_LOITER
    assert climb.show(10.0, 9.45, 0.0) == "climbs", "it counts from now on"
    assert climb.show(10.5, 9.6, 0.0) == "reached"


def test_its_progress_is_a_text() -> None:
    climb = Climb(ARDUCOPTER, 5.0)
    assert climb.watch.progress() == "0.0 of 5.0 m"
    climb.show(1.0, 1.2)
    assert climb.watch.progress() == "1.2 of 5.0 m"
    climb.show(1.0, -0.4)
    assert climb.watch.progress() == "0.0 of 5.0 m"


@each(
    ("kind", "mode", "state", "armed", "reports"),
    [
        (COPTER, PX4_TAKEOFF, ON_GROUND, True, True),
        (COPTER, PX4_TAKEOFF, ON_GROUND, False, False),
        (COPTER, PX4_LOITER, IN_AIR, True, False),
        (ARDUCOPTER, GUIDED, TAKEOFF, True, True),
        (ARDUCOPTER, GUIDED, TAKEOFF, False, False),
        (ARDUCOPTER, GUIDED, IN_AIR, True, False),
    ],
)
def test_a_take_off_that_any_program_ordered_is_reported(
    kind: tuple[int, int], mode: int, state: int, armed: bool, reports: bool
) -> None:
    climb = Climb(kind)
    climb.mode = mode
    climb.say(state=state, armed=armed)
    assert reports_takeoff(climb.vehicle, climb.now) is reports
