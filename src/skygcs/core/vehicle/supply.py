"""The one rule about the supply of a vehicle under way: no judgement about another vehicle cuts it. Pure.

    what feeds it                    what would end it                                       while it may be under way
    ------------------------------   -----------------------------------------------------   ---------------------------
    poses, on the channel that       another autopilot has its ids, on whatever link;        they go on, with an event
    carries them                     another one is heard on its channel; it is not heard
    its channel (a peer of a         silence; another peer needs the place                   it stays
    server)
    its route                        silence; another source needs the place                 it stays
    its entry in the fleet           another vehicle needs the place                         it stays

Each of these asks `may_fly`. What ends them all the same: the channel closes, a person removes the link or forgets the
vehicle, it is heard disarmed, or on the ground unless it drives, or `MAYBE_FLYING_S` of silence. A forged heartbeat
costs places, at most one for each system id, and no flight.
"""

from __future__ import annotations

from skygcs.core.vehicle.vehicle import Vehicle

MAYBE_FLYING_S = 1800.0
"""A vehicle that was lost while armed may still fly for this time; few batteries last longer."""


def may_fly(vehicle: Vehicle, now: float) -> bool:
    """True if it may be under way now, in the air or on the ground, by what was heard of it last: in doubt it is."""
    silence_s = vehicle.silence_s(now)
    if vehicle.replayed or silence_s is None or silence_s >= MAYBE_FLYING_S:
        return False
    return vehicle.under_way(now)
