"""A base receiver at its port: survey, corrections, and everything that can go wrong with a cable."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from typing import Any

import pytest

from skygcs.errors import LinkError
from skygcs.ext.corrections import receiver
from skygcs.ext.corrections.feeder import BURST_BYTES, BYTES_PER_S
from support.base_receiver import BaseReceiver, nav_svin
from support.corrections_bench import CorrectionsBench

pytestmark = pytest.mark.looptime


def bench_at(device: str, **keys: Any) -> CorrectionsBench:
    survey = {} if "position" in keys else {"survey_s": 60}
    return CorrectionsBench(**{"serial": device, "port": "usb", **survey, **keys})


@contextlib.asynccontextmanager
async def at_work(base: BaseReceiver, monkeypatch: pytest.MonkeyPatch, **keys: Any) -> AsyncIterator[CorrectionsBench]:
    monkeypatch.setattr(receiver, "open_port", base.open_port)
    monkeypatch.setattr(receiver, "discard", lambda port: port.close())
    bench = bench_at("/dev/ttyACM0", **keys)

    async def live() -> None:
        while True:
            for _ in range(10):
                await asyncio.sleep(0.1)
                base.answer()
            base.second()

    tasks = [asyncio.create_task(bench.feeder.run()), asyncio.create_task(live())]
    await asyncio.sleep(0)
    try:
        yield bench
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        assert all(task.cancelled() for task in tasks)
        base.unplug()


async def test_a_survey_from_its_begin_to_corrections(monkeypatch: pytest.MonkeyPatch) -> None:
    base = BaseReceiver()
    async with at_work(base, monkeypatch, survey_s=60, survey_accuracy_m=1.5) as bench:
        await asyncio.sleep(30.0)
        survey = bench.status["survey"]
        assert survey["state"] == "surveying" and 20 <= survey["duration_s"] <= 30
        assert (survey["minimum_s"], survey["wanted_m"]) == (60, 1.5)
        assert survey["accuracy_m"] == pytest.approx(10.0 / survey["duration_s"] ** 0.5, abs=1e-4)
        await asyncio.sleep(60.5)
        status = bench.status
        assert status["survey"]["state"] == "surveyed"
        assert (status["kind"], status["name"], status["state"]) == ("receiver", "/dev/ttyACM0", "streaming")
        assert status["types"]["1074"] > 80 and status["types"]["1005"] >= 1 and "1077" not in status["types"]
        assert bytes(bench.sent) == b"".join(base.sent_rtcm)
        assert bench.feed.totals["skipped_bytes"] == 0  # no UBX and no NMEA comes to the vehicles
        assert bench.changes() == ["up", "surveying", "surveyed"]


async def test_a_survey_that_takes_longer_than_its_minimum(monkeypatch: pytest.MonkeyPatch) -> None:
    async with at_work(BaseReceiver(), monkeypatch, survey_s=10, survey_accuracy_m=1.0) as bench:
        await asyncio.sleep(60.0)
        assert bench.status["survey"]["state"] == "surveying"
        await asyncio.sleep(60.0)
        assert bench.status["survey"]["state"] == "surveyed"


async def test_one_that_floods_is_read_no_faster_than_a_caster(monkeypatch: pytest.MonkeyPatch) -> None:
    base = BaseReceiver()
    async with at_work(base, monkeypatch, position=(43.78, -79.46, 150.0)):
        await asyncio.sleep(5.0)
        base.second = base.answer = lambda: None  # type: ignore[method-assign]
        assert base.far is not None
        sent = 0
        for _ in range(20):
            with contextlib.suppress(BlockingIOError):
                while True:
                    sent += base.far.send(b"\xd3\x03\xff" * 1000, socket.MSG_DONTWAIT)
            await asyncio.sleep(0.05)
        assert BURST_BYTES < sent <= BURST_BYTES + BYTES_PER_S + (1 << 19)  # and what the socket holds


async def test_a_known_position(monkeypatch: pytest.MonkeyPatch) -> None:
    base = BaseReceiver()
    async with at_work(base, monkeypatch, position=(43.78, -79.46, 150.0), observations="msm7") as bench:
        await asyncio.sleep(20.0)
        assert bench.status["survey"]["state"] == "fixed"
        assert bench.status["types"].keys() == {"1005", "1077", "1087", "1097", "1127"}
        assert base.settings["CFG_TMODE_LAT"] == 437800000
        assert "fixed" in bench.changes()
        with pytest.raises(LinkError, match="no survey"):
            bench.source.restart_survey()


async def test_a_cable_that_was_pulled_out_keeps_the_survey(monkeypatch: pytest.MonkeyPatch) -> None:
    base = BaseReceiver()
    async with at_work(base, monkeypatch, survey_accuracy_m=2.0) as bench:
        await asyncio.sleep(80.0)
        assert bench.status["survey"]["state"] == "surveyed"
        base.unplug()
        await asyncio.sleep(0.5)
        assert bench.status["state"] == "down" and bench.status["survey"] is None
        await asyncio.sleep(6.0)
        assert bench.status["survey"]["state"] == "surveyed"
        assert [asked.get("CFG_TMODE_MODE") for asked in base.asked] == [None, 1, None]  # it was not asked to again
        assert bench.changes() == ["up", "surveying", "surveyed", "down", "up"]


async def test_a_receiver_that_lost_its_power_is_set_up_again(monkeypatch: pytest.MonkeyPatch) -> None:
    base = BaseReceiver()
    async with at_work(base, monkeypatch) as bench:
        await asyncio.sleep(80.0)
        base.lose_power()  # the port stays, as a converter's does
        await asyncio.sleep(12.0)
        assert "restarted" in " ".join(event.text for event in bench.events)
        await asyncio.sleep(5.0)
        assert bench.status["survey"]["state"] == "surveying"
        await asyncio.sleep(70.0)
        assert bench.status["survey"]["state"] == "surveyed"


async def test_the_survey_begins_anew_after_the_antenna_was_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    base = BaseReceiver()
    async with at_work(base, monkeypatch) as bench:
        await asyncio.sleep(80.0)
        bench.source.restart_survey()
        await asyncio.sleep(5.0)
        survey = bench.status["survey"]
        assert survey["state"] == "surveying" and survey["duration_s"] < 5
        assert bench.changes() == ["up", "surveying", "surveyed", "surveying"]


@pytest.mark.parametrize(
    ("base", "why"),
    [
        (BaseReceiver(accepts=False), "takes a receiver that can be a base"),
        (BaseReceiver(answers=False), "does not answer"),
    ],
)
async def test_what_is_no_base_is_named(monkeypatch: pytest.MonkeyPatch, base: BaseReceiver, why: str) -> None:
    async with at_work(base, monkeypatch) as bench:
        await asyncio.sleep(6.5)
        assert why in bench.events[0].text and bench.sent == b""


async def test_garbage_is_no_correction(monkeypatch: pytest.MonkeyPatch) -> None:
    base = BaseReceiver(answers=False)
    async with at_work(base, monkeypatch) as bench:
        for second in range(30):
            await asyncio.sleep(1.0)
            if base.far is not None:
                with contextlib.suppress(BrokenPipeError):  # the port is closed for a while
                    base.far.send(bytes([0xD3, 0x00, 0xB5, 0x62, second]) * 200)
                    base.far.send(nav_svin(10**5, 0.0, valid=True))
        assert bench.sent == b"" and bench.status["failures"] >= 1


async def test_a_port_that_takes_nothing_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    base = BaseReceiver(answers=False)
    monkeypatch.setattr(receiver.os, "write", lambda fd, data: 0)
    async with at_work(base, monkeypatch) as bench:
        await asyncio.sleep(0.5)
        assert "accepts no data" in bench.status["text"]
