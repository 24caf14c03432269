"""A base receiver at its port: survey, corrections, and everything that can go wrong with a cable."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.errors import LinkError
from skygcs.events import Event
from skygcs.ext.corrections import receiver
from skygcs.ext.corrections.config import CorrectionsConfig
from skygcs.ext.corrections.feeder import Feeder
from skygcs.ext.corrections.receiver import ReceiverSource
from skygcs.runtime.correction_feed import CorrectionFeed
from support.base_receiver import BaseReceiver, nav_svin
from support.frames import dialect
from support.pseudo_tty import PtyRadio

pytestmark = pytest.mark.looptime


class Bench:
    def __init__(self, device: str, **keys: Any) -> None:
        keys = {"serial": device, "port": "usb", **({} if "position" in keys else {"survey_s": 60}), **keys}
        self.config = CorrectionsConfig.model_validate(keys)
        self.clock = asyncio.get_running_loop().time
        self.sent = bytearray()
        hub: Any = SimpleNamespace(dialect=dialect(), channels={}, channels_to=lambda *_: (1,), send=self._send)
        self.feed = CorrectionFeed(hub, SimpleNamespace(vehicles={}), self.clock)  # type: ignore[arg-type]
        self.events: list[Event] = []
        self.source = ReceiverSource(self.config, self.clock)
        self.feeder = Feeder(self.source, self.feed, self.clock, self.events.append)

    def _send(self, info: Any, values: Any, *_: Any, **__: Any) -> bool:
        self.sent += bytes(values["data"])[: values["len"]]
        return True

    @property
    def status(self) -> dict[str, Any]:
        return self.feeder.status()

    def changes(self) -> list[str]:
        return [event.data["change"] for event in self.events]


@contextlib.asynccontextmanager
async def at_work(base: BaseReceiver, monkeypatch: pytest.MonkeyPatch, **keys: Any) -> AsyncIterator[Bench]:
    monkeypatch.setattr(receiver, "open_port", base.open_port)
    monkeypatch.setattr(receiver, "discard", lambda port: port.close())
    bench = Bench("/dev/ttyACM0", **keys)

    async def live() -> None:
        while True:
            await asyncio.sleep(1.0)
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
        await asyncio.sleep(60.0)
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
        assert "restarted" in bench.events[-1].text or bench.changes()[-1] == "up"
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
                base.far.send(bytes([0xD3, 0x00, 0xB5, 0x62, second]) * 200)
                base.far.send(nav_svin(10**9, 0.0, valid=True))
        assert bench.sent == b"" and bench.status["failures"] >= 1


async def test_a_port_that_takes_nothing_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    base = BaseReceiver(answers=False)
    monkeypatch.setattr(receiver.os, "write", lambda fd, data: 0)
    async with at_work(base, monkeypatch) as bench:
        await asyncio.sleep(0.5)
        assert "takes nothing" in bench.status["text"]


@pytest.mark.real_time
async def test_a_real_port_that_is_not_there_and_then_is(tmp_path: Path) -> None:
    device = PtyRadio(tmp_path / "base")
    bench = Bench(str(device.path))
    task = asyncio.create_task(bench.feeder.run())
    await asyncio.sleep(0.1)
    assert "no such device" in bench.status["text"]
    with pytest.raises(LinkError, match="not connected"):
        bench.source.restart_survey()
    device.plug_in()
    assert (await device.read_exactly(6))[:4] == b"\xb5\x62\x06\x8a"
    device.write(nav_svin(5, 3.0))
    await asyncio.sleep(0.1)
    assert bench.status["survey"]["duration_s"] == 5
    device.pull_out()
    await asyncio.sleep(0.2)
    assert bench.status["state"] == "down" and "unplugged" in bench.status["text"]
    task.cancel()
    await asyncio.wait({task})
