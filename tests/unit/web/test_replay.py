"""A recording in place of a daemon: a jump gives the state that reading from the beginning gives."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.config.dialects import load_dialect
from skygcs.errors import RpcError, SkygcsError
from skygcs.events import Event
from skygcs.web import replay_source
from skygcs.web.page_clients import PageClient, PageClients
from skygcs.web.replay_fleet import ReplayFleet
from skygcs.web.replay_marks import MAX_MARKS, marks_of
from skygcs.web.replay_source import Recording, ReplaySource
from skygcs.web.state_batches import LatestStates
from support.public_data import ROOT, public_file
from support.table import each

FLIGHT = "tlog/devmangrani-v2-radio-loss-f35.tlog"
"""One vehicle, ten minutes, a radio that loses a third."""

DIALECT = load_dialect(["ardupilotmega", "px4-extras"])
COUNTERS = {"messages", "links", "takeoff_alt_amsl_m", "alt_takeoff_m"}
"""They count from the jump on, or need what was seen minutes before."""


def without_counters(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: without_counters(v) for k, v in value.items() if k not in COUNTERS}
    return value


class SilentSocket:
    def __init__(self) -> None:
        self.sent: list[dict[str, Any]] = []

    async def send_frame(self, data: bytes) -> None:
        self.sent.append(json.loads(data))

    def abort(self) -> None:
        pass


class Replayed:
    """A replay with one page."""

    def __init__(self, path: Path) -> None:
        self.states = LatestStates()
        self.source = ReplaySource(path, DIALECT, self.states)
        self.pages = PageClients(self.states, self.source, self.source.own_methods())
        self.socket = SilentSocket()
        self.page = PageClient(self.pages, self.socket, "command", "browser")
        self.pages.clients[self.page] = None

    async def call(self, method: str, **params: Any) -> Any:
        return await self.source.own_methods()[method](self.page, params)

    async def ask(self, method: str, **params: Any) -> Any:
        return json.loads(await self.source.call(method, params))

    async def until(self, condition: Any) -> None:
        for _ in range(12_000):
            if condition():
                return
            await asyncio.sleep(0.01)
        raise AssertionError("it never happened")


@asynccontextmanager
async def replayed(path: Path | None = None) -> AsyncIterator[Replayed]:
    bench = Replayed(path or public_file(FLIGHT))
    tasks = [asyncio.create_task(bench.source.run(bench.pages)), asyncio.create_task(bench.page.send())]
    try:
        yield bench
    finally:
        bench.page.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def read_to(recording: Recording, fleet: ReplayFleet, at_s: float, first: int = 0) -> None:
    ticked = -1.0
    for entry in recording.entries(recording.checkpoints[first]):
        if entry is None or entry.frame is None:
            continue
        if entry.at_s > at_s:
            break
        fleet.on_frame(entry.frame, entry.at_s)
        if entry.at_s - ticked >= 0.1:
            ticked = entry.at_s
            fleet.tick(entry.at_s)
    fleet.tick(at_s)


@each("share", [0.05, 0.37, 0.66, 0.93])
async def test_a_jump_gives_the_state_of_reading_from_the_beginning(share: float) -> None:
    async with replayed() as bench:
        await bench.until(lambda: bench.source.recording.scanned)
        assert len(bench.source.recording.checkpoints) > 10
        at_s = bench.source.recording.duration_s * share
        # there and back again
        for position_s in (bench.source.recording.duration_s, at_s):
            await bench.call("replay.seek", position_s=position_s)
            await bench.until(lambda: bench.source.status()["position_s"] == round(bench.source.position_s, 3))
            await bench.until(lambda: bench.source._seek_s is None)
        whole = ReplayFleet(DIALECT)
        read_to(bench.source.recording, whole, at_s)
        assert bench.source.fleet.origin == whole.origin
        assert list(bench.source.fleet.vehicles) == list(whole.vehicles)
        for key, vehicle in whole.vehicles.items():
            jumped = bench.source.fleet.vehicles[key]
            expected, found = whole.state(vehicle, at_s), bench.source.fleet.state(jumped, at_s)
            assert without_counters(found) == without_counters(expected)


async def test_playing_moves_on_and_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    async with replayed() as bench:
        await bench.until(lambda: bench.source.recording.scanned)
        bench.page.subscribe(10.0)
        duration_s = bench.source.recording.duration_s
        await bench.call("replay.seek", position_s=duration_s - 20)
        await bench.call("replay.speed", speed=100)
        await bench.call("replay.play")
        await bench.until(lambda: bench.source.ended)
        wanted = {"web.state", "replay.position"}
        await bench.until(lambda: wanted <= {message["method"] for message in bench.socket.sent})
        status = bench.source.status()
        assert status["playing"] is False and abs(status["position_s"] - duration_s) < 0.01
        batches = [m["params"] for m in bench.socket.sent if m["method"] == "web.state" and m["params"]["vehicles"]]
        assert batches[0]["vehicles"][0]["replayed"] is True
        await bench.call("replay.play")  # from the beginning again
        await bench.until(lambda: not bench.source.ended and bench.source.position_s < duration_s / 2)


async def test_the_newest_seek_wins() -> None:
    async with replayed() as bench:
        await bench.until(lambda: bench.source.recording.scanned)
        for share in (0.9, 0.1, 0.8, 0.5):
            await bench.call("replay.seek", position_s=share * bench.source.recording.duration_s)
        await bench.until(lambda: bench.source._seek_s is None)
        assert bench.source.position_s == pytest.approx(0.5 * bench.source.recording.duration_s)


async def test_only_what_a_recording_knows_is_answered() -> None:
    async with replayed() as bench:
        await bench.until(lambda: bench.source.recording.scanned)
        assert await bench.ask("vehicles.list") == []
        await bench.call("replay.seek", position_s=100.0)
        await bench.until(lambda: bench.source._seek_s is None)
        (state,) = await bench.ask("vehicles.list")
        assert (await bench.ask("vehicles.get", target=state["name"]))["sysid"] == state["sysid"]
        events = await bench.ask("events.recent", limit=3)
        assert 1 <= len(events) <= 3
        for method, params in (
            ("vehicles.arm", {}),
            ("vehicles.get", {"target": "x"}),
            ("events.recent", {"limit": 0}),
        ):
            with pytest.raises(RpcError):
                await bench.source.call(method, params)
        for params in ({}, {"position_s": "3"}, {"position_s": float("nan")}, {"position_s": True}):
            with pytest.raises(RpcError):
                await bench.call("replay.seek", **params)
        for speed in (0, 0.01, 1000, None):
            with pytest.raises(RpcError):
                await bench.call("replay.speed", speed=speed)


async def test_what_is_kept_does_not_grow_with_the_length(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay_source, "FIRST_SPACING_S", 0.05)
    async with replayed() as bench:
        await bench.until(lambda: bench.source.recording.scanned)
        assert 16 <= len(bench.source.recording.checkpoints) <= replay_source.MAX_CHECKPOINTS
        times = [checkpoint.at_s for checkpoint in bench.source.recording.checkpoints]
        assert times[0] == 0.0 and times == sorted(times)


@each("name", ["dronekit-2012-16k-truncated.tlog", "devmangrani-v2-radio-loss-f35.raw"])
async def test_damaged_logs_and_raw_captures_are_played_too(name: str) -> None:
    async with replayed(public_file(f"tlog/{name}")) as bench:
        await bench.until(lambda: bench.source.recording.scanned)
        await bench.call("replay.seek", position_s=bench.source.recording.duration_s / 2)
        await bench.until(lambda: bench.source._seek_s is None)
        assert bench.source.fleet.vehicles


async def test_what_is_no_log_is_refused(tmp_path: Path) -> None:
    noise = tmp_path / "noise.tlog"
    noise.write_bytes(b"no log at all" * 1000)
    for path in (tmp_path, tmp_path / "none.tlog", ROOT / "README.md", Path("/dev/zero")):
        with pytest.raises(SkygcsError):
            ReplaySource(path, DIALECT, LatestStates())


@each("armed, severity", [(True, "alarm"), (False, "warning"), (None, "alarm")])
async def test_an_event_is_as_serious_as_it_was_then(armed: bool | None, severity: str) -> None:
    recording = Recording(public_file(FLIGHT), DIALECT)
    fleet: Any = SimpleNamespace(find=lambda name: SimpleNamespace(armed=armed) if name == "alpha" else None)
    try:
        lost = Event("vehicle_lost", "alpha", 1, "lost", {})
        assert recording.record(lost, 1.0, fleet)["severity"] == severity
        assert recording.record(Event("vehicle_lost", None, None, "lost", {}), 1.0, fleet)["severity"] == "alarm"
    finally:
        recording.close()


# -- Which events are marked on the bar of a recording.


def event(kind: str, **data: Any) -> dict[str, Any]:
    return {"kind": kind, "vehicle": "v1", "sysid": 1, "text": kind, "data": data, "time_unix_s": 0.0}


def test_what_a_person_looks_for_is_marked_and_the_rest_is_not() -> None:
    events = [
        (1.0, event("vehicle_discovered")),
        (2.0, event("armed")),
        (3.0, event("statustext", level=6)),
        (4.0, event("statustext", level=3)),
        (5.0, event("failsafe", failsafe=True)),
        (6.0, event("command")),
        (7.0, event("statustext")),
    ]
    assert [(mark["at_s"], mark["event"]["kind"]) for mark in marks_of(events)] == [
        (2.0, "armed"),
        (4.0, "statustext"),
        (5.0, "failsafe"),
    ]
    assert marks_of([]) == []


def test_of_too_many_the_first_ranks_stay_in_the_order_of_time() -> None:
    events = [(float(n), event("mode")) for n in range(2 * MAX_MARKS)]
    events[350] = (350.0, event("failsafe"))
    events[599] = (599.0, event("statustext", level=2))
    marks = marks_of(events)
    assert len(marks) == MAX_MARKS
    assert [mark["at_s"] for mark in marks] == sorted(mark["at_s"] for mark in marks)
    assert {350.0, 599.0} <= {mark["at_s"] for mark in marks}
