"""Sights of a flight's vehicles."""

from __future__ import annotations

from skygcs.ext.plans.flight.sights import Departure, DepartureCause, Measurement
from support.table import each

PILOT = Departure(DepartureCause.PILOT, "it was switched to POSCTL")
GUARD = Departure(DepartureCause.GUARD, "the guard holds it")
SEEN = Measurement((0.0, 0.0, 5.0))


@each(
    ("sight", "left", "taken", "piloted"),
    [
        (SEEN, None, False, False),
        (SEEN, PILOT, True, True),
        (SEEN._replace(holds=True), PILOT, False, False),
        (SEEN._replace(by_failsafe=True), PILOT, True, False),  # it was not landed with the others, and sank
        (SEEN, GUARD, False, False),
        (SEEN._replace(unexpected_mode="POSCTL"), None, False, True),
        (SEEN._replace(unexpected_mode="POSCTL", by_failsafe=True), None, False, False),
    ],
)
def test_one_that_somebody_else_flies_is_not_landed_and_one_in_a_failsafe_is(
    sight: Measurement, left: Departure | None, taken: bool, piloted: bool
) -> None:
    assert (sight.taken(left), sight.piloted(left)) == (taken, piloted)
