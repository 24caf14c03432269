"""Flights recorded on real firmware beside another sender with a vehicle's ids, replayed through the whole daemon.

What is true of the vehicle is read by pymavlink: the heartbeats of its autopilot.
"""

from __future__ import annotations

import asyncio
import itertools
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig, ReplayLinkConfig
from skygcs.ext.logs.flight import RecordedFlight
from skygcs.ext.logs.tables import FlightTables
from skygcs.tlog.reading import LogReader
from support.daemons import made_daemon

DATA = Path(__file__).parents[1] / "data"
RIVALS = pytest.mark.parametrize(("name", "sysid"), [("forged-heartbeat-50hz", 1), ("second-heartbeat-1hz", 3)])
SPEED = 4.0


def heartbeats(name: str, sysid: int) -> list[tuple[float, Any]]:
    """(time, message) of all heartbeats with the vehicle's ids."""
    log = mavutil.mavlink_connection(str(DATA / f"{name}.tlog"))
    found, first = [], None
    while (message := log.recv_match()) is not None:
        first = message._timestamp if first is None else first
        if (message.get_type(), message.get_srcSystem(), message.get_srcComponent()) == ("HEARTBEAT", sysid, 1):
            found.append((message._timestamp - first, message))
    log.close()
    return found


@pytest.mark.looptime
@RIVALS
async def test_the_vehicle_keeps_its_state_and_the_rival_is_reported(tmp_path: Path, name: str, sysid: int) -> None:
    truth = [(at, m) for at, m in heartbeats(name, sysid) if m.autopilot != mav.MAV_AUTOPILOT_INVALID]
    third_party = [m for _, m in heartbeats(name, sysid) if m.autopilot == mav.MAV_AUTOPILOT_INVALID]
    assert len(third_party) > 10 and {m.autopilot for _, m in truth} == {mav.MAV_AUTOPILOT_ARDUPILOTMEGA}
    daemon = made_daemon(
        tmp_path, links={"capture": ReplayLinkConfig(name="capture", file=DATA / f"{name}.tlog", speed=SPEED)}
    )
    events: list[dict[str, Any]] = []
    daemon.event_log.subscribe(events.append)
    running = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    began, seen, states = daemon.now(), 0, 0
    while seen < len(truth):
        await asyncio.sleep(0.05)
        actor = daemon.fleet.vehicles.get(sysid << 8 | 1)
        at = (daemon.now() - began) * SPEED
        seen = sum(t <= at for t, _ in truth)
        if actor is None or seen == 0:
            continue
        state, shown = actor.state(daemon.now()), {bool(m.base_mode & 128) for t, m in truth if at - 2 <= t <= at}
        assert (state["autopilot"], state["type"]) == ("ardupilot", "QUADROTOR")
        if len(shown) == 1:
            assert state["armed"] is shown.pop()
            states += 1
        assert state["mode"] != "UNKNOWN"
    daemon.stop()
    await running
    assert states > 50
    mine = [e for e in events if e["sysid"] == sysid and e["kind"] in ("conflict", "duplicate", "reboot")]
    assert [e["kind"] for e in mine] == ["conflict"], "once"
    assert "INVALID" in mine[0]["text"] and f"{sysid}/1" in mine[0]["text"]
    changed = [e["kind"] for e in events if e["sysid"] == sysid and e["kind"] in ("armed", "disarmed")]
    armed = [bool(m.base_mode & 128) for _, m in truth]
    flips = [a for b, a in itertools.pairwise(armed) if a != b]
    assert changed == ["armed" if a else "disarmed" for a in flips]
    assert not [e for e in events if e["kind"] == "fault"]


@RIVALS
def test_plots_and_tables_show_the_same(name: str, sysid: int) -> None:
    dialect = load_dialect(FleetConfig().dialect)
    flight, tables = RecordedFlight(dialect), FlightTables(dialect)
    modes: list[str] = []
    for entry in LogReader((DATA / f"{name}.tlog").read_bytes(), dialect, "tlog"):
        flight.add(entry)
        row = tables.row(entry)
        if row is not None and row[0] == (sysid, 1) and row[1][1] not in modes:
            modes.append(row[1][1])
    flight.finish()
    numbers: list[int] = []
    for _, m in heartbeats(name, sysid):
        if m.autopilot != mav.MAV_AUTOPILOT_INVALID and m.custom_mode not in numbers:
            numbers.append(m.custom_mode)
    names = mavutil.mode_mapping_acm
    assert modes == [names[n] for n in numbers]
    vehicle = flight.vehicles[sysid, 1]
    assert (vehicle.autopilot, vehicle.kind) == ("ardupilot", "quadrotor")
    assert list(dict.fromkeys(span.mode for span in vehicle.modes)) == modes
