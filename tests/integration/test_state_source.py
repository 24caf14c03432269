"""Which frames count for a vehicle's state: forged frames, duplicate ids and second radios, through a whole daemon.

The vehicle flies behind the link "air"; what forges, echoes or is a second radio is behind "other".
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import encode_payload
from skygcs.core.mavlink.parser import FrameParser
from skygcs.errors import RefusedError
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from support.daemons import memory_link
from support.flown import FIELD, KINDS, Flown, aloft
from support.pymav import PymavPeer

COPTER = {"px4": 0, "ardupilot": 1}
ARMED, DISARMED = 0x81, 0x51


class Other:
    """Somebody behind the second link who sends with the vehicle's ids."""

    def __init__(self, gcs: Flown) -> None:
        link = memory_link(gcs.daemon, "other")
        self.gcs = gcs
        self.peer = link.peer
        self.got: list[str] = []
        self.reaches = False
        """Whether what is sent here reaches the vehicle."""
        self.hears = False
        """Whether the vehicle's frames come over here, as over a second radio of it."""
        self.echoes = False
        self.delay_s = 0.0
        self._voice = PymavPeer(1, 1)
        self._seq = 0
        self._parser = FrameParser(gcs.daemon.dialect)
        self._sent = FrameParser(gcs.daemon.dialect)
        self.peer.on_bytes = self._on_bytes
        gcs.also.append(self._on_vehicle)
        self._tasks: list[asyncio.Task[None]] = []

    def say(self, message: Any) -> None:
        self.peer.send(self._voice.pack(message))

    def heartbeat(self, mode: int = 0, *, armed: bool = False, kind: int = 2, autopilot: int | None = None) -> None:
        own = self.gcs.actor().vehicle.autopilot if autopilot is None else autopilot
        self.say(mav.MAVLink_heartbeat_message(kind, own, ARMED if armed else DISARMED, mode, 3, 3))

    def position(self, east_m: float, boot_ms: int) -> None:
        lat_deg, lon_deg = FIELD.to_geodetic(east_m, 0.0)
        lat, lon = round(lat_deg * 1e7), round(lon_deg * 1e7)
        message = mav.MAVLink_global_position_int_message(boot_ms, lat, lon, 190_000, 10_000, 0, 0, 0, 0)
        self.say(message)

    def bench_vehicle(self) -> None:
        """Another vehicle with the same system id is switched on, on the ground, 5 m away."""

        async def live() -> None:
            booted_at = self.gcs.now
            while True:
                boot_ms = round((self.gcs.now - booted_at) * 1000) + 1500
                self.heartbeat(mode=0)
                self.say(mav.MAVLink_attitude_message(boot_ms, 0, 0, 0, 0, 0, 0))
                lat_deg, lon_deg = FIELD.to_geodetic(5.0, 0.0)
                lat, lon = round(lat_deg * 1e7), round(lon_deg * 1e7)
                self.say(mav.MAVLink_global_position_int_message(boot_ms, lat, lon, 180_000, 0, 0, 0, 0, 0))
                self.say(mav.MAVLink_system_time_message(1_700_000_000_000_000, boot_ms))
                await asyncio.sleep(1.0)

        self._tasks.append(asyncio.create_task(live()))

    def every(self, period_s: float, say: Any) -> None:
        async def repeat() -> None:
            while True:
                say()
                await asyncio.sleep(period_s)

        self._tasks.append(asyncio.create_task(repeat()))

    async def quiet(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks.clear()

    def _on_vehicle(self, raw: bytes) -> None:
        (frame,) = FrameParser(self.gcs.daemon.dialect).feed_datagram(raw)
        assert frame.info is not None
        if self.hears:  # a radio of its own: its numbering is its own
            self._seq = (self._seq + 1) & 0xFF
            payload = frame.payload.ljust(frame.info.length, b"\0")
            raw = encode_payload(frame.info, payload, sysid=frame.sysid, compid=frame.compid, seq=self._seq)
        elif not self.echoes:
            return
        asyncio.get_running_loop().call_later(self.delay_s, self.peer.send, raw)

    def _on_bytes(self, data: bytes) -> None:
        for frame in self._parser.feed(data):
            if frame.target()[0] == 1:
                self.got.append(frame.name)
            if self.reaches:
                self.gcs.to_vehicles(frame)


@contextlib.asynccontextmanager
async def beside(tmp_path: Path, *, height_m: float = 10.0, **kind: Any) -> AsyncIterator[tuple[Flown, Other]]:
    other = {"other": {"type": "memory", "role": "peer", "cost": 20}}  # as "air": nobody is preferred
    async with aloft(tmp_path, height_m=height_m, links=other, **kind) as gcs:
        somebody = Other(gcs)
        await asyncio.sleep(4)  # heard for so long, its heartbeats outweigh those of somebody else
        try:
            yield gcs, somebody
        finally:
            await somebody.quiet()


def state(gcs: Flown) -> dict[str, Any]:
    return gcs.actor().state(gcs.now)


def changes(gcs: Flown, since: float) -> list[str]:
    return [t.data["change"] for t in gcs.told if t.at >= since and t.kind in ("duplicate", "conflict")]


def holds(gcs: Flown) -> bool:
    return gcs.sim().mode in (Px4Mode.LOITER, CopterMode.BRAKE, CopterMode.GUIDED)


# -- (a) a companion's heartbeat with the vehicle's ids


@KINDS
@pytest.mark.parametrize("period_s", [1.0, 0.02])
@pytest.mark.parametrize("there", ["same channel", "other channel"])
async def test_a_companions_heartbeat_changes_nothing_and_stop_works(
    tmp_path: Path, kind: dict[str, int], period_s: float, there: str
) -> None:
    async with beside(tmp_path, **kind) as (gcs, other):
        if there == "same channel":
            other.peer = gcs.link.peer
        before, seen = state(gcs), gcs.now
        other.every(period_s, lambda: other.heartbeat(kind=18, autopilot=8))
        for n in range(6):
            await asyncio.sleep(5.3 + 0.17 * n)
            now = state(gcs)
            assert [now[k] for k in ("autopilot", "type", "mode", "armed")] == [
                before[k] for k in ("autopilot", "type", "mode", "armed")
            ]
            with pytest.raises(AssertionError, match=r"armed|in the air"):
                await gcs.done("vehicles.reboot")
            with pytest.raises(AssertionError, match="in the air"):
                await gcs.done("vehicles.set_home")
            assert (await gcs.outcome("vehicles.stop", action="hold"))["ok"], n
            assert (await gcs.outcome("vehicles.goto", enu_m=[float(n), 3.0, 10.0]))["ok"], n
            before = state(gcs)
        assert [t.kind for t in gcs.told if t.at >= seen and t.kind in ("conflict", "duplicate")] == ["conflict"]
        (said,) = [t.text for t in gcs.told if t.at >= seen and t.kind == "conflict"]
        assert "1/1" in said
        assert not state(gcs)["duplicate_sysid"]


# -- (b) a disarmed heartbeat


@KINDS
async def test_one_forged_disarmed_heartbeat_from_another_peer_changes_nothing(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with beside(tmp_path, **kind) as (gcs, other):
        await gcs.fly("attitude")
        await gcs.step(2.0, 0.0, 0.0)
        seen = gcs.now
        other.heartbeat(armed=False)
        await asyncio.sleep(10)
        assert state(gcs)["armed"] and gcs.control()["state"] == "flying"
        assert gcs.texts(seen) == [] and gcs.last_setpoint() > gcs.now - 0.1
        assert [t.kind for t in gcs.told if t.at >= seen and t.kind in ("armed", "disarmed", "mode")] == []
        assert changes(gcs, seen) == ["ignored"]
        (said,) = gcs.texts(seen, "conflict")
        assert "other (memory)" in said and "air (memory)" in said
        await gcs.done("vehicles.hold")


@pytest.mark.deep
@KINDS
async def test_a_disarmed_heartbeat_on_the_vehicles_own_channel_ends_in_a_hold(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with beside(tmp_path, **kind) as (gcs, other):
        await gcs.fly("attitude")
        await gcs.step(2.0, 0.0, 0.0)
        other.peer = gcs.link.peer
        seen = gcs.now
        other.heartbeat(mode=gcs.sim().mode, armed=False)
        await gcs.ends_safe(within_m=5.0, since=seen)
        assert holds(gcs) and state(gcs)["armed"]
        assert gcs.texts(seen)[0].startswith("holding, nothing more is sent: its heartbeat shows it disarmed, but")


@pytest.mark.deep  # as a forged arming state
@KINDS
async def test_a_forged_mode_on_the_vehicles_own_channel_ends_in_a_hold(tmp_path: Path, kind: dict[str, int]) -> None:
    """Control ends, for a pilot may have taken over; but when the next heartbeat shows it was none, it holds."""
    async with beside(tmp_path, **kind) as (gcs, other):
        await gcs.fly("attitude")
        await gcs.step(2.0, 0.0, 0.0)
        other.peer = gcs.link.peer
        seen = gcs.now
        other.heartbeat(mode=Px4Mode.POSCTL if kind.get("px4") else CopterMode.LOITER, armed=True)
        await gcs.ends_safe(within_m=5.0, since=seen)
        assert gcs.sim().mode in (Px4Mode.LOITER, CopterMode.BRAKE, CopterMode.GUIDED)
        assert [int(c.values["command"]) for c in gcs.commands(seen)][:1] == [*gcs.hold_commands][:1]


@KINDS
async def test_two_senders_on_the_vehicles_own_channel_end_in_a_hold_and_stop_works(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with beside(tmp_path, **kind) as (gcs, other):
        await gcs.fly("attitude")
        other.peer = gcs.link.peer
        seen = gcs.now
        other.every(1.0, lambda: other.heartbeat(mode=0, armed=False))
        await asyncio.sleep(8)
        assert gcs.farthest_m(seen) < 5.0 and holds(gcs)
        now = state(gcs)
        assert now["armed"] and now["duplicate_sysid"]
        outcome = await gcs.outcome("vehicles.goto", enu_m=[5.0, 0.0, 10.0])
        assert outcome["result"] == "refused" and "two vehicles with system id 1" in outcome["message"]
        assert (await gcs.outcome("vehicles.stop", action="hold"))["ok"]
        assert (await gcs.outcome("vehicles.rtl"))["ok"]
        await other.quiet()
        await asyncio.sleep(10)
        assert changes(gcs, seen)[-1] == "duplicate_over"
        assert (await gcs.outcome("vehicles.hold"))["ok"]
        assert (await gcs.outcome("vehicles.goto", enu_m=[5.0, 0.0, 10.0]))["ok"]


@KINDS
async def test_a_bench_vehicle_of_the_same_id_ends_no_flight(tmp_path: Path, kind: dict[str, int]) -> None:
    async with beside(tmp_path, **kind) as (gcs, other):
        await gcs.fly("attitude")
        await gcs.step(3.0, 0.0, 0.0)
        seen = gcs.now
        other.bench_vehicle()
        await asyncio.sleep(20)
        assert gcs.control()["state"] == "flying" and gcs.texts(seen) == []
        assert gcs.farthest_m(seen) < 4.0
        events = [t for t in gcs.told if t.at >= seen and t.kind in ("reboot", "duplicate", "conflict", "disarmed")]
        assert [t.kind for t in events] == ["duplicate"], "and no reboot"
        assert "other (memory)" in events[0].text and "air (memory)" in events[0].text
        assert state(gcs)["duplicate_sysid"] and state(gcs)["armed"]
        outcome = await gcs.outcome("vehicles.takeoff")
        assert outcome["result"] == "refused"
        other.got.clear()
        for order in ("vehicles.hold", "vehicles.rtl", "vehicles.land"):
            assert (await gcs.outcome(order))["ok"], order
        assert other.got.count("COMMAND_LONG") >= 3, "and to every channel"
        with pytest.raises(RefusedError, match=r"other \(memory\).*'disarm-2'"):
            await gcs("vehicles.disarm", targets="v1", force=True)
        with pytest.raises(RefusedError, match=r"other \(memory\).*'kill-2'"):
            await gcs("vehicles.stop", targets="v1", action="kill", confirm="kill-1")
        await other.quiet()
        await asyncio.sleep(8)
        assert changes(gcs, seen) == ["duplicate", "duplicate_over"]
        assert not state(gcs)["duplicate_sysid"]
        assert (await gcs.outcome("vehicles.hold"))["ok"]
        assert (await gcs.outcome("vehicles.goto", enu_m=[0.0, 0.0, 10.0]))["ok"], "everything is as before"


# -- (c) forged positions


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("boot", ["another clock", "the vehicle's clock"])
async def test_forged_positions_move_no_vehicle_and_are_a_duplicate(
    tmp_path: Path, kind: dict[str, int], boot: str
) -> None:
    async with beside(tmp_path, **kind) as (gcs, other):
        await gcs.fly("attitude")
        await asyncio.sleep(3)
        seen = gcs.now

        def forge() -> None:
            position = gcs.actor().vehicle.telemetry("position")
            assert position is not None
            boot_ms = 77_000 if boot == "another clock" else round(position["time_boot_s"] * 1000)
            other.position(30.0, boot_ms)

        other.every(0.05, forge)
        await asyncio.sleep(20)
        assert gcs.farthest_m(seen) < 1.0
        assert gcs.control()["state"] == "flying"
        assert changes(gcs, seen) == ["duplicate"]
        (said,) = gcs.texts(seen, "duplicate")
        assert ("other (memory)" in said and "position" in said) or "boot time" in said


# -- (d) an echo


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("delay_s", [0.0, 0.2, 1.5])
async def test_a_peer_that_echoes_telemetry_gets_no_orders(
    tmp_path: Path, kind: dict[str, int], delay_s: float
) -> None:
    async with beside(tmp_path, **kind) as (gcs, other):
        other.echoes, other.delay_s = True, delay_s
        await asyncio.sleep(30)
        other.got.clear()
        mode, number = ("AUTO.LOITER", Px4Mode.LOITER) if kind.get("px4") else ("BRAKE", CopterMode.BRAKE)
        outcome = await gcs.outcome("vehicles.mode", mode=mode)
        assert outcome["ok"] and outcome["attempts"] == 1 and gcs.sim().mode == number
        assert other.got == [], "nothing went to the echo"
        assert changes(gcs, 0.0) == []


# -- two radios


def both_ways(gcs: Flown, other: Other) -> None:
    other.hears = other.reaches = True


@pytest.mark.deep  # three changes of mode over two links
async def test_two_radios_one_of_them_slow_are_no_duplicate_when_the_mode_changes(tmp_path: Path) -> None:
    async with beside(tmp_path, **COPTER) as (gcs, other):
        both_ways(gcs, other)
        other.delay_s = 1.5
        seen = gcs.now
        for _ in range(5):
            assert (await gcs.outcome("vehicles.hold"))["ok"]
            await asyncio.sleep(7)
            assert (await gcs.outcome("vehicles.goto", enu_m=[20.0, 0.0, 10.0]))["ok"]
            await asyncio.sleep(7)
            assert (await gcs.outcome("vehicles.goto", enu_m=[0.0, 0.0, 10.0]))["ok"]
            await asyncio.sleep(7)
        assert changes(gcs, seen) == []


# -- it restarts


@pytest.mark.deep  # a minute over two links
@KINDS
@pytest.mark.parametrize("where", ["same channel", "other channel"])
async def test_a_reboot_is_seen_on_the_same_and_on_another_channel(
    tmp_path: Path, kind: dict[str, int], where: str
) -> None:
    async with beside(tmp_path, height_m=3.0, **kind) as (gcs, other):
        await gcs.done("vehicles.land")
        await gcs.until(lambda: not gcs.sim().armed, 60.0)
        await asyncio.sleep(15)
        seen = gcs.now
        gcs.sim().faults.reboot = True
        if where == "other channel":
            gcs.cut = True
            both_ways(gcs, other)
        await gcs.until(lambda: [t for t in gcs.told if t.kind == "reboot" and t.at >= seen], 30.0)
        await asyncio.sleep(20)
        now = state(gcs)
        assert now["connected"] and now["uptime_s"] < 45 and not now["duplicate_sysid"]
        assert len([t for t in gcs.told if t.kind == "reboot" and t.at >= seen]) == 1
        assert "duplicate" not in changes(gcs, seen)
        await gcs.done("vehicles.takeoff", height_m=3.0, wait_s=60.0)
