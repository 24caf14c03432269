"""Poses of simulated cameras, through a whole daemon in virtual time, to simulated vehicles that fly by them."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable, Coroutine
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig
from skygcs.core.mavlink.parser import FrameParser
from skygcs.daemon import Daemon
from skygcs.ext.mocap import feed as mocap_feed
from skygcs.ext.mocap.cameras import CaptureCameras
from skygcs.ext.mocap.config import MocapConfig
from skygcs.ext.mocap.pose import Pose
from skygcs.ext.mocap.simulated_capture import SimulatedCapture
from skygcs.rpc.context import state_of
from skygcs.rpc.dispatch import Dispatcher, MethodTable
from skygcs.rpc.error_codes import METHOD_NOT_FOUND
from skygcs.rpc.methods import METHODS
from skygcs.rpc.methods_on_demand import MethodsOnDemand
from skygcs.runtime.loop_clock import Standstill
from skygcs.sim.vehicle import SimVehicle
from support.called import call
from support.daemons import simulated_link, started
from support.pymav import PymavPeer

COSTS = "vehicles that fly by poses at 30 Hz"

ORIGIN = {"lat_deg": 43.7806, "lon_deg": -79.4653, "alt_amsl_m": 0.0, "x_heading_deg": 30.0}

PARAMS = {
    "px4": {"EKF2_EV_CTRL": 11, "EKF2_HGT_REF": 3, "EKF2_GPS_CTRL": 0},
    "ardupilot": {
        **{"VISO_TYPE": 1, "EK3_SRC1_POSXY": 6, "EK3_SRC1_POSZ": 6, "EK3_SRC1_VELXY": 0, "EK3_SRC1_VELZ": 0},
        **{"EK3_SRC1_YAW": 6, "GPS_TYPE": 0, "GPS1_TYPE": 0},
    },
}


@dataclass
class Lab:
    """``lab(method, **params)`` asks as a session does."""

    daemon: Daemon
    events: list[dict[str, Any]] = field(default_factory=list)

    async def __call__(self, method: str, **params: Any) -> Any:
        return await call(self.daemon, method, **params)

    @property
    def cameras(self) -> CaptureCameras:
        capture = self.daemon.extensions["mocap"].feed.capture
        assert isinstance(capture, SimulatedCapture) and capture.cameras is not None
        return capture.cameras

    def sim(self, link: str = "alpha") -> SimVehicle:
        found = simulated_link(self.daemon, link)
        return found.vehicles[0]

    async def poses(self, vehicle: str = "alpha") -> dict[str, Any]:
        status = await self("mocap.status")
        return next(v for v in status["vehicles"] if v["vehicle"] == vehicle)

    async def until(self, met: Callable[[], bool], timeout_s: float = 60.0) -> None:
        for _ in range(round(timeout_s / 0.1)):
            if met():
                return
            await asyncio.sleep(0.1)
        raise AssertionError("it did not happen in time")

    def changes(self) -> list[str]:
        return [e["data"]["change"] for e in self.events if e["kind"] == "mocap"]


@contextlib.asynccontextmanager
async def lab(
    tmp_path: Path,
    *families: str,
    params: bool = True,
    link: dict[str, Any] | None = None,
    links: dict[str, Any] | None = None,
    **mocap: Any,
) -> AsyncIterator[Lab]:
    """A vehicle of each family on a link of its own, flown by poses; ``link``: more keys of the first one; ``links``:
    further ones."""
    names = ("alpha", "bravo")[: len(families)]
    links = dict(links or {})
    for number, (name, family) in enumerate(zip(names, families, strict=True), start=1):
        file = tmp_path / f"{name}.params"
        text = "".join(f"{key} {value}\n" for key, value in PARAMS[family].items())
        if family == "px4":
            text = "".join(f"{number} 1 {key} {value} 6\n" for key, value in PARAMS[family].items())
        file.write_text(text)
        place = {"lat_deg": ORIGIN["lat_deg"], "lon_deg": ORIGIN["lon_deg"] + 5e-5 * number, "alt_amsl_m": 0.0}
        links[name] = {"type": "simulated", family: 1, "first_sysid": number, **place}
        if params:
            links[name]["params"] = file
    links["alpha"] |= link or {}
    table = {
        "daemon": {"socket": tmp_path / "s", "log_dir": tmp_path / "logs", "record": False},
        "origin": ORIGIN,
        "links": links,
        "vehicles": {name: {"sysid": number} for number, name in enumerate(names, start=1)},
    }
    capture = MocapConfig(
        **{"type": "simulated", "bodies": {name: f"body {name}" for name in names}},
        **{"up": "y", "rotation_deg": 70.0, "offset_m": (1.0, -2.0, 0.5)},
        **mocap,
    )
    config = FleetConfig.model_validate(table).model_copy(update={"extensions": {"mocap": capture}})
    daemon = Daemon(config, load_dialect(config.dialect))
    there = Lab(daemon)
    daemon.event_log.subscribe(there.events.append)
    async with started(daemon):
        await there.until(lambda: len(daemon.fleet.vehicles) == len(families))
        yield there
        assert not [e for e in there.events if e["kind"] == "fault"], there.events


@pytest.mark.parametrize("family", ["px4", "ardupilot"])
@pytest.mark.parametrize("message", ["vision_position_estimate", "odometry"])
async def test_a_vehicle_without_gps_flies_by_its_poses(tmp_path: Path, family: str, message: str) -> None:
    async with lab(tmp_path, family, message=message) as gcs:
        sim = gcs.sim()
        assert not sim.gps_ok
        await gcs.until(lambda: sim.position_ok)  # the origin was sent
        await asyncio.sleep(10)
        assert sim.vision.rejected == 0  # frames are right: x of the world 30 degrees, y up, turned and moved
        report = (await gcs("preflight.run", targets="alpha"))["vehicles"]["alpha"]
        found = {f["check"]: f["verdict"] for f in report["findings"]}
        assert (found["poses"], found["external vision"], found["ekf origin"]) == ("pass", "pass", "pass"), report
        outcome = (await gcs("vehicles.takeoff", targets="alpha", height_m=2.0))["outcomes"]["alpha"]
        assert outcome["ok"], outcome
        await gcs.until(lambda: sim.motion.up_m > 1.8)
        there = {"enu_m": [2.0, 1.0, 2.0]}
        outcome = (await gcs("vehicles.goto", targets="alpha", **there))["outcomes"]["alpha"]
        assert outcome["ok"], outcome
        await asyncio.sleep(15)
        state = state_of(gcs.daemon, gcs.daemon.fleet.find("alpha"))
        assert state["position"]["enu_m"] == pytest.approx((2.0, 1.0, 2.0), abs=0.5)
        assert state["mocap"]["problem"] is None and state["mocap"]["tracking"]
        assert sim.vision.rejected == 0
        await gcs("vehicles.land", targets="alpha")
        await gcs.until(lambda: not sim.armed)
        poses = await gcs.poses()
        assert poses["dropouts"] == 0 and poses["sent_hz"] == pytest.approx(30, abs=2)
        assert poses["latency_p50_s"] == pytest.approx(0.02, abs=0.011)


async def test_poses_go_on_after_a_standstill_over_the_link_as_it_is_then(tmp_path: Path) -> None:
    async with lab(tmp_path, "px4") as gcs:
        sim, fleet = gcs.sim(), gcs.daemon.fleet
        await gcs.until(lambda: sim.position_ok)
        await asyncio.sleep(10)
        assert (await gcs("vehicles.takeoff", targets="alpha", height_m=2.0))["outcomes"]["alpha"]["ok"]
        await gcs.until(lambda: sim.motion.up_m > 1.8)
        feed = gcs.daemon.extensions["mocap"].feed
        (fed,) = feed._fed.values()
        before = fed.actor
        fleet._woke(Standstill(10.0, slept=False))
        await gcs.until(lambda: fleet.find("alpha").vehicle.connected)
        await asyncio.sleep(5)
        assert fed.actor is fleet.find("alpha") is not before
        fed.way.channel_id = None  # as after a link that was made anew
        await asyncio.sleep(5)
        assert fed.channel is not None and sim.vision.rejected == 0 and sim.position_ok


async def test_time_stamps_are_those_of_the_capture(tmp_path: Path) -> None:
    async with lab(tmp_path, "ardupilot", latency_s=0.05, simulated={"latency_s": 0.1}) as gcs:
        await asyncio.sleep(5)
        now = gcs.daemon.now()
        last = gcs.sim().vision.usec[-1] / 1e6
        assert 0.14 <= now - last <= 0.2
        steps = [b - a for a, b in zip(gcs.sim().vision.usec, gcs.sim().vision.usec[1:], strict=False)]
        assert min(steps) > 0


@pytest.mark.parametrize("family", ["px4", "ardupilot"])
async def test_what_cameras_do_wrong_is_never_sent(tmp_path: Path, family: str) -> None:
    errors = {"occluded": 0.05, "repeated": 0.1, "jumps": 0.05}
    async with lab(tmp_path, family, simulated=errors) as gcs:
        await asyncio.sleep(30)
        poses = await gcs.poses()
        assert all(poses["rejected"][why] > 20 for why in ("occluded", "repeated", "jump")), poses
        assert poses["sent"] > 400
        assert gcs.sim().vision.rejected == 0
        assert gcs.sim().vision.count == poses["sent"]


@pytest.mark.deep
async def test_when_poses_stop_sending_stops_and_the_autopilot_lands(tmp_path: Path) -> None:
    async with lab(tmp_path, "px4") as gcs:
        sim = gcs.sim()
        await gcs.until(lambda: sim.position_ok)
        await asyncio.sleep(8)
        assert (await gcs("vehicles.takeoff", targets="alpha", height_m=2.0))["outcomes"]["alpha"]["ok"]
        await gcs.until(lambda: sim.motion.up_m > 1.8)
        gcs.cameras.hidden.add("body alpha")
        await asyncio.sleep(0.5)
        count = sim.vision.count
        await asyncio.sleep(2)
        assert sim.vision.count == count
        assert gcs.changes() == ["lost"]
        problem = (await gcs.poses())["problem"]
        assert "body alpha" in problem and "occluded" in problem
        await gcs.until(lambda: sim.motion.on_ground, 60)
        gcs.cameras.hidden.clear()
        await asyncio.sleep(2)
        assert gcs.changes() == ["lost", "back"]
        assert sim.vision.resets == 1 and (await gcs.poses())["reset_counter"] == 1


async def test_preflight_names_what_is_wrong_and_sets_it(tmp_path: Path) -> None:
    async with lab(tmp_path, "px4", params=False) as gcs:
        await asyncio.sleep(12)
        gcs.cameras.hidden.add("body alpha")
        await asyncio.sleep(1)
        report = (await gcs("preflight.run", targets="alpha"))["vehicles"]["alpha"]
        findings = {f["check"]: f for f in report["findings"]}
        assert findings["poses"]["verdict"] == "fail" and "body alpha" in findings["poses"]["text"]
        vision = findings["external vision"]
        assert vision["verdict"] == "fail"
        assert all(name in vision["text"] for name in ("EKF2_EV_CTRL is 0", "EKF2_HGT_REF is 1", "EKF2_GPS_CTRL is 7"))
        gcs.cameras.hidden.clear()
        report = (await gcs("preflight.run", targets="alpha", fix=True))["vehicles"]["alpha"]
        assert {"EKF2_EV_CTRL", "EKF2_HGT_REF", "EKF2_GPS_CTRL"} <= set(report["fixed"])
        assert gcs.sim().params["EKF2_EV_CTRL"] == 11 and gcs.sim().by_vision


async def test_a_vehicle_that_shares_its_link_gets_no_poses(tmp_path: Path) -> None:
    async with lab(tmp_path, "px4", link={"px4": 2}) as gcs:
        await asyncio.sleep(5)
        poses = await gcs.poses()
        assert poses["link"] is None and "shares its link with v2" in poses["problem"]
        assert [sim.vision.count for sim in gcs.daemon.links.link("alpha").vehicles] == [0, 0]  # type: ignore[attr-defined]


@pytest.mark.parametrize(("family", "gets_poses"), [("px4", False), ("ardupilot", True)])
async def test_a_px4_whose_origin_is_not_at_altitude_zero_gets_no_poses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, family: str, gets_poses: bool
) -> None:
    """After a drop-out it would take the height of a pose for an altitude."""
    monkeypatch.setitem(ORIGIN, "alt_amsl_m", 180.0)
    async with lab(tmp_path, family) as gcs:
        await gcs.until(lambda: gcs.sim().local_zero is not None)  # the origin was sent
        await asyncio.sleep(20)
        before = gcs.sim().vision.count
        await asyncio.sleep(2)
        assert (gcs.sim().vision.count > before) is gets_poses
        problem = (await gcs.poses())["problem"]
        report = (await gcs("preflight.run", targets="alpha"))["vehicles"]["alpha"]
        verdict = next(f["verdict"] for f in report["findings"] if f["check"] == "poses")
        if gets_poses:
            assert problem is None and verdict == "pass"
        else:
            assert "altitude of 180.0 m" in problem and "alt_amsl_m = 0" in problem and verdict == "fail"


@pytest.mark.deep
async def test_a_recording_is_not_sent_to_a_real_vehicle_that_is_armed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mocap_feed, "PRETENDED", frozenset())  # its simulated link is taken for a real one
    async with lab(tmp_path, "px4") as gcs:
        feed, sim = gcs.daemon.extensions["mocap"].feed, gcs.sim()
        monkeypatch.setattr(feed, "_config", feed._config.model_copy(update={"type": "recorded"}))
        await gcs.until(lambda: sim.position_ok)
        await asyncio.sleep(5)
        assert (await gcs("vehicles.arm", targets="alpha"))["outcomes"]["alpha"]["ok"]
        await asyncio.sleep(0.5)
        count = sim.vision.count
        await asyncio.sleep(2)
        assert sim.vision.count == count > 0
        assert "recording" in (await gcs.poses())["problem"]


@pytest.mark.deep
async def test_each_vehicle_gets_its_own_poses(tmp_path: Path) -> None:
    async with lab(tmp_path, "px4", "ardupilot") as gcs:
        await asyncio.sleep(20)
        for name in ("alpha", "bravo"):
            assert gcs.sim(name).vision.rejected == 0 and gcs.sim(name).vision.count > 400
            assert gcs.sim(name).position_ok


@pytest.mark.deep  # a minute of poses at 30 Hz
async def test_the_origin_is_sent_once_and_again_after_a_reboot(tmp_path: Path) -> None:
    async with lab(tmp_path, "ardupilot") as gcs:
        sim = gcs.sim()
        await gcs.until(lambda: sim.local_zero is not None)
        first = sim.local_zero
        await asyncio.sleep(60)
        assert sim.local_zero is first
        assert len([e for e in gcs.events if e["kind"] == "command" and "origin" in e["text"]]) == 1
        sim.faults.reboot = True
        await gcs.until(lambda: sim.local_zero is None)
        await gcs.until(lambda: sim.local_zero is not None)


@pytest.mark.deep  # half a minute of poses at 30 Hz
async def test_no_origin_is_sent_if_it_is_not_wanted(tmp_path: Path) -> None:
    async with lab(tmp_path, "ardupilot", set_origin=False) as gcs:
        await asyncio.sleep(30)
        assert gcs.sim().local_zero is None
        report = (await gcs("preflight.run", targets="alpha"))["vehicles"]["alpha"]
        (finding,) = [f for f in report["findings"] if f["check"] == "ekf origin"]
        assert finding["verdict"] == "fail" and "origin push" in finding["todo"]


@pytest.mark.deep  # poses at 30 Hz through a radio
async def test_a_slow_radio_carries_fewer_poses_and_preflight_says_so(tmp_path: Path) -> None:
    radio = {"role": "radio", "radio": {"air_kbps": 64, "baud": 57600}}
    async with lab(tmp_path, "px4", link=radio, message="odometry") as gcs:
        await asyncio.sleep(20)
        poses = await gcs.poses()
        assert 0 < poses["limit_hz"] < 10 and poses["sent_hz"] <= poses["limit_hz"] + 1
        assert "an estimator wants 10" in poses["problem"]
        (channel,) = gcs.daemon.links.link("alpha").channels
        assert channel.air is not None
        assert channel.air.status(gcs.daemon.now())["classes"]["pose"]["sent"] > 0


async def test_a_daemon_without_mocap_says_so(tmp_path: Path) -> None:
    config = FleetConfig.model_validate({"daemon": {"socket": tmp_path / "s", "record": False}})
    daemon = Daemon(config, load_dialect(config.dialect))
    request = {"jsonrpc": "2.0", "id": 1, "method": "mocap.status"}
    table = MethodTable(METHODS.values())
    on_demand = MethodsOnDemand(table, daemon.extensions, asyncio.to_thread, asyncio.get_running_loop())
    reply = Dispatcher(table, on_demand).start(SimpleNamespace(services=daemon), request)
    assert isinstance(reply, Coroutine)
    error = json.loads(await reply)["error"]
    assert error["code"] == METHOD_NOT_FOUND and "it needs the table [mocap] in the fleet file" in error["message"]


async def in_the_air(gcs: Lab, link: str = "alpha") -> SimVehicle:
    """It flies by its poses at 2 m."""
    sim = gcs.sim(link)
    await gcs.until(lambda: sim.position_ok)
    await asyncio.sleep(10)
    outcome = (await gcs("vehicles.takeoff", targets=link, height_m=2.0))["outcomes"][link]
    assert outcome["ok"], outcome
    await gcs.until(lambda: sim.motion.up_m > 1.8)
    return sim


FAMILIES = pytest.mark.parametrize("family", ["px4", "ardupilot"])


@FAMILIES
@pytest.mark.parametrize("where", ["the same id on another link", "another id on its link"])
async def test_what_is_heard_of_another_one_does_not_take_the_poses_of_one_that_flies(
    tmp_path: Path, family: str, where: str
) -> None:
    """Forged or not: after 4 s, and at once, poses ended, and after 8 to 21 s both were on the ground."""
    rival = {"rival": {"type": "memory", "role": "vehicle"}}
    async with lab(tmp_path, family, links=rival) as gcs:
        sim = await in_the_air(gcs)
        link = gcs.daemon.links.link("rival" if where.startswith("the same") else "alpha")
        sysid = 1 if where.startswith("the same") else 77
        forger, count = PymavPeer(sysid, 1), sim.vision.count
        (channel,) = link.channels
        kinds = {"px4": mav.MAV_AUTOPILOT_PX4, "ardupilot": mav.MAV_AUTOPILOT_ARDUPILOTMEGA}
        for number in range(20):
            beat = mav.MAVLink_heartbeat_message(2, kinds[family], 81, 0, 3, 3)
            clock = mav.MAVLink_system_time_message(0, 1000 * number)
            for message in (beat, clock):
                parser = FrameParser(gcs.daemon.dialect)
                gcs.daemon.hub.on_frames(channel, parser.feed_datagram(forger.pack(message)), gcs.daemon.now())
            await asyncio.sleep(1.0)
        assert sim.vision.count - count > 500, "30 a second"
        assert sim.armed and sim.motion.up_m > 1.5
        poses = await gcs.poses()
        assert poses["problem"] is None and poses["link"] == "alpha"
        assert gcs.changes().count("kept") == 1
        # the other one is not armed beside it
        if sysid == 77:
            outcome = (await gcs("vehicles.arm", targets=77))["outcomes"]["v77"]
            assert "land alpha first" in outcome["message"], outcome
        # and on the ground the ordinary choice counts again
        await gcs("vehicles.stop", targets="alpha", action="land", confirm="alpha")
        await gcs.until(lambda: not sim.armed)
        parser = FrameParser(gcs.daemon.dialect)
        gcs.daemon.hub.on_frames(channel, parser.feed_datagram(forger.pack(beat)), gcs.daemon.now())
        await asyncio.sleep(1.5)
        if sysid == 77:
            assert "shares its link" in (await gcs.poses())["problem"]


@FAMILIES
async def test_another_body_is_not_taken_for_one_that_was_lost(tmp_path: Path, family: str) -> None:
    """Bravo's markers are taken for alpha's, 0.3 s after alpha was lost: 2.4 m away that was sent."""
    async with lab(tmp_path, family) as gcs:
        sim = await in_the_air(gcs)
        gcs.cameras.hidden.add("body alpha")
        await asyncio.sleep(0.3)
        count = sim.vision.count
        feed = gcs.daemon.extensions["mocap"].feed
        last = feed._fed["body alpha"].stream.filter.accepted
        assert last is not None
        seen: set[str] = set()
        for n in range(500):
            x, y, z = last.pos_m
            pose = Pose(gcs.daemon.now(), (x + 2.4 + 1e-4 * (n % 7), y, z), last.q)
            seen.add(feed._fed["body alpha"].stream.filter.judge(pose, gcs.daemon.now(), armed=True))
            await asyncio.sleep(0.01)
        assert sim.vision.count == count
        assert "accepted" not in seen and "out of reach" in seen
