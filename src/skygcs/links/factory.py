"""From a link's configuration to the link. Kinds are imported when first used: most fleets have two or three."""

from __future__ import annotations

import asyncio
from typing import assert_never

from skygcs.config import models
from skygcs.links.base import Link, LinkHost


def make_link(config: models.LinkConfig, host: LinkHost, loop: asyncio.AbstractEventLoop) -> Link:
    """The link of this configuration, not yet open."""
    match config:
        case models.SerialLinkConfig():
            from skygcs.links.serial import SerialLink

            return SerialLink(config, host, loop)
        case models.XBeeLinkConfig():
            from skygcs.links.xbee import XBeeLink

            return XBeeLink(config, host, loop)
        case models.UdpServerLinkConfig():
            from skygcs.links.udp import UdpServerLink

            return UdpServerLink(config, host, loop)
        case models.UdpClientLinkConfig():
            from skygcs.links.udp import UdpClientLink

            return UdpClientLink(config, host, loop)
        case models.UdpBroadcastLinkConfig():
            from skygcs.links.udp import UdpBroadcastLink

            return UdpBroadcastLink(config, host, loop)
        case models.TcpServerLinkConfig():
            from skygcs.links.tcp import TcpServerLink

            return TcpServerLink(config, host, loop)
        case models.TcpClientLinkConfig():
            from skygcs.links.tcp import TcpClientLink

            return TcpClientLink(config, host, loop)
        case models.ReplayLinkConfig():
            from skygcs.links.replay import ReplayLink

            return ReplayLink(config, host, loop)
        case models.MemoryLinkConfig():
            from skygcs.links.memory import MemoryLink

            return MemoryLink(config, host, loop)
        case models.SimulatedLinkConfig():
            from skygcs.links.simulated import SimulatedVehiclesLink

            return SimulatedVehiclesLink(config, host, loop)
        case _:
            assert_never(config)
