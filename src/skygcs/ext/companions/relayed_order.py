"""One order that the ground relays to a companion: asked until it is answered, or given up as unknown. Pure.

    state      what happens                                              next       what is done
    --------   -------------------------------------------------------   --------   ----------------------------------
    asking     the companion answers                                     answered   its outcome counts
    asking     no answer in time, or the connection broke                asking     asked again, with the same number
    asking     a pilot took the vehicle that it is to engage             asking     asked with a deadline that is over
    asking     the companion has restarted since                         unknown    nothing: its book is lost
    asking     patience is over                                          unknown    nothing
    any        a newer order replaced it on the ground                   unknown    nothing

To ask again is harmless: the companion's book (`order_book`) carries each number out once, and none after its deadline.
"Unknown" is what is left when no answer came at all: the order may have been carried out. It is never given again under
another number.
"""

from __future__ import annotations

from dataclasses import dataclass

from skygcs.core.protocols.command import Outcome

LEAST_REPEAT_S = 0.3
"""On a fast link: three intervals of Wi-Fi power saving (0.1 s beacons)."""

MOST_REPEAT_S = 3.0

REPEAT_TRIPS = 1.25
"""An answer is overdue after so many round trips (95th percentile)."""


@dataclass(frozen=True, slots=True)
class RelayedOrder:
    """``start_by``: it must reach the companion by then; ``give_up_at``: the ground waits no longer for the answer.
    Both on the ground's clock."""

    number: int
    session: str
    start_by: float
    give_up_at: float

    def wait_s(self, now: float, round_trip_s: float | None) -> float | None:
        """How long to wait for the answer before it is asked again; None: patience is over."""
        left_s = self.give_up_at - now
        if left_s <= 0.0:
            return None
        trip_s = MOST_REPEAT_S if round_trip_s is None else round_trip_s
        return min(max(REPEAT_TRIPS * trip_s, LEAST_REPEAT_S), MOST_REPEAT_S, left_s)


def unknown(why: str, elapsed_s: float) -> Outcome:
    """The outcome of an order that was not answered."""
    text = f"its outcome is not known: {why}; look at the vehicle before you repeat it"
    return Outcome(False, "timeout", text, elapsed_s=elapsed_s)
