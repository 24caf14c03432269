"""A serial port: a radio, a telemetry cable, a pty."""

from __future__ import annotations

import asyncio
import termios
from functools import partial
from itertools import cycle

import serial

from skygcs.config import models
from skygcs.config.radio import radio_rates
from skygcs.errors import LinkError
from skygcs.links.base import Channel, Link, LinkHost
from skygcs.links.paced import third_party_rules
from skygcs.links.serial_port import BITS_PER_BYTE, bytes_outstanding, discard, explain, open_port, read_means_data
from skygcs.links.stream import StreamChannel, WriteLimits

TRY_BAUD_S = 5.0
"""How long one rate of a list is tried: five heartbeats of a vehicle at 1 Hz (mavlink-router takes the same time)."""


class SerialLink(Link):
    """One serial port, one channel. ``baud`` is the rate in use; of a list, the one that worked stays first."""

    config: models.SerialLinkConfig

    def __init__(self, config: models.SerialLinkConfig, host: LinkHost, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(config, host, loop)
        self._rates = (config.baud,) if isinstance(config.baud, int) else config.baud
        self.baud = self._rates[0] if self._rates else 0
        self._port: serial.Serial | None = None
        self._channel: StreamChannel | None = None
        self._scan: asyncio.TimerHandle | None = None

    @property
    def bytes_per_s(self) -> float:
        return self.baud / BITS_PER_BYTE

    @property
    def channels(self) -> list[Channel]:
        return [self._channel] if self._channel is not None else []

    async def open(self) -> None:
        if not self._rates:
            raise LinkError(f"serial {self.config.device}: the list of baud rates is empty")
        config = self.config
        port = open_port(config.device, self.baud, rtscts=config.rtscts, low_latency=config.low_latency)
        self._port = port
        fd = port.fileno()
        try:
            self._channel = StreamChannel(
                self,
                self.config.device,
                fd,
                self._on_broken,
                WriteLimits(partial(bytes_outstanding, fd), self.baud / BITS_PER_BYTE),
                radio=radio_rates(self.config, self.baud) if self.config.role == "radio" else None,
                third_party=third_party_rules(self.config.third_party, self.host.dialect),
            )
            self.host.attach(self._channel)
        except BaseException:
            await self.close()
            raise
        if len(self._rates) > 1:
            first = self._rates.index(self.baud)
            following = cycle(self._rates[first + 1 :] + self._rates[: first + 1])
            self._scan = self.loop.call_later(TRY_BAUD_S, self._try_next_baud, following)

    async def close(self) -> None:
        if self._scan is not None:
            self._scan.cancel()
            self._scan = None
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()
            self.host.detach(channel, self.why_closed)
        port, self._port = self._port, None
        if port is not None:
            discard(port)

    def _on_broken(self, channel: StreamChannel, reason: str) -> None:
        if channel is self._channel:
            self.fail(f"serial {self.config.device}: {reason}; unplugged, or its power went")

    def _try_next_baud(self, following: cycle[int]) -> None:
        """No good frame at this rate so far: take the next one of the list; after one, stay."""
        self._scan = None
        port, channel = self._port, self._channel
        if port is None or channel is None or channel.parser.stats.good:
            return
        baud = next(following)
        try:
            port.baudrate = baud
            read_means_data(port.fileno())
        except (OSError, ValueError, termios.error) as error:
            self.fail(f"serial {self.config.device}: {explain(error, self.config.device, baud)}")
            return
        self.baud = baud
        channel.bytes_per_s = baud / BITS_PER_BYTE
        if channel.air is not None:
            channel.air.set_baud(baud, self.loop.time())
        self._scan = self.loop.call_later(TRY_BAUD_S, self._try_next_baud, following)
