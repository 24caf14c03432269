"""When a vehicle is outside its autopilot's fence: by its telemetry, and by its texts where it sends no more."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.vehicle.fence_params import FRESH_S, INSIDE_S, PERIOD_S, FenceWatch
from skygcs.core.vehicle.vehicle import Vehicle
from support.vehicles import ARDUPILOT, PX4, Voice, flight_dialect

GEOFENCE = mav.MAV_SYS_STATUS_GEOFENCE


class Rig:
    """A vehicle whose fence is looked at four times a second, as long as it is heard."""

    def __init__(self, autopilot: int) -> None:
        self.vehicle, self.voice, self.watch, self.now = Vehicle(1, 1, flight_dialect()), Voice(1), FenceWatch(), 100.0
        self.autopilot = autopilot

    def run(self, seconds: float, *, fence: bool | None = None, armed: bool = True) -> list[tuple[float, bool]]:
        """What it reports in that time. ``fence``: what SYS_STATUS shows, once a second; None: nothing of it."""
        found = []
        for step in range(round(4 * seconds)):
            self.now += 0.25
            if step % 4 == 0:
                base_mode = 0x81 if armed else 0x01
                self.hear(mav.MAVLink_heartbeat_message(2, self.autopilot, base_mode, 0, 4, 3))
                shown, health = (0, 0) if fence is None else (GEOFENCE, 0 if fence else GEOFENCE)
                self.hear(mav.MAVLink_sys_status_message(shown, shown, health, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0))
            self.vehicle.tick(self.now)
            if (event := self.watch.look(self.vehicle, self.now)) is not None:
                assert event.kind == "fence" and event.data == {"outside": self.watch.outside}
                found.append((self.now, self.watch.outside))
        return found

    def hear(self, message: mav.MAVLink_message) -> None:
        self.vehicle.on_frame(self.voice.say(message), self.now)


def test_a_breach_of_the_telemetry_begins_once_and_ends_when_it_is_over_for_a_while() -> None:
    rig = Rig(ARDUPILOT)
    assert rig.run(10, fence=False) == []
    began = rig.now
    ((at, outside),) = rig.run(10, fence=True)
    assert outside and at - began <= PERIOD_S
    assert rig.run(INSIDE_S - 1, fence=False) == [], "at the border it is inside by turns"
    assert rig.run(5, fence=True) == []
    over = rig.now
    ((at, outside),) = rig.run(10, fence=False)
    assert not outside and INSIDE_S <= at - over <= INSIDE_S + 2 * PERIOD_S


def test_a_text_is_believed_at_once_and_telemetry_that_is_older_does_not_end_it() -> None:
    rig = Rig(ARDUPILOT)
    rig.run(5, fence=False)
    rig.watch.on_text("Circle fence breached")
    assert [outside for _, outside in rig.run(1, fence=False)] == [True]
    assert rig.run(5, fence=True) == []
    assert [outside for _, outside in rig.run(10, fence=False)] == [False]


def test_a_px4_whose_telemetry_has_no_fence_is_outside_until_it_is_disarmed() -> None:
    rig = Rig(PX4)
    rig.watch.on_text("Geofence violation: approaching or outside geofence")
    assert [outside for _, outside in rig.run(2)] == [True]
    assert rig.run(60) == []
    assert [outside for _, outside in rig.run(10, armed=False)] == [False]
    for text in ("Fence breach cleared", "Reposition is outside geofence", "PreArm: no fence"):
        rig.watch.on_text(text)
    assert rig.run(5) == []


def test_of_one_that_is_lost_nothing_changes() -> None:
    rig = Rig(ARDUPILOT)
    rig.run(5, fence=True)
    for _ in range(100):
        rig.now += 1.0
        rig.vehicle.tick(rig.now)
        assert rig.watch.look(rig.vehicle, rig.now) is None
    assert rig.watch.outside and rig.now - 100.0 > FRESH_S
