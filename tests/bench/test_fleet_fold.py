"""CPU of one frame of a vehicle through the hub: routed, counted, noted; and of reading its state. 10 vehicles and 250.

Run by `make bench`; results also in build/bench/fleet-fold.json. Nothing may grow with the fleet: both are measured
in turn, and the ratio within a round is what counts. Measured without the compiled fast path, as for every frame
that changes a state.
"""

from __future__ import annotations

import asyncio
import os
import statistics
import time
from typing import cast

from bench.results import keep
from skygcs.config.models import FleetConfig, MemoryLinkConfig
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.events import Event
from skygcs.links.memory import MemoryLink
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub
from skygcs.runtime.route_reports import RouteReports
from support.routed import DIALECT, message
from support.services import KnownLinks, Notes

SIZES = (10, 250)
FRAMES = 25_000
STATES = 2_000
ROUNDS = 9
GROWTH_LIMIT = 1.6
"""Of a frame of 250 vehicles to one of 10. Nothing is looked up in longer tables; what remains are caches of the CPU,
which 250 vehicles' slots and statistics do not fit in."""

MIX = (
    ("HEARTBEAT", {"type": 2, "autopilot": 12, "base_mode": 81, "custom_mode": 50593792, "mavlink_version": 3}),
    *[("ATTITUDE", {"time_boot_ms": 123456, "roll": 0.1, "yaw": 1.0, "yawspeed": 0.01})] * 8,
    *[("GLOBAL_POSITION_INT", {"time_boot_ms": 123456, "lat": 437806000, "lon": -794653000, "alt": 180000})] * 6,
    *[("SYS_STATUS", {"voltage_battery": 12000, "battery_remaining": 77})] * 2,
    *[("GPS_RAW_INT", {"time_usec": 1 << 40, "lat": 437806000, "fix_type": 3, "satellites_visible": 12})] * 3,
)
"""The usual mix of a quadrotor."""


class Field:
    """A hub with a fleet behind it, a radio and a ground station; the clock is ours."""

    def __init__(self, vehicles: int) -> None:
        self.loop = asyncio.get_running_loop()
        self.now = self.loop.time()
        self.hub = Hub(FleetConfig(), DIALECT, self.loop, self._on_event)
        self.fleet = Fleet(FleetConfig(), DIALECT, lambda *_, **__: True, self.loop, lambda _: None, links=KnownLinks())
        self.hub.connect(self.fleet, cast(RouteReports, Notes(lambda note, channel: None)))
        self.vehicles = vehicles
        self.number = 0

    @staticmethod
    def _on_event(event: Event) -> None:
        raise AssertionError(event.text)

    async def open(self) -> None:
        self.radio = MemoryLink(MemoryLinkConfig(name="radio", role="radio"), self.hub, self.loop)
        self.gcs = MemoryLink(MemoryLinkConfig(name="gcs", role="gcs"), self.hub, self.loop)
        await self.radio.open()
        await self.gcs.open()

    def frames(self, count: int) -> list[Frame]:
        """The next frames of the fleet, vehicle by vehicle."""
        parser = FrameParser(DIALECT)
        made: list[Frame] = []
        for _ in range(count):
            turn, vehicle = divmod(self.number, self.vehicles)
            name, fields = MIX[turn % len(MIX)]
            if "time_boot_ms" in fields:
                fields = {**fields, "time_boot_ms": 123456 + turn}
            made += parser.feed_datagram(message(name, vehicle + 1, seq=turn & 0xFF, **fields))
            self.number += 1
        return made

    def hear(self, frames: list[Frame]) -> float:
        """CPU seconds of one frame, each in a datagram of its own."""
        hub, channel, now = self.hub, self.radio.channels[0], self.now
        began = time.process_time()
        for frame in frames:
            now += 0.0005
            hub.on_frames(channel, [frame], now)
        self.now = now
        return (time.process_time() - began) / len(frames)

    def read(self) -> float:
        """CPU seconds of one vehicle's state, all sections unpacked anew."""
        actors = list(self.fleet.vehicles.values())
        spent = 0.0
        for n in range(STATES // len(actors)):
            self.hear(self.frames(self.vehicles * len(MIX) // 4))
            began = time.process_time()
            for actor in actors:
                actor.state(self.now + n)
            spent += time.process_time() - began
        return spent / (STATES // len(actors) * len(actors))


async def measured() -> dict[str, dict[int, list[float]]]:
    fields = {size: Field(size) for size in SIZES}
    rows: dict[str, dict[int, list[float]]] = {"a frame": {}, "a state": {}}
    for field in fields.values():
        await field.open()
        field.hear(field.frames(field.vehicles * len(MIX)))
        assert len(field.fleet.vehicles) == field.vehicles
    for _ in range(ROUNDS):
        for size, field in fields.items():
            rows["a frame"].setdefault(size, []).append(field.hear(field.frames(FRAMES)) * 1e6)
    for _ in range(3):
        for size, field in fields.items():
            rows["a state"].setdefault(size, []).append(field.read() * 1e6)
    return rows


def test_a_frame_costs_the_same_in_a_large_fleet() -> None:
    rows = asyncio.run(measured())
    report: dict[str, dict[str, float]] = {}
    for what, by_size in rows.items():
        ratios = [large / small for small, large in zip(by_size[SIZES[0]], by_size[SIZES[1]], strict=True)]
        report[what] = {f"{size} vehicles, us": round(statistics.median(by_size[size]), 2) for size in SIZES}
        report[what] |= {f"{size} vehicles, least us": round(min(by_size[size]), 2) for size in SIZES}
        report[what]["ratio"] = round(statistics.median(ratios), 3)
        print(f"\n{what}: {report[what]}")
    keep("fleet-fold", report)
    if os.environ.get("SKYGCS_BENCH_TARGETS"):
        assert report["a frame"]["ratio"] < GROWTH_LIMIT
