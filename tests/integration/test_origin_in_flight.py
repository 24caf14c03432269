"""The whole daemon with three vehicles in the air: the world frame is changed under them, and nobody moves."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from skygcs.config.models import SimulatedLinkConfig
from skygcs.core.geo import Origin, enu_from_geodetic, geodetic_from_enu
from skygcs.daemon import Daemon
from skygcs.errors import RefusedError
from skygcs.sim.vehicle import SimVehicle
from support.called import call
from support.daemons import made_daemon, simulated_link, started

HOLDING_M = 1.5
"""A simulated vehicle that holds moves by its estimator's noise and the wind, no more."""


@dataclass
class Asker:
    """Calls RPC methods as a session does, without a socket, whose waiting has no place in virtual time."""

    daemon: Daemon

    async def __call__(self, name: str, **params: Any) -> Any:
        return await call(self.daemon, name, **params)

    async def done(self, name: str, **params: Any) -> None:
        outcomes = (await self(name, **params))["outcomes"]
        assert all(o["ok"] for o in outcomes.values()), outcomes


class Flight(Asker):
    @property
    def vehicles(self) -> list[SimVehicle]:
        link = simulated_link(self.daemon, "air")
        return link.vehicles

    def truth(self) -> list[tuple[float, float, float]]:
        """East, north, up of each from where it was powered on, as the simulator knows it, whatever anybody's frame."""
        return [(v.motion.east_m, v.motion.north_m, v.motion.up_m) for v in self.vehicles]

    async def at_height(self, height_m: float) -> None:
        """Until all are there."""
        for _ in range(100):
            if all(up_m > height_m for _, _, up_m in self.truth()):
                return
            await asyncio.sleep(0.3)
        raise AssertionError("they never climbed so high")

    def on_earth(self, number: int) -> tuple[float, float, float]:
        vehicle = self.vehicles[number]
        east_m, north_m, up_m = self.truth()[number]
        return *vehicle.where.to_geodetic(east_m, north_m), vehicle.where.alt_amsl_m + up_m


@contextlib.asynccontextmanager
async def flight(tmp_path: Path) -> AsyncIterator[Flight]:
    """Two PX4s and an ArduCopter, 10 m up and holding."""
    daemon = made_daemon(tmp_path, links={"air": SimulatedLinkConfig(name="air", px4=2, ardupilot=1)})
    async with started(daemon):
        await asyncio.sleep(3)
        gcs = Flight(daemon)
        await gcs.done("vehicles.arm", targets="all", wait_s=90.0)
        await gcs.done("vehicles.takeoff", targets="all", height_m=10.0, wait_s=60.0)
        await gcs.at_height(9.5)
        await asyncio.sleep(4)
        await gcs.done("vehicles.hold", targets="all")
        await asyncio.sleep(4)
        yield gcs


async def test_an_origin_is_everybodys_at_once_moves_nobody_and_is_that_of_this_site(tmp_path: Path) -> None:
    elsewhere = {"lat_deg": 47.4, "lon_deg": 8.5, "alt_amsl_m": 480.0}
    async with flight(tmp_path) as gcs:
        # without one: heights above the take-off are known to the daemon that saw it, and there is none to send
        for state in await gcs("vehicles.list"):
            assert state["position"]["enu_m"] is None
            assert state["position"]["alt_takeoff_m"] == pytest.approx(10.0, abs=HOLDING_M)
        with pytest.raises(RefusedError, match="no origin to send"):
            await gcs("origin.push", targets="all")
        with pytest.raises(RefusedError, match=r"km from v\d.*force"):
            await gcs("origin.set", **elsewhere)
        assert (await gcs("origin.get"))["origin"] is None
        await gcs("origin.from_vehicle", target="1", heading=True)
        await told_to_armed_vehicles(gcs)
        for heading_deg, north_m in ((90.0, 0.0), (150.0, 400.0), (275.5, -3000.0)):
            await changed(gcs, heading_deg, north_m)
        generation = (await gcs("origin.get"))["generation"]
        assert (await gcs("origin.set", **elsewhere, force=True))["generation"] == generation + 1


async def changed(gcs: Flight, heading_deg: float, north_m: float) -> None:
    """To another origin: seen in every state and in an event, and nobody moves."""
    before = gcs.truth()
    status = await gcs("origin.get")
    lat, lon, _ = geodetic_from_enu(50.0, north_m, 0.0, Origin(**{**status["origin"], "x_heading_deg": 90.0}))
    new = {"lat_deg": lat, "lon_deg": lon, "alt_amsl_m": 170.0, "x_heading_deg": heading_deg}
    reported = await gcs("origin.set", **new)
    assert reported == {"origin": new, "generation": status["generation"] + 1}
    states = await gcs("vehicles.list")
    for position in (s["position"] for s in states):
        seen = enu_from_geodetic(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"], Origin(**new))
        assert position["enu_m"] == pytest.approx(seen, abs=0.002)
        assert position["origin_generation"] == reported["generation"]
    event = next(e for e in reversed(gcs.daemon.event_log.recent) if e["kind"] == "origin")
    assert (event["data"]["old"], event["data"]["new"]) == (status["origin"], new)
    await stays(gcs, before)


async def told_to_armed_vehicles(gcs: Flight) -> None:
    """That takes force, and an ArduPilot says that it keeps its own."""
    refused = (await gcs("origin.push", targets="all"))["outcomes"]
    assert all(o["result"] == "refused" and "armed" in o["message"] for o in refused.values())
    before = gcs.truth()
    reported = (await gcs("origin.push", targets="all", force=True))["outcomes"]
    assert reported["v1"]["ok"] and reported["v2"]["ok"], reported
    assert reported["v3"]["result"] == "denied"
    assert "ArduPilot has an origin already" in reported["v3"]["message"]
    await stays(gcs, before)


async def stays(gcs: Flight, before: list[tuple[float, float, float]]) -> None:
    """Nobody moves, for ten seconds."""
    await asyncio.sleep(10)
    for was, now in zip(before, gcs.truth(), strict=True):
        assert math.dist(was, now) < HOLDING_M


@pytest.mark.deep  # several vehicles, as the one before
async def test_several_keep_their_places_to_each_other_in_a_turned_frame(tmp_path: Path) -> None:
    async with flight(tmp_path) as gcs:
        await gcs("origin.from_vehicle", target="1")
        status = (await gcs("origin.get"))["origin"]
        await gcs("origin.set", **{**status, "x_heading_deg": 200.0})
        turned, plain = Origin(**{**status, "x_heading_deg": 200.0}), Origin(**{**status, "x_heading_deg": 90.0})
        before = [enu_from_geodetic(*gcs.on_earth(i), plain) for i in range(3)]
        await gcs.done("vehicles.goto", targets="all", enu_m=[25.0, 10.0, 5.0])
        await asyncio.sleep(25)
        after = [enu_from_geodetic(*gcs.on_earth(i), plain) for i in range(3)]
        for i in (1, 2):
            for axis in (0, 1):
                assert after[i][axis] - after[0][axis] == pytest.approx(before[i][axis] - before[0][axis], abs=1.5)
        places = [enu_from_geodetic(*gcs.on_earth(i), turned) for i in range(3)]
        assert [sum(axis) / 3 for axis in zip(*places, strict=True)] == pytest.approx([25.0, 10.0, 5.0], abs=1.0)
