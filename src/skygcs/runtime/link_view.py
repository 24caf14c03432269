"""Quality of the links per vehicle: losses, signal, and the bytes per second available for setpoints."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass

from skygcs.core.mavlink.frame import SIGNATURE_BYTES, Frame
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.radio_link.capacity import (
    FRAME_BYTES,
    HALF_DUPLEX_SHARE,
    OFFBOARD_LOSS_S,
    OFFBOARD_MIN_HZ,
    SETPOINT_SHARE,
    setpoint_bytes_per_s,
)
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.routing.source_statistics import LinkFacts, LossWindow
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.links.base import Channel
from skygcs.runtime.hub import Hub
from skygcs.runtime.linktable import LinkTable
from skygcs.runtime.signing_keys import why_silent

DB_PER_COUNT = 1 / 1.9
"""Scale of a SiK radio's rssi and noise: dBm = count / 1.9 - 127 (SiK's documentation of RADIO_STATUS)."""

RADIO_FRESH_S = 10.0
"""A radio reports once a second while it hears the other end."""

HEARD_S = 3.0
"""Three heartbeats: a link over which a vehicle was not heard for so long does not carry it."""

UNKNOWN = 255
"""UINT8_MAX: invalid or unknown (common.xml)."""

SERIAL_SHARE = HALF_DUPLEX_SHARE * SETPOINT_SHARE
"""Share of a serial link's bytes per second for the setpoints of all vehicles behind it. A half-duplex radio shares the
air between both directions: half of it is used by the fleet's telemetry (field-notes 10.2), the rest by commands and
ground stations. At 57600 baud 1440 B/s: 28 attitude setpoints of 51 B a second, or 25 beside five pings, for one
vehicle or several together."""

SIGNED_SHARE = FRAME_BYTES["SET_ATTITUDE_TARGET"] / (FRAME_BYTES["SET_ATTITUDE_TARGET"] + SIGNATURE_BYTES)
"""Share left for the frame itself if each frame carries a signature."""

GUIDED_MIN_HZ = 1.0
"""ArduPilot stops 3 s after the last position or velocity (field-notes 10.5): two may be lost."""

STREAMED = "SET_POSITION_TARGET_LOCAL_NED"
"""The longest setpoint, with the length of SET_POSITION_TARGET_GLOBAL_INT."""


@dataclass(slots=True)
class _Radio:
    margin_db: float
    at: float


class LinkWatch:
    """Call `tick` once a second and `on_radio` for every RADIO_STATUS. It has at most as many entries as the hub
    sources."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._losses: dict[tuple[int, int], LossWindow] = {}
        self._radios: dict[int, _Radio] = {}

    def tick(self, now: float) -> None:
        """Sample the counters of every source of every channel."""
        seen: dict[tuple[int, int], LossWindow] = {}
        for channel_id, channel in self._hub.channels.items():
            for key, stats in channel.sources.items():
                window = self._losses.get((channel_id, key)) or LossWindow()
                window.sample(stats.frames, stats.lost, now)
                seen[channel_id, key] = window
        self._losses = seen
        self._radios = {n: radio for n, radio in self._radios.items() if n in self._hub.channels}

    def on_radio(self, frame: Frame, channel: Channel, now: float) -> None:
        """A radio at our end reports on both ends; a recorded one is ignored."""
        if channel.config.type == "replay":
            return
        if channel.air is not None:
            channel.air.on_radio(frame, channel.tx_bytes, now)
        fields = frame.fields()
        ends = [(fields["rssi"], fields["noise"]), (fields["remrssi"], fields["remnoise"])]
        margins = [(rssi - noise) * DB_PER_COUNT for rssi, noise in ends if 0 < rssi < UNKNOWN and noise < UNKNOWN]
        if margins:
            self._radios[channel.id] = _Radio(min(margins), now)

    def of(self, key: int, now: float) -> dict[str, LinkFacts]:
        """By link, how well a vehicle (sysid << 8 | compid) is heard; on a link with several peers by the one that
        supplies its state."""
        facts: dict[str, LinkFacts] = {}
        for channel_id in self._hub.router.channels_of(key):
            link = self._hub.channels[channel_id].link.name
            if link in facts:
                continue
            window, radio = self._losses.get((channel_id, key)), self._radios.get(channel_id)
            facts[link] = LinkFacts(
                loss=None if window is None else window.loss(),
                frames=0 if window is None else window.frames(),
                margin_db=None if radio is None or now - radio.at > RADIO_FRESH_S else radio.margin_db,
            )
        return facts


class LinkView:
    """The fleet's view of the links; implements `vehicle_services.VehicleLinks`."""

    def __init__(self, hub: Hub, links: LinkTable, watch: LinkWatch) -> None:
        self._hub = hub
        self._links = links
        self._watch = watch
        self.taken_bytes_per_s: Callable[[int], float] = lambda channel_id: 0.0
        """Returns the bytes a second that extensions send on a channel; setpoints share the rest."""

    def facts(self, key: int, now: float) -> dict[str, LinkFacts]:
        """See `LinkWatch.of`."""
        return self._watch.of(key, now)

    def is_replayed(self, key: int) -> bool:
        """True if this source (sysid << 8 | compid) exists only in a recording."""
        return key in self._hub.replayed

    def channels_to(self, vehicle: Vehicle) -> tuple[int, ...]:
        """See `Hub.channels_to`."""
        return self._hub.channels_to(vehicle.sysid, vehicle.compid)

    def holds(self, vehicle: Vehicle, priority: Priority, key: Hashable) -> bool:
        """See `VehicleLinks.holds`."""
        channels = self._hub.channels
        return any(channels[i].holds(priority, vehicle.sysid, key) for i in self.channels_to(vehicle))

    def links_to(self, vehicle: Vehicle) -> frozenset[str]:
        """Names of the links over which this vehicle was heard less than HEARD_S ago."""
        self._hub.flows.take()
        since, ids = self._links.now() - HEARD_S, (vehicle.sysid, vehicle.compid)
        heard = (
            n for sysid, compid, n, at in self._hub.router.table.routes() if (sysid, compid) == ids and at >= since
        )
        return frozenset(self._hub.channels[n].link.name for n in heard if n in self._hub.channels)

    def uplink_lost(self, key: int) -> None:
        """See `SourceSelection.uplink_lost`."""
        self._hub.router.selection.uplink_lost(key)

    def counts_on(self, key: int, channel_id: int) -> Mapping[int, int] | None:
        """Frames of a vehicle on one channel by message id; None: it is heard on one channel only."""
        state = self._hub.router.state_sources.get(key)
        return None if state is None else state.counts(channel_id)

    def forget_flows(self) -> None:
        """See `Flows.forget`."""
        self._hub.flows.forget()

    def authority_refusal(self, sysid: int) -> str | None:
        """See `SendGates.refusal`."""
        gates = self._hub.send_gates
        return None if gates is None else gates.refusal(sysid, self._hub.boot_clock())

    def may_broadcast(self) -> bool:
        """False if a link drops frames of some sources: a vehicle whose frames are dropped would still hear us. False,
        too, where an extension gates a vehicle: it would take the order that is for others."""
        return self._hub.send_gates is None and not any(
            link.enabled
            and (link.allow_src_sys_in or link.block_src_sys_in or link.allow_src_comp_in or link.block_src_comp_in)
            for link in self._links.configs.values()
        )

    def radio_to(self, vehicle: Vehicle) -> str | None:
        """The name of a radio link that leads to this vehicle; None if no link that it is heard on is a radio."""
        for channel_id in self._hub.channels_to(vehicle.sysid, vehicle.compid):
            channel = self._hub.channels[channel_id]
            if channel.air is not None or channel.config.role == "radio":
                return channel.link.name
        return None

    def why_silent(self, vehicle: Vehicle) -> str:
        """Why a vehicle that is heard may not answer: the end of a sentence, or ""."""
        slot = vehicle.slots.get(HEARTBEAT)
        links = [self._hub.channels[i].config for i in self._hub.channels_to(vehicle.sysid, vehicle.compid)]
        return why_silent(None if slot is None else slot.frame, links)

    def stream_refusal(self, vehicle: Vehicle, flown: Callable[[], Iterable[Vehicle]]) -> str | None:
        """Why this vehicle's radio cannot carry a stream of setpoints; None if it can."""
        px4 = vehicle.family == "px4"
        least_hz = OFFBOARD_MIN_HZ if px4 else GUIDED_MIN_HZ
        needed = least_hz * FRAME_BYTES[STREAMED]
        instead = (
            "; use goto instead (skygcs-cli goto), fly fewer vehicles by setpoints, or raise the radio's air speed"
        )
        for channel_id in self._hub.channels_to(vehicle.sysid, vehicle.compid):
            # only radios are narrow
            air = self._hub.channels[channel_id].air
            if air is None:
                continue
            # PX4 leaves OFFBOARD between two rounds of a slow multipoint radio
            round_s = air.pacer.rates.round_s(air.pacer.vehicles)
            if px4 and round_s is not None and round_s > 1 / OFFBOARD_MIN_HZ:
                return (
                    f"the ground's radio sends once a round, every {round_s:.2f} s; PX4 wants setpoints at "
                    f"{OFFBOARD_MIN_HZ:g} Hz and leaves OFFBOARD after {OFFBOARD_LOSS_S:g} s without one{instead}"
                )
            # or the share of the radio is too small
            share = self.setpoint_bytes_per_s(vehicle, flown)
            if share < needed:
                return (
                    f"the radio leaves {share:.0f} B/s to setpoints for it, and {least_hz:g} Hz of "
                    f"{FRAME_BYTES[STREAMED]} bytes are {needed:.0f}{instead}"
                )
        return None

    def setpoint_bytes_per_s(self, vehicle: Vehicle, flown: Callable[[], Iterable[Vehicle]]) -> float:
        """This vehicle's share of the narrowest channel that leads to it; infinite where none is serial or a radio."""
        ids = (vehicle.sysid, vehicle.compid)
        least = math.inf
        for channel_id in self._hub.channels_to(*ids):
            channel = self._hub.channels[channel_id]
            link = channel.link
            if channel.air is not None and channel.air.queue.budget is not None:
                uplink, share = channel.air.queue.budget.rate, SETPOINT_SHARE
            elif link.bytes_per_s is not None:
                uplink, share = link.bytes_per_s, SERIAL_SHARE
            else:
                continue
            if channel.signing is not None:
                share *= SIGNED_SHARE
            # a link's rate is shared by all its channels, a radio's budget is the channel's own
            sharing = {channel_id} if channel.air is not None else {channel_id, *(c.id for c in link.channels)}
            others = sum(
                not sharing.isdisjoint(self._hub.channels_to(other.sysid, other.compid))
                for other in flown()
                if (other.sysid, other.compid) != ids
            )
            taken = self.taken_bytes_per_s(channel_id)
            least = min(least, setpoint_bytes_per_s(uplink, taken, others + 1, share))
        return least
