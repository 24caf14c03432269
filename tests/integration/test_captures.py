"""Captured flights, of simulators and of real firmware (`make test-firmware`), replayed through the whole daemon.

What is true of each is read by pymavlink, which shares no code with skygcs.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections import Counter
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig, ReplayLinkConfig
from skygcs.core.mavlink.dialect import Dialect
from skygcs.daemon import Daemon
from skygcs.ext.logs.flight import RecordedFlight
from skygcs.ext.logs.tables import FlightTables
from skygcs.tlog.reading import LogReader
from support.daemons import made_daemon, started
from support.table import each

DATA = Path(__file__).parents[1] / "data"
SITL = "sitl-3ardupilot-2px4"
CUTS = (
    *("px4-plan-transfer", "px4-mission-flight", "px4-telemetry-cut", "px4-battery-low"),
    *("copter-forged-positions", "copter-signed-flight", "copter-companion", "copter-radio-flight"),
)
RIVALS = pytest.mark.parametrize(("name", "sysid"), [("forged-heartbeat-50hz", 1), ("second-heartbeat-1hz", 3)])
"""Flights beside another sender with a vehicle's ids."""

SIGNED = 0x01
"""MAVLINK_IFLAG_SIGNED."""

PX4_MODES = {name: f"AUTO.{name}" for name in ("LOITER", "MISSION", "RTL", "LAND", "TAKEOFF")}
"""pymavlink's names of PX4's modes, and skygcs's where they differ."""


class Truth:
    """A capture as pymavlink reads it."""

    def __init__(self, name: str) -> None:
        self.sources: set[tuple[int, int]] = set()
        self.messages: Counter[str] = Counter()
        self.modes: dict[int, list[str]] = {}
        self.heartbeats: list[tuple[float, Any]] = []
        """With the seconds since the first message: those of component 1."""
        self.signed = 0
        self.lost: Counter[int] = Counter()
        """Gaps in the sequence numbers of each system's autopilot."""
        last: dict[int, int] = {}
        log = mavutil.mavlink_connection(str(DATA / f"{name}.tlog"))
        first = None
        while (message := log.recv_match()) is not None:
            first = message._timestamp if first is None else first
            if message.get_type().startswith("UNKNOWN"):
                continue
            sysid, compid, seq = message.get_srcSystem(), message.get_srcComponent(), message.get_seq()
            self.sources.add((sysid, compid))
            self.messages[message.get_type()] += 1
            self.signed += bool(message.get_header().incompat_flags & SIGNED)
            if compid != 1:
                continue
            self.lost[sysid] += (seq - last.get(sysid, seq - 1) - 1) % 256
            last[sysid] = seq
            if message.get_type() == "HEARTBEAT":
                self.heartbeats.append((message._timestamp - first, message))
                mode = mavutil.mode_string_v10(message)
                if message.autopilot == mav.MAV_AUTOPILOT_PX4:
                    mode = PX4_MODES.get(mode, mode)
                _note(self.modes.setdefault(sysid, []), mode)
        log.close()

    def of(self, sysid: int, *, rival: bool = False) -> list[tuple[float, Any]]:
        """Heartbeats of the autopilot, or of who has its ids."""
        mine = [(at, m) for at, m in self.heartbeats if m.get_srcSystem() == sysid]
        return [(at, m) for at, m in mine if (m.autopilot == mav.MAV_AUTOPILOT_INVALID) is rival]


def _note(seen: list[str], mode: str) -> None:
    if seen[-1:] != [mode]:
        seen.append(mode)


class Replay:
    """A daemon that plays a capture, and what it makes of it."""

    def __init__(self, daemon: Daemon, speed: float) -> None:
        self.daemon = daemon
        self.speed = speed
        self.events: list[dict[str, Any]] = []
        self.modes: dict[int, list[str]] = {}
        self.quality: dict[int, dict[str, Any]] = {}
        """The last that was told of each vehicle's link."""
        daemon.event_log.subscribe(self.events.append)

    def kinds(self, sysid: int | None = None) -> list[str]:
        return [e["kind"] for e in self.events if sysid in (None, e["sysid"])]

    async def looks(self, every_s: float = 0.05) -> AsyncIterator[tuple[float, dict[int, dict[str, Any]]]]:
        """(seconds of the capture, states by system id), until it has ended."""
        began = self.daemon.now()
        while self.daemon.links.status()[0]["state"] != "finished":
            await asyncio.sleep(every_s)
            states = {a.sysid: a.state(self.daemon.now()) for a in self.daemon.fleet.vehicles.values()}
            for key, actor in self.daemon.fleet.vehicles.items():
                _note(self.modes.setdefault(actor.sysid, []), states[actor.sysid]["mode"])
                if (told := self.daemon.hub.statistics.link_quality(key).get("capture")) is not None:
                    self.quality[actor.sysid] = told
            yield (self.daemon.now() - began) * self.speed, states

    async def whole(self, every_s: float = 0.05) -> list[dict[int, dict[str, Any]]]:
        return [states async for _, states in self.looks(every_s)]


@contextlib.asynccontextmanager
async def replayed(tmp_path: Path, name: str, *, speed: float = 1.0, **tables: Any) -> AsyncIterator[Replay]:
    link = ReplayLinkConfig(name="capture", file=DATA / f"{name}.tlog", speed=speed)
    async with started(made_daemon(tmp_path, links={"capture": link}, **tables)) as daemon:
        replay = Replay(daemon, speed)
        yield replay
        assert "fault" not in replay.kinds() and daemon.hub.faults == 0


def default_dialect() -> Dialect:
    return load_dialect(FleetConfig().dialect)


async def test_a_captured_flight_is_seen_as_it_was(tmp_path: Path) -> None:
    """Three ArduCopters and two PX4s on one link."""
    vehicles = {"one": {"sysid": 1, "autopilot": "ardupilot"}, "four": {"sysid": 4, "autopilot": "px4"}}
    async with replayed(tmp_path, SITL, vehicles=vehicles) as replay:
        states = await replay.whole(0.5)
        assert sum(replay.daemon.hub.statistics.router_stats()["counters"].values()) == 8144, "every record was routed"
    kinds = Counter(replay.kinds())
    assert kinds["vehicle_discovered"] == kinds["armed"] == kinds["disarmed"] == 5 and not kinds["conflict"]
    found = {state["name"]: (sysid, state["autopilot"]) for sysid, state in states[-1].items()}
    copters = {"one": (1, "ardupilot"), "v2": (2, "ardupilot"), "v3": (3, "ardupilot")}
    assert found == {**copters, "four": (4, "px4"), "v5": (5, "px4")}
    flown = ["AUTO.LOITER", "AUTO.TAKEOFF", "AUTO.LOITER", "OFFBOARD", "AUTO.LOITER", "AUTO.LAND", "AUTO.LOITER"]
    assert replay.modes == {
        **{sysid: ["STABILIZE", "GUIDED", "LAND"] for sysid in (1, 2, 3)},
        **{sysid: flown for sysid in (4, 5)},
    }
    for sysid, last in states[-1].items():
        seen = [state[sysid] for state in states if sysid in state]
        assert sum(a["armed"] != b["armed"] for a, b in itertools.pairwise(seen)) == 2 and not last["armed"]
        assert max(s["position"]["alt_rel_m"] or 0.0 for s in seen if s["position"]) > 5.0
        assert last["landed"] == "on_ground" and abs(last["position"]["alt_rel_m"]) < 0.5


@pytest.mark.parametrize("name", ["px4-late-frames", "second-heartbeat-1hz"])
async def test_a_flight_that_lost_nothing_shows_no_loss(name: str, tmp_path: Path) -> None:
    """PX4 sent frames up to 12 places late, and another program a vehicle's heartbeat: 276 and 5,610 were counted."""
    async with replayed(tmp_path, name) as replay:
        await replay.whole(1.0)
    lost = {sysid: (told["lost"], told["loss_ratio"]) for sysid, told in replay.quality.items()}
    assert lost == dict.fromkeys((1, 2, 3, 11, 12), (0, 0.0))


@RIVALS
async def test_the_vehicle_keeps_its_state_and_the_rival_is_reported(tmp_path: Path, name: str, sysid: int) -> None:
    truth = Truth(name)
    beats = truth.of(sysid)
    assert len(truth.of(sysid, rival=True)) > 10
    assert {m.autopilot for _, m in beats} == {mav.MAV_AUTOPILOT_ARDUPILOTMEGA}
    compared = 0
    async with replayed(tmp_path, name, speed=4.0) as replay:
        async for at, states in replay.looks():
            if (state := states.get(sysid)) is None or at < beats[0][0]:
                continue
            assert (state["autopilot"], state["type"]) == ("ardupilot", "QUADROTOR") and state["mode"] != "UNKNOWN"
            shown = {bool(m.base_mode & 128) for t, m in beats if at - 2 <= t <= at}
            if len(shown) == 1:
                assert state["armed"] is shown.pop()
                compared += 1
    assert compared > 50
    (mine,) = [e for e in replay.events if e["sysid"] == sysid and e["kind"] in ("conflict", "duplicate", "reboot")]
    assert mine["kind"] == "conflict" and "INVALID" in mine["text"] and f"{sysid}/1" in mine["text"]
    flips = [
        after for before, after in itertools.pairwise(bool(m.base_mode & 128) for _, m in beats) if before != after
    ]
    changed = [kind for kind in replay.kinds(sysid) if kind in ("armed", "disarmed")]
    assert changed == ["armed" if armed else "disarmed" for armed in flips]


@RIVALS
def test_plots_and_tables_show_the_same(name: str, sysid: int) -> None:
    dialect = default_dialect()
    flight, tables = RecordedFlight(dialect), FlightTables(dialect)
    modes: list[str] = []
    for entry in LogReader((DATA / f"{name}.tlog").read_bytes(), dialect, "tlog"):
        flight.add(entry)
        row = tables.row(entry)
        if row is not None and row[0] == (sysid, 1) and row[1][1] not in modes:
            modes.append(row[1][1])
    flight.finish()
    numbers = dict.fromkeys(m.custom_mode for _, m in Truth(name).of(sysid))
    assert modes == [mavutil.mode_mapping_acm[n] for n in numbers]
    vehicle = flight.vehicles[sysid, 1]
    assert (vehicle.autopilot, vehicle.kind) == ("ardupilot", "quadrotor")
    assert list(dict.fromkeys(span.mode for span in vehicle.modes)) == modes


@pytest.mark.deep
@each("name", CUTS)
def test_every_frame_is_read_as_pymavlink_reads_it(name: str) -> None:
    truth = Truth(name)
    reader = LogReader((DATA / f"{name}.tlog").read_bytes(), default_dialect(), "tlog")
    frames = [entry.frame for entry in reader if entry.frame is not None]
    names = Counter(frame.name for frame in frames if frame.info is not None)
    # Either side's definitions know some messages that the other's do not: those that both know count.
    both = set(names) & set(truth.messages)
    assert len(both) > 15
    assert {name: names[name] for name in both} == {name: truth.messages[name] for name in both}
    assert {(f.sysid, f.compid) for f in frames} == truth.sources


@pytest.mark.deep
@pytest.mark.parametrize("name", [cut for cut in CUTS if cut != "copter-forged-positions"])
async def test_modes_are_those_of_the_heartbeats(name: str, tmp_path: Path) -> None:
    truth = Truth(name)
    async with replayed(tmp_path, name) as replay:
        await replay.whole()
    assert {sysid: modes for sysid, modes in replay.modes.items() if sysid in truth.modes} == truth.modes
    assert not {"duplicate", "conflict"} & set(replay.kinds())


async def test_telemetry_that_is_cut_twice_loses_the_vehicle_twice(tmp_path: Path) -> None:
    """Six seconds each, under velocity and under attitude control; both times it was found in AUTO.LOITER."""
    async with replayed(tmp_path, "px4-telemetry-cut") as replay:
        states = await replay.whole()
    kinds = Counter(replay.kinds(11))
    assert kinds["vehicle_lost"] == kinds["vehicle_back"] == 2
    assert states[-1][11]["armed"] is True


async def test_forged_positions_are_reported(tmp_path: Path) -> None:
    async with replayed(tmp_path, "copter-forged-positions") as replay:
        await replay.whole()
    assert "duplicate" in replay.kinds(21) and "duplicate" not in replay.kinds(22)


def test_signed_frames_are_counted_as_signed() -> None:
    truth = Truth("copter-signed-flight")
    reader = LogReader((DATA / "copter-signed-flight.tlog").read_bytes(), default_dialect(), "tlog")
    frames = [entry.frame for entry in reader if entry.frame is not None]
    assert sum(frame.signed for frame in frames) == truth.signed == truth.messages.total() > 600


@pytest.mark.deep
async def test_what_a_radio_lost_is_counted_as_pymavlink_counts_it(tmp_path: Path) -> None:
    truth = Truth("copter-radio-flight")
    async with replayed(tmp_path, "copter-radio-flight") as replay:
        await replay.whole()
    assert truth.messages["RADIO_STATUS"] > 20
    assert sum(truth.lost.values()) > 5
    assert {sysid: told["lost"] for sysid, told in replay.quality.items()} == dict(truth.lost)
