"""Simulated vehicles behind one channel of the daemon, as behind a multipoint radio: no sockets, the same bytes.

They live on the loop's clock, so that in virtual time a flight of minutes takes milliseconds.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Hashable

from skygcs.config import models
from skygcs.config.dialects import load_dialect
from skygcs.config.param_sets import load_param_set
from skygcs.config.radio import EmulatedRadio, RadioKeys, measured_timing
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.capacity import BITS_PER_BYTE, RadioRates
from skygcs.core.radio_link.transmit_queue import Outgoing, Priority
from skygcs.errors import ConfigError, LinkError
from skygcs.links.base import Channel, Link, LinkHost
from skygcs.links.paced import third_party_rules
from skygcs.links.stream import SHALLOW_BYTES, QueuedChannel
from skygcs.sim.conditions import conditions_of
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.radio_fleet import RadioFleet
from skygcs.sim.rng import Rng
from skygcs.sim.tdm import GROUND, TdmConfig, TdmNetwork
from skygcs.sim.vehicle import SimVehicle
from skygcs.sim.vehicle_group import SimFleet, make_vehicles
from skygcs.sim.vehicle_state import TICK_S

SIM_DIALECT = ("ardupilotmega", "px4-extras")
"""The vehicles' dialect, whatever the daemon's is: it also has all the PX4 telemetry that is sent here."""

CATCH_UP_S = 0.5
"""Longest simulated time that is caught up in one turn of the loop; the vehicles skip the rest. On a machine that is
too slow for them each turn would have more to catch up than the one before. At load 30 one turn took 134 s, and the
daemon neither answered nor ended."""

KERNEL_BYTES = 4096
"""Bytes that a port takes at once from a writer that does not check its buffer."""


class SimulatedChannel(Channel):
    """The channel to all simulated vehicles. Frames reach them at once, their answers come from the loop."""

    def __init__(self, link: SimulatedVehiclesLink) -> None:
        super().__init__(link, f"{len(link.vehicles)} simulated vehicles")
        self._vehicles: SimulatedVehiclesLink | None = link

    def send(self, outgoing: Outgoing, priority: Priority = Priority.FORWARDED, key: Hashable | None = None) -> bool:
        if self._vehicles is None or self.is_kept_back(outgoing):
            self.tx_dropped += 1
            return False
        raw = self.encode(outgoing)
        self.tx_frames += 1
        self.tx_bytes += len(raw)
        self._vehicles.uplink(raw)
        return True

    def close(self) -> None:
        """Stop sending. Idempotent."""
        self._vehicles = None


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


def rates_of(link: models.SimulatedLinkConfig) -> RadioRates:
    """Return what the daemon may know of the radio at its port: what the keys of a serial link would say."""
    assert link.radio is not None
    air = link.radio.air_kbps if link.air_speed_kbps is None else link.air_speed_kbps
    nodes, timing = link.nodes or link.radio.nodes, measured_timing(link)
    return RadioRates(link.radio.baud, air, nodes, link.duty_cycle, link.uplink_share, timing)


class SimulatedRadioChannel(QueuedChannel):
    """The port of the ground's radio. With role "radio" it is paced; else it is written as fast as it takes data."""

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
        """Stop sending. Idempotent."""
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


class SimulatedVehiclesLink(Link):
    """``vehicles`` are there from the first `open` on and live on while the link is closed, as real ones do."""

    config: models.SimulatedLinkConfig

    def __init__(self, config: models.SimulatedLinkConfig, host: LinkHost, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(config, host, loop)
        self._fleet = SimFleet([])
        self._uplink: FrameParser | None = None
        self._air: RadioFleet | None = None
        self._channel: SimulatedChannel | SimulatedRadioChannel | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._next_tick = 0.0
        self._lived_until = 0.0
        self._answering = False

    @property
    def vehicles(self) -> list[SimVehicle]:
        """The simulated vehicles, PX4s first; ``motion`` is where each truly is, ``faults`` what can be broken."""
        return self._fleet.vehicles

    @property
    def channels(self) -> list[Channel]:
        return [] if self._channel is None else [self._channel]

    async def open(self) -> None:
        if self._channel is not None:
            return
        if self._uplink is None:
            self._power_up()
        self._channel = self._new_channel()
        self.host.attach(self._channel)
        self._lived_until = self._next_tick = self.loop.time()
        self._tick()

    async def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._channel is not None:
            channel, self._channel = self._channel, None
            channel.close()
            self.host.detach(channel, "closed")

    @property
    def radio(self) -> RadioFleet | None:
        """The emulated radios; None without, or before the link was first opened."""
        return self._air

    def _new_channel(self) -> SimulatedChannel | SimulatedRadioChannel:
        config = self.config
        if self._air is None or config.radio is None:
            return SimulatedChannel(self)
        peer = f"{len(self.vehicles)} simulated vehicles behind {config.radio.air_kbps:g} kbit/s"
        rates = rates_of(config) if config.role == "radio" else None
        return SimulatedRadioChannel(self, peer, self._air, config.radio.baud, rates)

    def uplink(self, raw: bytes) -> None:
        """Bytes from the channel to the vehicles."""
        assert self._uplink is not None
        now = self.loop.time()
        for frame in self._uplink.feed_datagram(raw):
            self._fleet.on_frame(frame, now)
        if not self._answering:
            self._answering = True
            # not from within the host's own send: it may be amid routing a frame
            self.loop.call_soon(self._answer)

    def _power_up(self) -> None:
        config = self.config
        dialect = load_dialect(SIM_DIALECT)
        # make the vehicles, and the radio between them and the port
        try:
            params = [] if config.params is None else [load_param_set(config.params)]
            vehicles = make_vehicles(
                dialect,
                **config.counts,
                first_sysid=config.first_sysid,
                home=LocalFrame(config.lat_deg, config.lon_deg, config.alt_amsl_m),
                seed=config.seed,
                now=self.loop.time(),
                unix_us=int(time.time() * 1e6),
                conditions=conditions_of(
                    dynamics=config.dynamics,
                    airframe=config.airframe,
                    attitude_lag_s=config.attitude_lag_s,
                    wind_mps=config.wind_mps,
                    wind_from_deg=config.wind_from_deg,
                    gust_mps=config.gust_mps,
                    gps_noise_m=config.gps_noise_m,
                    attitude_noise_deg=config.attitude_noise_deg,
                    sensor_latency_s=config.sensor_latency_s,
                ),
                params=params,
            )
            if config.radio is not None:
                self._air = emulated(config.radio, vehicles, dialect, seed=config.seed, now=self.loop.time())
        except ConfigError as error:
            raise LinkError(f"simulated {self.name}: {error.source}: {'; '.join(error.problems)}") from None
        except ValueError as error:
            raise LinkError(f"simulated {self.name}: {error}") from None
        # switch them on
        self._fleet = SimFleet(vehicles)
        self._uplink = FrameParser(dialect)

    def _answer(self) -> None:
        self._answering = False
        self._deliver()

    def _tick(self) -> None:
        self._deliver()
        now = self.loop.time()
        # absolute deadlines; after a stall the vehicles catch up in one step, a long one they leave out
        self._next_tick = max(self._next_tick + TICK_S, now)
        self._timer = self.loop.call_at(self._next_tick, self._tick)

    def _deliver(self) -> None:
        channel = self._channel
        if channel is None:
            return
        now = self.loop.time()
        if now - self._lived_until > CATCH_UP_S:
            self._fleet.skip_to(now - CATCH_UP_S)
        self._lived_until = now
        sent = self._fleet.step(now) if self._air is None else self._air.step(now)
        frames = channel.parser.feed(b"".join(sent)) if sent else []
        if channel.air is not None:
            channel.air.heard(frames, now)
        if frames:
            self.host.on_frames(channel, frames, now)
