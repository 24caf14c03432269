"""SIGTERM in the middle of what undoes itself: it is undone while the links are open, or kept on disk and offered."""

from __future__ import annotations

import asyncio
import json
import stat
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import RefusedError
from skygcs.runtime.undo_journal import MAX_ENTRIES
from skygcs.sim.firmware_modes import CopterMode
from skygcs.sim.vehicle import SimVehicle
from support.examples import thinned
from support.flown import HOLDING, Flown, aloft
from support.grounded import on_the_ground

COSTS = "each of its daemons is ended in another order under way"

WITHIN_S = 6.0
"""The daemon gives undos and holds 5 s; what comes after them takes no time but the recorder's."""

BOTH = pytest.mark.parametrize("name", ["v1", "v2"])
"""v1 is a PX4, v2 an ArduCopter."""

FENCES = ("GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST")
COPTER_FENCES = ("FENCE_ENABLE", "FENCE_ACTION", "FENCE_RADIUS", "FENCE_TYPE", "FENCE_ALT_MAX")


def held(sim: SimVehicle) -> dict[str, float]:
    return {n: sim.params[n] for n in (*FENCES, *COPTER_FENCES) if sim.params.find(n) is not None}


def put(sim: SimVehicle, name: str, value: float) -> None:
    """Into the vehicle, past the link."""
    found = sim.params.find(name)
    assert found is not None
    found[1].value = type(found[1].value)(value)


def entries(tmp_path: Path) -> list[dict[str, Any]]:
    return [json.loads(path.read_text()) for path in sorted((tmp_path / "logs" / "undo").glob("*.json"))]


async def walking(gcs: Flown, name: str) -> asyncio.Task[Any]:
    """A fence test whose walk has begun. On a bad link setting the fence may fail, and is tried again."""
    for _ in range(3):
        test = asyncio.create_task(gcs.outcome("fence.test", name, radius_m=5.0))
        walks = lambda: any(t.kind == "fence" and "carry" in t.text for t in gcs.told)  # noqa: E731
        await gcs.until(lambda: walks() or test.done(), 60.0)  # noqa: B023 - called in this turn only
        if walks():
            return test
    raise AssertionError("no walk began")


@BOTH
@pytest.mark.parametrize("link", [{}, {"delay_s": 0.2}], ids=str)
async def test_a_fence_test_is_undone_before_the_links_close(tmp_path: Path, name: str, link: dict[str, float]) -> None:
    async with on_the_ground(tmp_path, **link) as gcs:
        before = held(gcs.sim(name))
        test = await walking(gcs, name)
        assert held(gcs.sim(name)) != before and len(entries(tmp_path)) == 1
        await gcs.stopped(WITHIN_S)
        outcome = await test
        assert not outcome["ok"] and "the fence is as before" in outcome["message"], outcome
        assert held(gcs.sim(name)) == before and entries(tmp_path) == []


@BOTH
@pytest.mark.parametrize("seed", range(4))
async def test_on_a_bad_link_it_is_undone_or_it_is_on_disk(tmp_path: Path, name: str, seed: int) -> None:
    async with on_the_ground(tmp_path, loss=0.2, delay_s=0.05, seed=seed) as gcs:
        before = held(gcs.sim(name))
        test = await walking(gcs, name)
        await gcs.stopped(WITHIN_S)
        message = (await test)["message"]
        if entries(tmp_path):
            assert "NOT AS BEFORE" in message and "undo run" in message
        else:
            assert held(gcs.sim(name)) == before and "as before" in message


@pytest.mark.deep  # as in the middle of the fence test
@BOTH
async def test_in_the_middle_of_setting_the_fence_as_well(tmp_path: Path, name: str) -> None:
    for at in range(1, 12, 2):
        folder = tmp_path / str(at)
        async with on_the_ground(folder, delay_s=0.1) as gcs:
            before = held(gcs.sim(name))
            test = asyncio.create_task(gcs.outcome("fence.test", name, radius_m=5.0))
            await asyncio.sleep(0.2 * at)
            await gcs.stopped(WITHIN_S)
            await asyncio.gather(test, return_exceptions=True)
            assert held(gcs.sim(name)) == before and entries(folder) == []


@BOTH
async def test_what_cannot_be_reached_is_kept_and_told_at_the_next_start(tmp_path: Path, name: str) -> None:
    async with on_the_ground(tmp_path) as gcs:
        before = held(gcs.sim(name))
        test = await walking(gcs, name)
        changed = held(gcs.sim(name))
        gcs.cut = True
        await gcs.stopped(WITHIN_S)
        assert "NOT AS BEFORE" in (await test)["message"]
    (folder,) = (tmp_path / "logs").glob("undo")
    (file,) = folder.iterdir()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700 and stat.S_IMODE(file.stat().st_mode) == 0o600
    async with on_the_ground(tmp_path) as gcs:
        sim = gcs.sim(name)
        for parameter, value in changed.items():
            put(sim, parameter, value)  # the simulator began anew, a vehicle keeps its parameters
        told = [dict(e) for e in gcs.daemon.event_log.recent if e["kind"] == "undo"]
        assert len(told) == 1 and told[0]["vehicle"] == name and "undo run" in told[0]["text"]
        assert (await gcs("daemon.info"))["to_undo"] == 1
        (change,) = (await gcs("undo.list"))["changes"]
        await asyncio.sleep(30)
        assert held(sim) == changed, "nothing is undone by itself"
        (outcome,) = (await gcs("undo.run", id=change["id"]))["outcomes"].values()
        assert outcome["ok"], outcome
        assert held(sim) == before
        assert entries(tmp_path) == [] and (await gcs("undo.list"))["changes"] == []
        with pytest.raises(RefusedError, match="no change with id"):
            await gcs("undo.run", id=change["id"])


async def left_behind(tmp_path: Path, name: str) -> dict[str, float]:
    """SIGKILL in the middle of a test: its entry stays as it was written before the change."""
    async with on_the_ground(tmp_path) as gcs:
        test = await walking(gcs, name)
        changed = held(gcs.sim(name))
        (entry,) = (tmp_path / "logs" / "undo").glob("*.json")
        kept = entry.read_bytes()
        test.cancel()
        await asyncio.gather(test, return_exceptions=True)
        await gcs.until(lambda: not gcs.actor(name).fence_watch.testing)
        assert not entry.exists()
    entry.write_bytes(kept)
    return changed


async def test_what_somebody_changed_since_or_an_armed_vehicle_is_left_alone_unless_forced(tmp_path: Path) -> None:
    changed = await left_behind(tmp_path, "v1")
    async with on_the_ground(tmp_path) as gcs:
        sim = gcs.sim("v1")
        for parameter, value in changed.items():
            put(sim, parameter, value)
        put(sim, "GF_MAX_HOR_DIST", 77.0)
        (change,) = (await gcs("undo.list"))["changes"]
        (outcome,) = (await gcs("undo.run", id=change["id"]))["outcomes"].values()
        assert outcome["result"] == "refused" and "GF_MAX_HOR_DIST is 77" in outcome["message"]
        put(sim, "GF_MAX_HOR_DIST", changed["GF_MAX_HOR_DIST"])
        put(sim, "COM_DISARM_PRFLT", 0.0)
        await gcs.done("vehicles.arm", targets="v1")
        (outcome,) = (await gcs("undo.run", id=change["id"]))["outcomes"].values()
        assert outcome["result"] == "refused" and "armed" in outcome["message"]
        assert held(sim) == changed
        (outcome,) = (await gcs("undo.run", id=change["id"], force=True))["outcomes"].values()
        assert outcome["ok"], outcome


async def test_the_entry_of_another_vehicle_or_a_broken_file_undoes_nothing(tmp_path: Path) -> None:
    await left_behind(tmp_path, "v1")
    folder = tmp_path / "logs" / "undo"
    (entry,) = folder.glob("*.json")
    table = json.loads(entry.read_text())
    hostile: list[Any] = [
        {**table, "sysid": 2},  # an ArduCopter now
        {**table, "sysid": 99},
        {**table, "format": 7},
        {**table, "before": {f"P{i}": 1.0 for i in range(100)}},
        {**table, "before": {"GF_ACTION": "nan"}},
        {**table, "before": [1, 2]},
        [],
        7,
    ]
    for number, content in enumerate(hostile):
        (folder / f"bad-{number}.json").write_text(json.dumps(content))
    (folder / "cut.json").write_bytes(entry.read_bytes()[:40])
    (folder / "binary.json").write_bytes(bytes(range(256)))
    (folder / "large.json").write_text('{"a": "' + "x" * 1_000_000 + '"}')
    (folder / "folder.json").mkdir()
    entry.unlink()
    async with on_the_ground(tmp_path) as gcs:
        before = held(gcs.sim("v1")), held(gcs.sim("v2"))
        answer = await gcs("undo.list")
        assert [c["id"] for c in answer["changes"]] == ["bad-0", "bad-1"] and len(answer["problems"]) == 10
        texts = []
        for change in answer["changes"]:
            (outcome,) = (await gcs("undo.run", id=change["id"]))["outcomes"].values()
            assert outcome["result"] == "refused"
            texts.append(outcome["message"])
        assert "another vehicle has its id" in texts[0] and "no vehicle with system id 99" in texts[1]
        with pytest.raises(RefusedError):
            await gcs("undo.drop", id="../../etc/passwd")
        await gcs("undo.drop", id="bad-1")
        assert len((await gcs("undo.list"))["changes"]) == 1
        assert before == (held(gcs.sim("v1")), held(gcs.sim("v2")))


async def test_nothing_is_changed_that_could_not_be_noted(tmp_path: Path) -> None:
    folder = tmp_path / "logs" / "undo"
    async with on_the_ground(tmp_path) as gcs:
        before = held(gcs.sim("v1"))
        folder.mkdir(parents=True)
        for number in range(MAX_ENTRIES):
            (folder / f"{number}.json").write_text("{}")
        outcome = await gcs.outcome("fence.test", "v1")
        assert outcome["result"] == "refused" and "wait to be undone already" in outcome["message"]
        for path in folder.iterdir():
            path.unlink()
        folder.rmdir()
        folder.write_text("a file where the folder was")
        outcome = await gcs.outcome("fence.test", "v1")
        assert outcome["result"] == "refused" and "cannot be written" in outcome["message"]
        assert held(gcs.sim("v1")) == before


@BOTH
async def test_a_take_off_that_has_armed_only_is_disarmed_again(tmp_path: Path, name: str) -> None:
    seen = set()
    for at in thinned(range(1, 14), 6):
        folder = tmp_path / str(at)
        async with on_the_ground(folder, delay_s=0.15) as gcs:
            sim = gcs.sim(name)
            for delay in ("COM_DISARM_PRFLT", "DISARM_DELAY"):
                if sim.params.find(delay) is not None:
                    put(sim, delay, 0.0)  # the autopilot leaves that to us
            flight = asyncio.create_task(gcs.outcome("vehicles.takeoff", name, height_m=5.0))
            await asyncio.sleep(0.3 * at)
            climbing = any(c.values["command"] == 22 for c in gcs.commands(-1.0, name))
            await gcs.stopped(WITHIN_S)
            (outcome,) = await asyncio.gather(flight, return_exceptions=True)
            if climbing and isinstance(outcome, dict) and not outcome["ok"]:
                assert outcome["result"] == "cancelled" and "may follow it" in outcome["message"], outcome
                assert "disarm" not in outcome["message"], outcome
                seen.add("cut short")
            await asyncio.sleep(3)
            assert climbing or not sim.armed, at
            assert climbing or not any(c.values["command"] == 22 for c in gcs.commands(-1.0, name)), at
            armed = any(c.values["command"] == 400 for c in gcs.commands(-1.0, name))
            seen.add("climbing" if climbing else "armed" if armed else "begun")
    assert {"climbing", "armed", "cut short"} <= seen, seen


@pytest.mark.deep  # as a daemon that ends there
async def test_a_caller_that_goes_between_arming_and_climbing_leaves_no_armed_vehicle(tmp_path: Path) -> None:
    async with on_the_ground(tmp_path, delay_s=0.15) as gcs:
        sim = gcs.sim("v1")
        put(sim, "COM_DISARM_PRFLT", 0.0)
        flight = asyncio.create_task(gcs.outcome("vehicles.takeoff", "v1", height_m=5.0))
        await gcs.until(lambda: sim.armed)
        flight.cancel()
        await asyncio.gather(flight, return_exceptions=True)
        await gcs.until(lambda: not sim.armed, 5.0)
        assert not any(c.values["command"] == 22 for c in gcs.commands(-1.0, "v1"))


@pytest.mark.parametrize("after_s", [0.0, 0.3, 1.0, 1.5, 2.0, 4.0])
@pytest.mark.parametrize("mode", ["attitude", "velocity"])
async def test_a_vehicle_that_is_being_taken_over_is_left_holding(tmp_path: Path, mode: str, after_s: float) -> None:
    async with aloft(tmp_path, px4=0, ardupilot=1, delay_s=0.02) as gcs:
        taking = asyncio.create_task(gcs.outcome("control.set", "v1", mode=mode))
        await asyncio.sleep(after_s)
        since = gcs.now
        await gcs.stopped(WITHIN_S)
        await asyncio.gather(taking, return_exceptions=True)
        await asyncio.sleep(10)
        assert gcs.sim().mode in HOLDING and gcs.farthest_m(since) < 3.0
        assert gcs.sim().mode in (CopterMode.GUIDED, CopterMode.BRAKE)
        gcs.sent.clear()


async def test_orders_are_refused_but_those_that_end_a_flight(tmp_path: Path) -> None:
    async with on_the_ground(tmp_path) as gcs:
        gcs.cut = True
        await gcs.daemon.fleet.wind_down(1.0)
        for order in ("vehicles.arm", "vehicles.takeoff", "vehicles.reboot"):
            with pytest.raises(RefusedError, match="shutting down"):
                await gcs(order, targets="v1")
        assert (await gcs.outcome("vehicles.hold", "v1"))["result"] != "refused"


async def test_all_that_waits_when_the_daemon_ends_has_an_answer(tmp_path: Path) -> None:
    """And no vehicle seems to be lost, or back, by that."""
    waiting: dict[str, dict[str, Any]] = {
        "vehicles.renumber": {"target": "v2", "sysid": 23},
        "params.get": {"targets": "v1", "names": ["MIS_TAKEOFF_ALT"]},
        "vehicles.arm": {"targets": "v1", "wait_s": 60.0},
        "vehicles.request": {"targets": "v1", "message": "AUTOPILOT_VERSION"},
        "missions.download": {"target": "v1"},
        "preflight.run": {"targets": "v1"},
        "logs.list": {"targets": "v1"},
        "fence.test": {"targets": "v1", "radius_m": 5.0},
    }
    async with on_the_ground(tmp_path) as gcs:
        for sim in gcs.sims:
            sim.faults.deaf = True  # it is heard, and answers nothing
        asked = [asyncio.create_task(gcs(name, **params)) for name, params in waiting.items()]
        await asyncio.sleep(0.3)
        assert not [task for task in asked if task.done()]
        await gcs.stopped(WITHIN_S)
        told = [str(task.result()) for task in asked] + [event.text for event in gcs.told]
        assert not [text for text in told if "back after" in text or "no heartbeat" in text]
