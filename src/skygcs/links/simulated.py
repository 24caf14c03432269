"""Simulated vehicles behind one channel of the daemon, as behind a multipoint radio: no sockets, the same bytes.

They live on the loop's clock, so that in virtual time a flight of minutes takes milliseconds.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Hashable

from skygcs.config import models
from skygcs.config.dialects import load_dialect
from skygcs.config.sim_params import load_param_set
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.errors import ConfigError, LinkError
from skygcs.links.base import Channel, Link, LinkHost, Outgoing
from skygcs.links.simulated_radio import SimulatedRadioChannel, emulated, rates_of
from skygcs.sim.conditions import conditions_of
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.radio_fleet import RadioFleet
from skygcs.sim.vehicle import TICK_S, SimVehicle
from skygcs.sim.vehicle_group import SimFleet, make_vehicles

SIM_DIALECT = "ardupilotmega"
"""What the vehicles speak, whatever the daemon's dialect is: it has all of PX4's telemetry sent here as well."""


class SimulatedChannel(Channel):
    """The way to all simulated vehicles. What is sent reaches them at once, their answers come from the loop."""

    def __init__(self, link: SimulatedVehiclesLink) -> None:
        super().__init__(link, f"{len(link.vehicles)} simulated vehicles")
        self._vehicles: SimulatedVehiclesLink | None = link

    def send(self, outgoing: Outgoing, priority: Priority = Priority.FORWARDED, key: Hashable | None = None) -> bool:
        if self._vehicles is None:
            self.tx_dropped += 1
            return False
        raw = self.encode(outgoing)
        self.tx_frames += 1
        self.tx_bytes += len(raw)
        self._vehicles.uplink(raw)
        return True

    def close(self) -> None:
        """Nothing is sent after this. Idempotent."""
        self._vehicles = None


class SimulatedVehiclesLink(Link):
    """``vehicles`` are there from the first `open` on and live on while the link is closed, as real ones do."""

    config: models.SimulatedLink

    def __init__(self, config: models.SimulatedLink, host: LinkHost, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(config, host, loop)
        self._fleet = SimFleet([])
        self._uplink: FrameParser | None = None
        self._air: RadioFleet | None = None
        self._channel: SimulatedChannel | SimulatedRadioChannel | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._next_tick = 0.0
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
        self._next_tick = self.loop.time()
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
        try:
            params = [] if config.params is None else [load_param_set(config.params)]
            vehicles = make_vehicles(
                dialect,
                px4=config.px4,
                ardupilot=config.ardupilot,
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
        self._fleet = SimFleet(vehicles)
        self._uplink = FrameParser(dialect)

    def _answer(self) -> None:
        self._answering = False
        self._deliver()

    def _tick(self) -> None:
        self._deliver()
        now = self.loop.time()
        # absolute deadlines; after a stall the vehicles catch up in one step, the timer does not
        self._next_tick = max(self._next_tick + TICK_S, now)
        self._timer = self.loop.call_at(self._next_tick, self._tick)

    def _deliver(self) -> None:
        channel = self._channel
        if channel is None:
            return
        now = self.loop.time()
        sent = self._fleet.step(now) if self._air is None else self._air.step(now)
        frames = channel.parser.feed(b"".join(sent)) if sent else []
        if channel.air is not None:
            channel.air.heard(frames, now)
        if frames:
            self.host.on_frames(channel, frames, now)
