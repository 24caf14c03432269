"""The daemon is killed in flight and begins again: what it flew is held, what was lost is still known."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.cli.status import STATUS_COLUMNS, status_cells
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.sim.conditions import conditions_of
from skygcs.sim.firmware_modes import CopterMode
from support.flown import KINDS, Flown, Told, aloft
from support.returning import swapped

WINDY = conditions_of(wind_mps=6.0)
COPTER = {"px4": 0, "ardupilot": 1}
AWAY_S = 2.0


async def restarted(gcs: Flown, journal: Callable[[Path], None] = lambda path: None) -> list[Told]:
    """SIGKILL, ``AWAY_S`` later another daemon with the same folder; its events."""
    died = gcs.now
    await gcs.die(journal)
    await asyncio.sleep(max(0.0, died + AWAY_S - gcs.now))
    gcs.told = []
    await gcs.begin_again()
    return gcs.told


@pytest.mark.deep
@KINDS
async def test_what_it_flew_is_held_as_soon_as_it_is_heard(tmp_path: Path, kind: dict[str, int]) -> None:
    """With our heartbeats its failsafe stayed quiet, and an ArduCopter was 30 m away after 10 s."""
    params = {"GUID_TIMEOUT": 1.0, "FS_GCS_ENABLE": 1.0}
    async with aloft(tmp_path, conditions=WINDY, params=params, **kind) as gcs:
        await gcs.fly("attitude")
        await asyncio.sleep(5)
        told = await restarted(gcs)
        begun = gcs.now
        await asyncio.sleep(10)
        assert gcs.is_safe() and gcs.farthest_m(begun + 2.0) < 8.0
        assert [t.kind for t in told if t.kind.startswith("vehicle")] == ["vehicle_back"]
        if kind == COPTER:
            (first, *_) = [t for t in told if t.kind == "unattended"]
            assert first.at - begun < 2.0, "a heartbeat, and no more than a second"
        assert gcs.actor("v1").vehicle.connected


@pytest.mark.deep
async def test_what_it_did_not_fly_is_left_alone(tmp_path: Path) -> None:
    async with aloft(tmp_path, **COPTER) as gcs:
        await gcs.step(60.0, 0.0, 0.0)
        await asyncio.sleep(3)
        told = await restarted(gcs)
        await asyncio.sleep(20)
        assert not [t for t in told if t.kind == "unattended"]
        assert gcs.place()[0] > 50.0, "it has flown on to its goal"


async def test_one_that_is_lost_in_the_air_is_still_shown_and_in_the_way(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2) as gcs:
        place = gcs.place("v2")
        gcs.muted.add(2)
        await asyncio.sleep(12)
        record = gcs.daemon.fleet.notes.charges.record(gcs.actor("v1"))
        record._flown_s, record._dropped_percent = 246.0, 100.0
        await asyncio.sleep(3)
        told = await restarted(gcs)
        await asyncio.sleep(8)
        (lost,) = [t for t in told if t.kind == "vehicle_lost"]
        assert lost.vehicle == "v2" and lost.text.startswith("lost in the air at 43.78")
        v2 = gcs.daemon.fleet.find("v2")
        state = v2.state(gcs.now)
        assert not state["connected"] and state["armed"] and state["position"]["lat_deg"] is not None
        assert gcs.daemon.fleet.notes.charges.record(gcs.daemon.fleet.find("v1")).flight_time_s == pytest.approx(
            246.0, abs=15.0
        )
        # another is not sent there
        to_m = [place[0], place[1], place[2]]
        (outcome,) = (await gcs.daemon.fleet.orders.command_all("v1", VehicleActor.goto, enu_m=to_m)).values()
        assert outcome.result == "refused" and "v2" in outcome.message, outcome
        assert "skygcs-cli forget v2" in outcome.message


@KINDS
async def test_one_that_waited_for_its_return_is_an_alarm_until_somebody_sends_it_home(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    """It holds by itself, and the promise to send it home died with the daemon."""
    async with aloft(tmp_path, **{name: 2 * count for name, count in kind.items()}) as gcs:
        await swapped(gcs)
        ordered = asyncio.create_task(gcs("vehicles.rtl", targets="all"))
        await gcs.until(lambda: waiting(gcs), 20.0)
        await asyncio.sleep(1.0)
        names = waiting(gcs)
        ordered.cancel()
        told = await restarted(gcs)
        await asyncio.sleep(3.0)
        assert [t.vehicle for t in told if "nobody sends it home now" in t.text] == names
        assert given_up(gcs) == dict.fromkeys(names, True)
        await gcs.daemon.fleet.orders.command_all(names[0], VehicleActor.rtl)
        assert given_up(gcs) == {name: name != names[0] for name in names}


def waiting(gcs: Flown) -> list[str]:
    fleet = gcs.daemon.fleet
    return [actor.name for actor in fleet.vehicles.values() if fleet.returns.waits(actor.vehicle.key)]


def given_up(gcs: Flown) -> dict[str, bool]:
    """The vehicles of which an alarm says that nobody sends them home; False: that is over."""
    return {one["vehicle"]: one["active"] for one in gcs.daemon.alarms.all() if one["kind"] == "return"}


async def drifting(gcs: Flown) -> None:
    """Flown by attitude in wind."""
    await gcs.fly("attitude")
    await asyncio.sleep(5)


def spoilt(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:40])


def aged(path: Path) -> None:
    """Written by a clock that is an hour ahead of the one after the restart."""
    table = json.loads(path.read_text())
    for note in table["notes"]:
        note["frames"] = [[at + 3600.0, raw] for at, raw in note["frames"]]
    path.write_text(json.dumps(table))


@pytest.mark.deep
@pytest.mark.parametrize("journal", [spoilt, aged], ids=["it cannot be read", "the clock was set back"])
async def test_it_is_held_whatever_became_of_the_journal(tmp_path: Path, journal: Callable[[Path], None]) -> None:
    async with aloft(tmp_path, conditions=WINDY, **COPTER) as gcs:
        await drifting(gcs)
        told = await restarted(gcs, journal)
        begun = gcs.now
        await asyncio.sleep(10)
        assert gcs.is_safe() and gcs.farthest_m(begun + 2.0) < 8.0
        (first, *_) = [t for t in told if t.kind == "unattended"]
        assert first.at - begun < 2.0


async def test_what_a_station_flew_through_the_daemon_is_held(tmp_path: Path) -> None:
    """It dies with the daemon; noted was whether it was ours, and the vehicle was left alone."""
    links = {"program": {"type": "memory", "role": "gcs"}}
    async with aloft(tmp_path, conditions=WINDY, links=links, **COPTER) as gcs:
        port = gcs.daemon.links.link("program").peer  # type: ignore[attr-defined]  # of a memory link
        level = mav.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1.0, 0.0, 0.0, 0.0], 0, 0, 0, 0.37)
        for _ in range(60):
            port.send(gcs.other.pack(level))
            await asyncio.sleep(0.02)
        told = await restarted(gcs)
        begun = gcs.now
        await asyncio.sleep(6)
        (first, *_) = [t for t in told if t.kind == "unattended"]
        assert "(250/190 before a restart did)" in first.text and first.at - begun < 2.0
        assert gcs.is_safe()


@pytest.mark.deep
@pytest.mark.parametrize("meanwhile", ["landed", "a pilot took it"])
async def test_what_was_done_with_it_meanwhile_is_respected(tmp_path: Path, meanwhile: str) -> None:
    async with aloft(tmp_path, **COPTER) as gcs:
        await drifting(gcs)
        await gcs.die()
        gcs.other_sets_mode(int(CopterMode.LAND if meanwhile == "landed" else CopterMode.LOITER))
        if meanwhile == "landed":
            await gcs.until(lambda: not gcs.sim().armed, 60.0)
        else:
            await asyncio.sleep(6)
        gcs.told = []
        await gcs.begin_again()
        begun = gcs.now
        await asyncio.sleep(8)
        if meanwhile != "landed":
            gcs.other_sets_mode(int(CopterMode.GUIDED))
        await asyncio.sleep(8)
        assert not gcs.commands(begun) and not gcs.texts(0.0, "unattended")


async def test_a_link_that_is_silent_at_the_begin_is_no_reason_to_forget(tmp_path: Path) -> None:
    """It is heard 12 s after the restart: it was reported as lost, and is held then."""
    async with aloft(tmp_path, conditions=conditions_of(wind_mps=2.0), **COPTER) as gcs:
        await drifting(gcs)
        await gcs.die()
        await asyncio.sleep(2)
        gcs.told = []
        await gcs.begin_again()
        gcs.muted.add(1)
        await asyncio.sleep(12)
        assert [t.kind for t in gcs.told if t.kind.startswith("vehicle")] == ["vehicle_lost"]
        shown = next(v for v in await gcs("vehicles.list") if v["name"] == "v1")
        assert not shown["connected"] and shown["armed"]
        row = dict(zip(STATUS_COLUMNS, status_cells(shown), strict=True))
        assert row["name"] == "v1" and row["age"].startswith("lost ") and "ARMED" in row["armed"], row
        assert (await gcs.outcome("vehicles.goto", enu_m=[0.0, 0.0, 10.0]))["result"] == "refused", "it is a vehicle"
        gcs.muted.clear()
        heard = gcs.now
        await gcs.until(lambda: gcs.texts(heard, "unattended"), 2.5)
        await asyncio.sleep(8)
        assert gcs.is_safe()
