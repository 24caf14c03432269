"""What a link leaves to setpoints: a radio's share, divided among those it carries; anything else without bound."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Hashable
from typing import Any, cast

import pytest

from skygcs.config.models import FleetConfig, MemoryLinkConfig, SerialLinkConfig
from skygcs.core.radio_link.capacity import FRAME_BYTES
from skygcs.core.radio_link.transmit_queue import Outgoing, Priority
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.links.base import Channel, ChannelSigning
from skygcs.links.memory import MemoryLink
from skygcs.links.serial import SerialLink
from skygcs.runtime.hub import Hub
from skygcs.runtime.link_view import LinkView, LinkWatch
from skygcs.runtime.linktable import LinkTable
from support.frames import frame
from support.routed import DIALECT, heartbeat
from support.services import connect


def flown(sysid: int) -> Vehicle:
    return Vehicle(sysid, 1, DIALECT)


class Mute(Channel):
    """Hears only."""

    def send(self, outgoing: Outgoing, priority: Priority = Priority.FORWARDED, key: Hashable | None = None) -> bool:
        return False


class Air:
    """A hub with radios and other links, and vehicles heard over them; all that ``flown`` names are flown."""

    def __init__(self) -> None:
        self.hub = Hub(FleetConfig(), DIALECT, asyncio.get_running_loop(), lambda event: None)
        connect(self.hub)
        self.vehicles: list[Vehicle] = []

    def radio(self, name: str, baud: int = 57600) -> Channel:
        config = SerialLinkConfig(type="serial", name=name, device="/dev/null", baud=baud, role="radio")
        return self._attached(Mute(SerialLink(config, self.hub, asyncio.get_running_loop()), name))

    def cable(self, name: str) -> Channel:
        config = MemoryLinkConfig(type="memory", name=name)
        return self._attached(Mute(MemoryLink(config, self.hub, asyncio.get_running_loop()), name))

    def _attached(self, channel: Channel) -> Channel:
        self.hub.attach(channel)
        return channel

    def hear(self, channel: Channel, *sysids: int) -> None:
        now = asyncio.get_running_loop().time()
        for sysid in sysids:
            self.hub.on_frames(channel, channel.parser.feed_datagram(heartbeat(sysid)), now)

    def rate_hz(self, sysid: int) -> float:
        view = LinkView(self.hub, cast(LinkTable, None), LinkWatch(self.hub))
        return view.setpoint_bytes_per_s(flown(sysid), lambda: self.vehicles) / FRAME_BYTES["SET_ATTITUDE_TARGET"]


@pytest.mark.parametrize(("count", "rate_hz"), [(1, 28), (2, 14), (3, 9), (9, 3)])
async def test_a_radio_of_57600_baud_is_divided_among_the_vehicles_flown_over_it(count: int, rate_hz: int) -> None:
    air = Air()
    air.hear(air.radio("radio"), *range(1, 12))
    air.vehicles = [flown(sysid) for sysid in range(1, count + 1)]
    assert [math.floor(air.rate_hz(sysid)) for sysid in range(1, count + 1)] == [rate_hz] * count


async def test_before_it_is_flown_a_vehicle_is_told_what_it_will_have() -> None:
    air = Air()
    air.hear(air.radio("radio"), 1, 2, 3)
    air.vehicles = [flown(2), flown(3)]
    before = air.rate_hz(1)
    air.vehicles.append(flown(1))
    assert air.rate_hz(1) == before == pytest.approx(1440 / 51 / 3)


async def test_the_rate_follows_the_baud_and_radios_do_not_share() -> None:
    air = Air()
    air.hear(air.radio("slow"), 1)
    air.hear(air.radio("fast", 115200), 2)
    air.vehicles = [flown(1), flown(2)]
    assert air.rate_hz(1) == pytest.approx(1440 / 51) and air.rate_hz(2) == pytest.approx(2880 / 51)


async def test_a_signature_on_each_setpoint_is_counted() -> None:
    air = Air()
    radio = air.radio("radio")
    air.hear(radio, 1)
    air.vehicles = [flown(1)]
    radio.signing = cast(ChannelSigning, object())
    assert air.rate_hz(1) == pytest.approx(1440 / (51 + 13))


async def test_what_is_no_serial_port_bounds_nothing_nor_does_a_vehicle_nobody_hears() -> None:
    air = Air()
    air.hear(air.cable("wifi"), 1)
    air.vehicles = [flown(1)]
    assert math.isinf(air.rate_hz(1)) and math.isinf(air.rate_hz(77))


def test_the_frame_is_as_long_as_it_is_counted() -> None:
    values: dict[str, Any] = {"type_mask": 7, "q": [0.5] * 4, "thrust": 0.5, "target_system": 1, "target_component": 1}
    assert len(frame("SET_ATTITUDE_TARGET", {**values, "time_boot_ms": 123_456})) == FRAME_BYTES["SET_ATTITUDE_TARGET"]
