"""Short cuts of flights on real firmware (`make test-firmware`), replayed through the whole daemon in virtual time.

What is true of each is counted by pymavlink, which shares no code with skygcs.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig, ReplayLinkConfig
from skygcs.tlog.reading import LogReader
from support.daemons import made_daemon
from support.table import each

DATA = Path(__file__).parents[1] / "data"
SPEED = 1.0
CUTS = (
    "px4-plan-transfer",
    "px4-mission-flight",
    "px4-telemetry-cut",
    "px4-battery-low",
    "copter-forged-positions",
    "copter-signed-flight",
    "copter-companion",
    "copter-radio-flight",
)
SIGNED = 0x01
"""MAVLINK_IFLAG_SIGNED."""

NAMES = {
    "LOITER": "AUTO.LOITER",
    "MISSION": "AUTO.MISSION",
    "RTL": "AUTO.RTL",
    "LAND": "AUTO.LAND",
    "TAKEOFF": "AUTO.TAKEOFF",
    "OFFBOARD": "OFFBOARD",
}
"""pymavlink's names of PX4's modes, and skygcs's."""


class Truth:
    """A capture as pymavlink reads it."""

    def __init__(self, name: str) -> None:
        self.sources: Counter[tuple[int, int]] = Counter()
        self.messages: Counter[str] = Counter()
        self.modes: dict[int, list[str]] = {}
        self.seconds = 0.0
        self.signed = 0
        self.lost: Counter[int] = Counter()
        """Gaps in the sequence numbers of each system's autopilot."""
        last: dict[int, int] = {}
        log = mavutil.mavlink_connection(str(DATA / f"{name}.tlog"))
        first = None
        while (message := log.recv_match()) is not None:
            first = message._timestamp if first is None else first
            self.seconds = message._timestamp - first
            if message.get_type().startswith("UNKNOWN"):
                continue
            self.sources[message.get_srcSystem(), message.get_srcComponent()] += 1
            self.messages[message.get_type()] += 1
            self.signed += bool(message.get_header().incompat_flags & SIGNED)
            if message.get_srcComponent() == 1:
                sysid, seq = message.get_srcSystem(), message.get_seq()
                self.lost[sysid] += (seq - last.get(sysid, seq - 1) - 1) % 256
                last[sysid] = seq
            if message.get_type() == "HEARTBEAT" and message.get_srcComponent() == 1:
                modes = self.modes.setdefault(message.get_srcSystem(), [])
                mode = mavutil.mode_string_v10(message)
                if message.autopilot == mavutil.mavlink.MAV_AUTOPILOT_PX4:
                    mode = NAMES[mode]
                if modes[-1:] != [mode]:
                    modes.append(mode)
        log.close()


class Replayed:
    """What the daemon made of a capture."""

    def __init__(self) -> None:
        self.events: list[dict[str, Any]] = []
        self.modes: dict[int, list[str]] = {}
        self.state: dict[int, dict[str, Any]] = {}
        self.lost: dict[int, int] = {}
        self.counters: dict[str, int] = {}
        self.faults = 0


async def replay(name: str, tmp_path: Path) -> Replayed:
    daemon = made_daemon(
        tmp_path, links={"capture": ReplayLinkConfig(name="capture", file=DATA / f"{name}.tlog", speed=SPEED)}
    )
    found = Replayed()
    daemon.event_log.subscribe(found.events.append)
    running = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    for _ in range(10_000):
        await asyncio.sleep(0.05)
        for key, actor in daemon.fleet.vehicles.items():
            if (quality := daemon.hub.statistics.link_quality(key).get("capture")) is not None:
                found.lost[actor.sysid] = quality["lost"]
            found.state[actor.sysid] = state = actor.state(daemon.now())
            modes = found.modes.setdefault(actor.sysid, [])
            if modes[-1:] != [state["mode"]]:
                modes.append(state["mode"])
        [link] = daemon.links.status()
        if link["state"] == "finished":
            break
    found.counters = daemon.hub.statistics.router_stats()["counters"]
    found.faults = daemon.hub.faults
    daemon.stop()
    await running
    return found


@pytest.mark.deep
@each("name", CUTS)
def test_every_frame_is_read_as_pymavlink_reads_it(name: str) -> None:
    truth = Truth(name)
    reader = LogReader((DATA / f"{name}.tlog").read_bytes(), load_dialect(FleetConfig().dialect), "tlog")
    frames = [entry.frame for entry in reader if entry.frame is not None]
    names = Counter(frame.name for frame in frames if frame.info is not None)
    # Either side's definitions know some messages that the other's do not: those that both know count.
    both = set(names) & set(truth.messages)
    assert len(both) > 15
    assert {name: names[name] for name in both} == {name: truth.messages[name] for name in both}
    assert set(Counter((f.sysid, f.compid) for f in frames)) == set(truth.sources)


@pytest.mark.deep
@pytest.mark.looptime
@pytest.mark.parametrize("name", [cut for cut in CUTS if cut != "copter-forged-positions"])
async def test_modes_are_those_of_the_heartbeats(name: str, tmp_path: Path) -> None:
    truth = Truth(name)
    found = await replay(name, tmp_path)
    assert found.faults == 0
    assert {sysid: modes for sysid, modes in found.modes.items() if sysid in truth.modes} == truth.modes
    assert not [e for e in found.events if e["kind"] in ("fault", "duplicate", "conflict")]


@pytest.mark.looptime
async def test_telemetry_that_is_cut_twice_loses_the_vehicle_twice(tmp_path: Path) -> None:
    """Six seconds each, under velocity and under attitude control; both times it was found in AUTO.LOITER."""
    found = await replay("px4-telemetry-cut", tmp_path)
    kinds = Counter((e["kind"], e["sysid"]) for e in found.events)
    assert kinds["vehicle_lost", 11] == kinds["vehicle_back", 11] == 2
    assert found.state[11]["armed"] is True


@pytest.mark.looptime
async def test_forged_positions_are_reported(tmp_path: Path) -> None:
    found = await replay("copter-forged-positions", tmp_path)
    assert [e for e in found.events if e["kind"] == "duplicate" and e["sysid"] == 21]
    assert not [e for e in found.events if e["kind"] == "duplicate" and e["sysid"] == 22]


def test_signed_frames_are_counted_as_signed() -> None:
    truth = Truth("copter-signed-flight")
    reader = LogReader((DATA / "copter-signed-flight.tlog").read_bytes(), load_dialect(FleetConfig().dialect), "tlog")
    frames = [entry.frame for entry in reader if entry.frame is not None]
    assert sum(frame.signed for frame in frames) == truth.signed == truth.messages.total() > 600


@pytest.mark.deep
@pytest.mark.looptime
async def test_what_a_radio_lost_is_counted_as_pymavlink_counts_it(tmp_path: Path) -> None:
    truth = Truth("copter-radio-flight")
    found = await replay("copter-radio-flight", tmp_path)
    assert truth.messages["RADIO_STATUS"] > 20
    assert sum(truth.lost.values()) > 5
    assert found.lost == dict(truth.lost)
