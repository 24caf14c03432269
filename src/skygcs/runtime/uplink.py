"""What a link leaves to setpoints: the number from which a vehicle's rate of attitude setpoints is bounded."""

from __future__ import annotations

import math

from skygcs.links.serial import SerialLink
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub

SETPOINT_SHARE = 0.25
"""Of a serial link's bytes per second, for the setpoints of all vehicles behind it. A half-duplex radio shares its air
between both directions: half of it is the fleet's telemetry (field-notes 10.2), commands and ground stations have the
rest. At 57600 baud 1440 B/s: 28 attitude setpoints of 51 B a second, for one vehicle or divided among several."""

BUDGET_SHARE = 0.5
"""Of what goes up into a radio at all, where that is known better than from the serial rate: its timeslots, its own
reports. Without them it is the same number, for half of the serial rate is the way up."""

SIGNED_SHARE = 51 / 64
"""What is left where each frame ends in a signature of 13 bytes."""

BITS_PER_BYTE = 10
"""8N1: start bit, eight, stop bit."""


def setpoint_bytes_per_s(hub: Hub, fleet: Fleet, sysid: int, compid: int) -> float:
    """Of the narrowest channel on the way to this vehicle, its part; infinite where none is serial or into a radio."""
    least = math.inf
    for channel_id in hub.ways(sysid, compid):
        channel = hub.channels[channel_id]
        link = channel.link
        if channel.air is not None and channel.air.queue.budget is not None:
            setpoints = BUDGET_SHARE * channel.air.queue.budget.bytes_per_s
        elif isinstance(link, SerialLink):
            setpoints = SETPOINT_SHARE * link.baud / BITS_PER_BYTE
        else:
            continue
        if channel.signing is not None:
            setpoints *= SIGNED_SHARE
        others = sum(
            channel_id in hub.ways(actor.sysid, actor.compid)
            for actor in fleet.flown()
            if (actor.sysid, actor.compid) != (sysid, compid)
        )
        least = min(least, setpoints / (others + 1))
    return least
