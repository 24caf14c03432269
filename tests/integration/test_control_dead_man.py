"""Nobody watches any more: the vehicles that are flown by setpoints hold, once, and any sign of life prevents it."""

from __future__ import annotations

import asyncio
from pathlib import Path

from support.flown import KINDS, Flown, aloft
from support.public_data import CAPTURE
from support.pymav import PymavPeer

SETTINGS = {"operator_timeout_s": 5.0}


def warnings(gcs: Flown, since: float) -> list[str]:
    return [t for t in gcs.texts(since, "warning", None) if "no operator or client" in t]


@KINDS
async def test_silence_holds_once(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, settings=SETTINGS, **kind) as gcs:
        await gcs.fly("attitude")
        await gcs.step(3.0, 0.0, 0.0)
        silent = gcs.now
        fired = await gcs.until(lambda: gcs.control()["state"] == "off", 8.0)
        assert fired - silent >= 5.0
        await gcs.ends_safe(within_m=4.0, since=silent)
        await asyncio.sleep(20)
        assert len(warnings(gcs, silent)) == 1
        assert gcs.texts(silent) == ["control ended: hold was ordered"]
        # an ArduCopter brakes and then holds in GUIDED, each once
        assert len(gcs.commands(silent)) == (1 if kind["px4"] else 2)


async def test_it_lands_if_that_was_configured(tmp_path: Path) -> None:
    async with aloft(tmp_path, settings={**SETTINGS, "operator_lost": "land"}) as gcs:
        await gcs.fly("velocity")
        silent = gcs.now
        await asyncio.sleep(30)
        assert gcs.sim().motion.on_ground and len(warnings(gcs, silent)) == 1
        assert gcs.last_setpoint() < silent + 7.1


@KINDS
async def test_a_request_now_and_then_keeps_it_quiet(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, settings=SETTINGS, **kind) as gcs:
        await gcs.fly("attitude")
        since = gcs.now
        for _ in range(8):
            await asyncio.sleep(3.0)
            await gcs("control.status", targets="v1")
        assert gcs.control()["state"] == "flying" and not warnings(gcs, since)


async def test_a_ground_stations_heartbeat_keeps_it_quiet_until_it_ceases(tmp_path: Path) -> None:
    async with aloft(tmp_path, settings=SETTINGS) as gcs:
        await gcs.fly("attitude")
        since, station = gcs.now, PymavPeer(252, 190)
        for _ in range(20):
            gcs.link.peer.send(station.heartbeat(vehicle=False))
            await asyncio.sleep(1.0)
        assert gcs.control()["state"] == "flying" and not warnings(gcs, since)
        await gcs.until(lambda: gcs.control()["state"] == "off", 8.0)
        (reported,) = warnings(gcs, since)
        assert "last: ground station 252/190" in reported


async def test_a_recorded_ground_station_is_nobody(tmp_path: Path) -> None:
    """A recording that is replayed beside the fleet has its operator's heartbeats in it."""
    async with aloft(tmp_path, settings=SETTINGS) as gcs:
        await gcs.daemon.links.add("old", {"type": "replay", "file": str(CAPTURE), "speed": 1.0})
        await gcs.fly("velocity", targets="v1")
        since = gcs.now
        await gcs.until(lambda: warnings(gcs, since), 10.0)
