"""A real captured flight (three ArduCopters, two PX4s on one link) through the whole daemon, in virtual time."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.config.models import ReplayLinkConfig, VehicleEntry
from skygcs.daemon import Daemon
from support.daemons import made_daemon, started

CAPTURE = Path(__file__).parents[1] / "data" / "sitl-3ardupilot-2px4.tlog"
FLIGHT_S = 76.0
pytestmark = pytest.mark.looptime


class Flown:
    """What was seen of the flight."""

    def __init__(self, daemon: Daemon) -> None:
        self.daemon = daemon
        self.events: list[dict[str, Any]] = []
        self.states: list[dict[str, Any]] = []


@contextlib.asynccontextmanager
async def flight(tmp_path: Path) -> AsyncIterator[Flown]:
    """The daemon after the flight, all events, and the fleet's state every half second."""
    daemon = made_daemon(
        tmp_path,
        links={"capture": ReplayLinkConfig(name="capture", file=CAPTURE, speed=1.0)},
        vehicles={"one": VehicleEntry(sysid=1, autopilot="ardupilot"), "four": VehicleEntry(sysid=4, autopilot="px4")},
    )
    flown = Flown(daemon)
    daemon.event_log.subscribe(flown.events.append)
    async with started(daemon):
        for _ in range(int(FLIGHT_S * 2)):
            await asyncio.sleep(0.5)
            flown.states.append({a.name: a.state(daemon.now()) for a in daemon.fleet.vehicles.values()})
        yield flown


async def test_the_captured_flight_is_seen_as_it_was(tmp_path: Path) -> None:
    async with flight(tmp_path) as flown:
        _check_flight(flown.daemon, flown.states)
    kinds = [e["kind"] for e in flown.events]
    assert kinds.count("vehicle_discovered") == 5
    assert kinds.count("armed") == 5
    assert kinds.count("disarmed") == 5
    assert "fault" not in kinds
    assert "conflict" not in kinds


def _check_flight(daemon: Daemon, states: list[dict[str, Any]]) -> None:
    found = {a.name: (a.sysid, a.state(daemon.now())["autopilot"]) for a in daemon.fleet.vehicles.values()}
    assert found == {
        "one": (1, "ardupilot"),
        "v2": (2, "ardupilot"),
        "v3": (3, "ardupilot"),
        "four": (4, "px4"),
        "v5": (5, "px4"),
    }
    modes = {name: _modes(states, name) for name in found}
    for copter in ("one", "v2", "v3"):
        assert modes[copter] == ["STABILIZE", "GUIDED", "LAND"]
    for px4 in ("four", "v5"):
        assert modes[px4] == [
            "AUTO.LOITER",
            "AUTO.TAKEOFF",
            "AUTO.LOITER",
            "OFFBOARD",
            "AUTO.LOITER",
            "AUTO.LAND",
            "AUTO.LOITER",
        ]
    for name in found:
        armed = [s[name]["armed"] for s in states if name in s]
        assert armed[-1] is False
        assert sum(a != b for a, b in itertools.pairwise(armed)) == 2, "armed once, disarmed once"
        highest = max(s[name]["position"]["alt_rel_m"] or 0.0 for s in states if name in s and s[name]["position"])
        assert highest > 5.0
        last = states[-1][name]
        assert last["landed"] == "on_ground"
        assert abs(last["position"]["alt_rel_m"]) < 0.5


async def test_counters_of_the_capture_equal_an_independent_count(tmp_path: Path) -> None:
    async with flight(tmp_path) as flown:
        [link] = flown.daemon.links.status()
        assert link["state"] == "finished"
        assert flown.daemon.hub.faults == 0
        stats = flown.daemon.hub.statistics.router_stats()["counters"]
        assert sum(stats.values()) == 8144, "every record of the capture was routed"


def _modes(states: list[dict[str, Any]], name: str) -> list[str]:
    seen: list[str] = []
    for state in states:
        if name in state and (not seen or seen[-1] != state[name]["mode"]):
            seen.append(state[name]["mode"])
    return seen


@pytest.mark.parametrize("name", ["px4-late-frames", "second-heartbeat-1hz"])
async def test_a_flight_that_lost_nothing_shows_no_loss(name: str, tmp_path: Path) -> None:
    """PX4 sent frames up to 12 places late, and another program a vehicle's heartbeat: 276 and 5,610 were counted."""
    daemon = made_daemon(
        tmp_path, links={"capture": ReplayLinkConfig(name="capture", file=CAPTURE.with_name(f"{name}.tlog"), speed=1.0)}
    )
    running = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    quality: dict[str, dict[str, Any]] = {}
    for _ in range(45):
        await asyncio.sleep(1.0)
        now = {
            actor.name: daemon.hub.statistics.link_quality(key).get("capture")
            for key, actor in daemon.fleet.vehicles.items()
        }
        quality |= {vehicle: of for vehicle, of in now.items() if of is not None}
    daemon.stop()
    await running
    assert sorted(quality) == ["v1", "v11", "v12", "v2", "v3"]
    assert {vehicle: (of["lost"], of["loss_ratio"]) for vehicle, of in quality.items()} == dict.fromkeys(
        quality, (0, 0.0)
    )
