"""Eight programs on one emulated radio, all of one id, each bound to a vehicle; a whole daemon in virtual time."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import Frame
from skygcs.errors import ConfigError, LinkError, RefusedError
from support.called import sender_of
from support.daemons import listening, memory_link
from support.on_air import OnAir, on_air
from support.pymav import PymavPeer

VEHICLES = range(1, 9)
RADIO = {"px4": 4, "ardupilot": 4, "radio": {"air_kbps": 125}, "link": {"stream_profile": "monitor"}}
BAD = {"loss": 0.1, "duplicate": 0.1, "delay_s": 0.02, "jitter_s": 0.1}
FORCE = 21196
"""MAV_CMD_COMPONENT_ARM_DISARM's param2: without the checks before arming."""


class Program(PymavPeer):
    """What a script of pymavlink does: takes the first vehicle it hears for its own, asks again if nobody answers."""

    def __init__(self, air: OnAir, name: str) -> None:
        super().__init__(255, 0)
        link = memory_link(air.daemon, name)
        self.name = name
        self.peer = link.peer
        self.peer.on_bytes = self.parse
        self.air = air
        self.target = 0

    @classmethod
    async def start(cls, air: OnAir, vehicle: int | str, **keys: Any) -> Program:
        name = f"p{vehicle}"
        await air.daemon.links.add(name, {"type": "memory", "role": "gcs", "vehicles": [vehicle], **keys})
        await air.until(lambda: air.daemon.links.link(name).channels)  # type: ignore[union-attr]
        return cls(air, name)

    @property
    def counters(self) -> dict[str, Any]:
        row = next(row for row in self.air.daemon.links.status() if row["name"] == self.name)
        return dict(row["channels"][0])

    def sources(self) -> set[int]:
        return {m.get_srcSystem() for m in self.seen}

    def got(self, kind: str) -> list[Any]:
        return [m for m in self.seen if m.get_type() == kind]

    async def wait_heartbeat(self) -> None:
        await self.air.until(lambda: self.got("HEARTBEAT"))
        self.target = self.got("HEARTBEAT")[0].get_srcSystem()

    async def asked(self, message: Any, answer: str) -> Any:
        """Send it every 3 s until an answer comes."""
        before = len(self.got(answer))
        for _ in range(20):
            self.peer.send(self.pack(message))
            for _ in range(30):
                await asyncio.sleep(0.1)
                if len(self.got(answer)) > before:
                    return self.got(answer)[before]
        raise AssertionError(f"{self.name}: no {answer}")

    async def arm(self) -> None:
        order = mav.MAVLink_command_long_message(self.target, 1, 400, 0, 1, FORCE, 0, 0, 0, 0, 0)
        ack = await self.asked(order, "COMMAND_ACK")
        assert (ack.command, ack.result, ack.get_srcSystem()) == (400, 0, self.target)


def overhear(air: OnAir) -> list[tuple[int, Frame]]:
    """What reaches each vehicle from now on, of all but skygcs itself."""
    heard: list[tuple[int, Frame]] = []
    for sim in air.link.vehicles:

        def hear(frame: Frame, _: float, sysid: int = sim.sysid) -> None:
            if (frame.sysid, frame.compid) != (255, 25):
                heard.append((sysid, frame))

        listening(sim, hear)
    return heard


@pytest.mark.parametrize("shown", [None, 1], ids=["as they are", "all as system 1"])
@pytest.mark.parametrize("network", [{}, BAD], ids=["good network", "bad network"])
async def test_eight_programs_fly_eight_vehicles(tmp_path: Path, shown: int | None, network: dict[str, Any]) -> None:
    radio = {**RADIO, "radio": {"air_kbps": 125, "loss": 0.05 if network else 0.0}}
    async with on_air(tmp_path, **radio) as air:
        for sim in air.link.vehicles:
            for delay in ("DISARM_DELAY", "COM_DISARM_PRFLT"):  # none disarms by itself while others still ask
                sim.params.set(delay, 0.0)
        heard = overhear(air)
        programs = {}
        for n, sysid in enumerate(VEHICLES):
            programs[sysid] = await Program.start(air, sysid, translated_sysid=shown, seed=n, **network)
        for program in programs.values():
            program.peer.send(program.heartbeat(vehicle=False))
        for sysid, program in programs.items():
            await program.wait_heartbeat()
            assert program.target == (shown or sysid)
        await asyncio.sleep(6.0)  # PX4 1.16 does not arm without a position, by force neither
        first = [programs[sysid] for sysid in (1, 3, 6, 8)]
        await asyncio.gather(*(program.arm() for program in first))
        assert {sim.sysid for sim in air.link.vehicles if sim.armed} == {1, 3, 6, 8}
        await asyncio.sleep(5)
        asking = {program.name for program in programs.values() if program.got("COMMAND_ACK")}
        assert asking == {"p1", "p3", "p6", "p8"}, "no answer to others, though all have one id"
        await asyncio.gather(*(programs[sysid].arm() for sysid in (2, 4, 5, 7)))
        assert all(sim.armed for sim in air.link.vehicles)
        for sysid, program in programs.items():
            assert program.sources() == {shown or sysid}, "its vehicle, and not even skygcs"
            assert program.counters["out_of_bounds"] == 0
            assert {m.get_srcComponent() for m in program.got("HEARTBEAT")} == {1}
        third_party = [frame for _, frame in heard]
        assert third_party
        assert all(frame.name == "COMMAND_LONG" for frame in third_party), "no program's heartbeat is on the radio"
        armed_by = {(sysid, frame.target()[0]) for sysid, frame in heard if frame.target()[0] == sysid}
        assert armed_by == {(sysid, sysid) for sysid in VEHICLES}
        assert {key >> 8 for key in air.daemon.fleet.vehicles} == set(VEHICLES)
        sources = {key >> 8 for key in air.channel.sources}
        assert sources <= {*VEHICLES, 51}, "real ids are what is counted"


async def test_a_script_may_ask_before_it_has_heard_anybody(tmp_path: Path) -> None:
    """pymavlink's target_system is 0 until the first heartbeat: its one vehicle is meant, not the whole fleet."""
    async with on_air(tmp_path, **RADIO) as air:
        heard = overhear(air)
        await air.until(lambda: len(air.daemon.fleet.vehicles) == len(VEHICLES))
        program = await Program.start(air, 6, translated_sysid=1)
        request = mav.MAVLink_param_request_read_message(0, 0, b"ARMING_CHECK", -1)
        value = await program.asked(request, "PARAM_VALUE")
        assert (value.param_id, value.get_srcSystem()) == ("ARMING_CHECK", 1)
        assert {frame.target()[0] for _, frame in heard} == {6}
        assert program.counters["retargeted"] >= 1


@pytest.mark.deep
async def test_who_reaches_for_another_vehicle_is_told_once_and_reaches_nobody(tmp_path: Path) -> None:
    async with on_air(tmp_path, **RADIO) as air:
        heard = overhear(air)
        await air.until(lambda: len(air.daemon.fleet.vehicles) == len(VEHICLES))
        program = await Program.start(air, 6, translated_sysid=1)
        for target in (6, 2, 255, 2, 6):
            program.peer.send(program.command(target, 1, p1=1.0, p2=float(FORCE)))
            await asyncio.sleep(0.1)
        await asyncio.sleep(10)
        assert not heard
        assert not any(sim.armed for sim in air.link.vehicles)
        assert program.counters["out_of_bounds"] == 5
        reported = air.events("warning")
        assert len(reported) == 3
        assert reported[1] == (
            "p6 (memory): 255/0 addressed system 2, and this link is bound to 6 as 1: dropped, as all such frames; "
            "what may be addressed there: 1"
        )
        assert "addressed system 6" in reported[0], "the real id is nobody to who knows its vehicle as 1"
        assert "addressed system 255" in reported[2]


async def test_two_vehicles_of_one_program_are_never_meant_both(tmp_path: Path) -> None:
    async with on_air(tmp_path, **RADIO) as air:
        heard = overhear(air)
        await air.until(lambda: len(air.daemon.fleet.vehicles) == len(VEHICLES))
        await air.daemon.links.add("pair", {"type": "memory", "role": "gcs", "vehicles": [2, 6]})
        await air.until(lambda: air.daemon.links.link("pair").channels)  # type: ignore[union-attr]
        program = Program(air, "pair")
        program.peer.send(program.command(0, 0, p1=1.0, p2=float(FORCE)))
        await air.until(lambda: air.events("warning"))
        assert "addressed all systems (target 0)" in air.events("warning")[0]
        program.target = 6
        await program.arm()
        assert {sysid for sysid, frame in heard if frame.target()[0] == sysid} == {6}
        await air.until(lambda: program.sources() == {2, 6})


async def test_a_recording_and_what_is_told_of_vehicles_hold_real_ids(tmp_path: Path) -> None:
    async with on_air(tmp_path, **RADIO) as air:
        recorded: list[bytes] = []
        air.daemon.hub._record = lambda raw, unix_us: recorded.append(raw)
        program = await Program.start(air, 6, translated_sysid=1)
        await program.wait_heartbeat()
        await program.arm()
        orders = [raw for raw in recorded if raw[0] == 0xFD and raw[7:10] == b"\x4c\0\0" and raw[5:7] == b"\xff\0"]
        assert orders
        assert {raw[10 + 30] for raw in orders} == {6}
        assert not any(raw[5] == 1 and raw[7:10] == b"\x4d\0\0" for raw in recorded), "6 answered, not 1"


async def test_nothing_of_ours_is_sent_to_a_program_not_even_on_request(tmp_path: Path) -> None:
    async with on_air(tmp_path, **RADIO) as air:
        program = await Program.start(air, 6)
        await program.wait_heartbeat()
        with pytest.raises(RefusedError, match="bound to vehicles"):
            sender_of(air.daemon).send("STATUSTEXT", {"text": "hello"}, link="p6")
        sender_of(air.daemon).send("SYSTEM_TIME", {})
        await asyncio.sleep(3)
        assert program.sources() == {6}


async def test_a_link_that_cannot_be_bound_so_is_refused_at_run_time(tmp_path: Path) -> None:
    async with on_air(tmp_path, **RADIO) as air:
        with pytest.raises(LinkError, match='needs role = "gcs"'):
            await air.daemon.links.add("x", {"type": "memory", "vehicles": [6]})
        with pytest.raises(LinkError, match="no vehicle 'kite'"):
            await air.daemon.links.add("x", {"type": "memory", "role": "gcs", "vehicles": ["kite"]})
        with pytest.raises(ConfigError):
            await air.daemon.links.add("x", {"type": "memory", "role": "gcs", "vehicles": [6], "translated_sysid": 300})
        program = await Program.start(air, "v6")
        await program.wait_heartbeat()
        row = next(row for row in air.daemon.links.status() if row["name"] == "pv6")
        assert (row["vehicles"], row["translated_sysid"]) == (["v6"], None)
