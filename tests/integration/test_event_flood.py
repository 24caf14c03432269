"""A vehicle that flaps and chatters: log and events stay readable, and what is reported last is true."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
import structlog
from pymavlink.dialects.v20 import ardupilotmega as mav

from support.asked import Asked, asked
from support.examples import covered_by_other_flights
from support.hosts import until
from support.loops import on_every_loop

MODES = (0, 4, 5, 9)
LOG_BYTES_PER_S = 600
"""Of one vehicle, whatever it does: mode, arming, failsafe once a second each, and texts."""


def flap(gcs: Asked, number: int) -> bytes:
    """One of fifty heartbeats a second, each of another mode, armed or not, two of three in failsafe. Modes and arming
    that contradict each other this quickly are those of two vehicles, and change nothing more."""
    base = 0x51 | (0x80 if number % 2 else 0)
    beat = mav.MAVLink_heartbeat_message(2, 3, base, MODES[number % 4], 5 if number % 3 else 4, 3)
    return gcs.vehicle.pack(beat)


def chatter(gcs: Asked, number: int) -> bytes:
    return gcs.vehicle.pack(mav.MAVLink_statustext_message(6, b"something is wrong, number %d" % number))


@covered_by_other_flights
@pytest.mark.looptime
async def test_flapping_and_chatter_are_bounded_and_the_newest_state_is_reported(tmp_path: Path) -> None:
    with structlog.testing.capture_logs() as logs:
        async with asked(tmp_path) as gcs:
            before = 0
            for number in range(50 * 20):
                before = len(logs) if number == 500 else before
                gcs.send(flap(gcs, number) + b"".join(chatter(gcs, 20 * number + i) for i in range(20)))
                await asyncio.sleep(0.02)
            flooded = logs[before:]
            await asyncio.sleep(6.0)
            state = gcs.daemon.fleet.find("v1").state(gcs.daemon.now())
            newest = {e["kind"]: e for e in gcs.events}
            assert newest["mode"]["data"]["mode"] == state["mode"]
            assert newest["failsafe"]["data"]["failsafe"] == state["failsafe"]
            arming = [e["kind"] for e in gcs.events if e["kind"] in ("armed", "disarmed")][-1]
            assert arming == ("armed" if state["armed"] else "disarmed")
            assert newest["statustext"]["text"].startswith("something is wrong, number 19999 (")
            texts = sum(1 + e["data"].get("withheld", 0) for e in gcs.events if e["kind"] == "statustext")
            assert texts == 20_000, "each text was reported or counted"
    size = sum(len(str(line)) for line in flooded)
    assert size / 10 < LOG_BYTES_PER_S, size


@covered_by_other_flights
@on_every_loop
async def test_a_burst_of_texts_costs_a_few_events(tmp_path: Path) -> None:
    async with asked(tmp_path) as gcs:
        for number in range(5000):
            gcs.send(chatter(gcs, number))
        stats = gcs.daemon.fleet.find("v1").vehicle
        await until(lambda: stats.count("STATUSTEXT") == 5000)
        texts = [e for e in gcs.events if e["kind"] == "statustext"]
        assert len(texts) < 100
    assert [e for e in gcs.events if e["kind"] == "statustext"][-1]["text"].startswith(
        "something is wrong, number 4999"
    )
