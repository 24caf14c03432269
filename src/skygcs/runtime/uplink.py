"""What a link leaves to setpoints: how many attitude setpoints a second it bears, and whether a stream at all."""

from __future__ import annotations

import math

from skygcs.core.mavlink.header import SIGNATURE_BYTES
from skygcs.core.radio_link.capacity import FRAME_BYTES, OFFBOARD_LOSS_S, OFFBOARD_MIN_HZ
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

SIGNED_SHARE = FRAME_BYTES["SET_ATTITUDE_TARGET"] / (FRAME_BYTES["SET_ATTITUDE_TARGET"] + SIGNATURE_BYTES)
"""What is left where each frame ends in a signature."""

BITS_PER_BYTE = 10
"""8N1: start bit, eight, stop bit."""


GUIDED_MIN_HZ = 1.0
"""ArduPilot stops 3 s after the last position or velocity (field-notes 10.5): two may be lost."""

STREAMED = "SET_POSITION_TARGET_LOCAL_NED"
"""The longest of the setpoints, as long as its GLOBAL_INT sister."""


def stream_refusal(hub: Hub, fleet: Fleet, sysid: int, compid: int, *, px4: bool) -> str | None:
    """Why no stream of setpoints can be kept up to this vehicle over the radio it is behind; None if it can."""
    least_hz = OFFBOARD_MIN_HZ if px4 else GUIDED_MIN_HZ
    needed = least_hz * FRAME_BYTES[STREAMED]
    instead = "; send it places instead (skygcs-cli goto), fly fewer by setpoints, or raise the radio's air speed"
    for channel_id in hub.ways(sysid, compid):
        channel = hub.channels[channel_id]
        air = channel.air
        if air is None:
            continue
        round_s = air.pacer.rates.round_s(air.pacer.vehicles)
        if px4 and round_s is not None and round_s > 1 / OFFBOARD_MIN_HZ:
            return (
                f"the ground's radio sends once a round, every {round_s:.2f} s; PX4 wants setpoints at "
                f"{OFFBOARD_MIN_HZ:g} Hz and leaves OFFBOARD after {OFFBOARD_LOSS_S:g} s without one{instead}"
            )
        share = setpoint_bytes_per_s(hub, fleet, sysid, compid)
        if share < needed:
            return (
                f"the radio leaves {share:.0f} B/s to setpoints for it, and {least_hz:g} Hz of {FRAME_BYTES[STREAMED]} "
                f"bytes are {needed:.0f}{instead}"
            )
    return None


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
