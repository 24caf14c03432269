"""Which vehicles may be in the air, so that nothing that feeds them ends."""

from __future__ import annotations

from skygcs.core.vehicle.flight_evidence import MAYBE_FLYING_S, may_fly
from support.table import each
from support.watched_fleet import ACTIVE, STANDBY, WatchedVehicle


@each(
    ("armed", "status", "silent_s", "flies"),
    [
        (True, ACTIVE, 0.5, True),
        (True, ACTIVE, 600.0, True),
        (True, ACTIVE, MAYBE_FLYING_S, False),
        (True, STANDBY, 0.5, False),
        (False, STANDBY, 0.5, False),
    ],
)
def test_it_may_fly_until_it_is_known_not_to(armed: bool, status: int, silent_s: float, flies: bool) -> None:
    one = WatchedVehicle(1)
    one.heartbeat(10.0, armed=armed, status=status)
    one.vehicle.tick(10.0 + silent_s)
    assert may_fly(one.vehicle, 10.0 + silent_s) is flies


def test_one_that_was_never_heard_does_not() -> None:
    assert not may_fly(WatchedVehicle(1).vehicle, 10.0)
