"""The daemon's end of an emulated radio network: a serial port in the loop's time, paced or not as a real one is."""

from __future__ import annotations

import asyncio
from collections.abc import Hashable
from typing import TYPE_CHECKING

from skygcs.config.radio import EmulatedRadio, RadioKeys
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.radio_link.capacity import BITS_PER_BYTE
from skygcs.core.radio_link.pacing import RadioRates
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.links.base import Link, Outgoing
from skygcs.links.paced import third_party_rules
from skygcs.links.queued import QueuedChannel
from skygcs.sim.radio_fleet import RadioFleet
from skygcs.sim.rng import Rng
from skygcs.sim.tdm import GROUND, TdmConfig, TdmNetwork
from skygcs.sim.vehicle import SimVehicle

if TYPE_CHECKING:
    from skygcs.config import models

SHALLOW_BYTES = 256
"""As much is in the port's buffer at most, as of a real one (`links.stream`)."""

KERNEL_BYTES = 4096
"""What a port takes at once from somebody who does not look."""


def emulated(
    config: EmulatedRadio, vehicles: list[SimVehicle], dialect: Dialect, *, seed: int, now: float
) -> RadioFleet:
    """A network with a radio at each vehicle and one at the ground. Raises ValueError if there are fewer nodes."""
    nodes = len(vehicles) + 1
    if config.nodes is not None and config.nodes < nodes:
        raise ValueError(f"radio.nodes is {config.nodes}: {len(vehicles)} vehicles and the ground are {nodes}")
    tdm = TdmConfig(
        max(config.nodes or nodes, 2),
        config.air_kbps,
        config.baud,
        config.loss,
        config.burst_loss,
        config.burst_s,
        rtscts=config.rtscts,
        distances_m=config.distances_m,
    )
    return RadioFleet(vehicles, TdmNetwork(tdm, dialect, Rng(seed), now), dialect)


def rates_of(link: models.SimulatedLink) -> RadioRates:
    """What the daemon may know of the radio at its port: what the keys of a serial link would say."""
    assert link.radio is not None
    air = link.radio.air_kbps if link.air_speed_kbps is None else link.air_speed_kbps
    return RadioRates(link.radio.baud, air, link.nodes or link.radio.nodes, link.duty_cycle, link.uplink_share)


class SimulatedRadioChannel(QueuedChannel):
    """The port of the ground's radio. Of role "radio" it is paced; else it is written to as fast as it takes."""

    def __init__(self, link: Link, peer: str, air: RadioFleet, baud: int, rates: RadioRates | None) -> None:
        keys = link.config if rates is not None and isinstance(link.config, RadioKeys) else None
        third_party = None if keys is None else third_party_rules(keys.third_party, link.host.dialect)
        super().__init__(link, peer, rates, third_party)
        self._radio: RadioFleet | None = air
        self._byte_s = BITS_PER_BYTE / baud
        self._limit = SHALLOW_BYTES if rates is not None else KERNEL_BYTES
        self._loop = link.loop
        self._timer: asyncio.TimerHandle | None = None
        if self.air is not None:
            self.air.on_due = lambda: link.loop.call_soon(self._pump)  # not amid what came

    def send(self, outgoing: Outgoing, priority: Priority = Priority.FORWARDED, key: Hashable | None = None) -> bool:
        if self._radio is None:
            self.tx_dropped += 1
            return False
        taken = self._offer(outgoing, priority, self._loop.time(), key)
        self._pump()
        return taken

    def close(self) -> None:
        """Nothing is sent after this. Idempotent."""
        self._radio = None
        self.tx_dropped += self._line.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _pump(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        while self._radio is not None:
            now = self._loop.time()
            held = self._radio.network.backlog_bytes(GROUND, now)
            if held >= self._limit or not self._radio.network.has_room(GROUND, SHALLOW_BYTES):
                if self._line:
                    self._later(now + max(self._limit / 2 * self._byte_s, 0.002))
                return
            popped = self._pop(now)
            if popped is None:
                at = self._line.next_send_time(now)
                if at is not None:
                    self._later(at)
                return
            raw = self.encode(popped[0])
            self.tx_frames += 1
            self.tx_bytes += len(raw)
            self._radio.uplink(raw, now)

    def _later(self, at: float) -> None:
        self._timer = self._loop.call_at(at, self._on_timer)

    def _on_timer(self) -> None:
        self._timer = None
        self._pump()
