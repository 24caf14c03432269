"""A vehicle is its system: what companions, cameras and gimbals say is found under its name, and they take orders."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.vehicle.component import MAX_MESSAGES
from skygcs.runtime.components import GIVES_WAY_S, MAX_COMPONENTS, MAX_OF_SYSTEM
from support.asked import Asked, asked
from support.hosts import until
from support.loops import on_every_loop
from support.process import free_port
from support.pymav import PymavPeer
from support.routed import DIALECT, message

FLEET = {"vehicles": {"kite": {"sysid": 7}}}


def beat(kind: int, autopilot: int = 8) -> Any:
    return mav.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3)


def text(words: bytes, severity: int = 6) -> Any:
    return mav.MAVLink_statustext_message(severity, words)


def vision(usec: int) -> Any:
    return mav.MAVLink_vision_position_estimate_message(usec, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0)


class System:
    """Components of one system, each with a voice of its own, behind the memory link."""

    def __init__(self, gcs: Asked, sysid: int = 7) -> None:
        self.gcs, self.sysid = gcs, sysid
        self.voices: dict[int, PymavPeer] = {}

    def say(self, compid: int, *messages: Any) -> None:
        voice = self.voices.setdefault(compid, PymavPeer(self.sysid, compid))
        self.gcs.send(b"".join(map(voice.pack, messages)))

    def whole(self) -> None:
        """An ArduCopter, a companion, a camera, a gimbal and an ADS-B receiver, once each."""
        self.say(1, beat(2, 3))
        for compid, kind in ((191, 18), (100, 30), (154, 26), (156, 27)):
            self.say(compid, beat(kind))


async def told(gcs: Asked, method: str, **params: Any) -> Any:
    number = gcs.ask(method, params)
    for _ in range(200):
        if (answer := gcs.answer(number)) is not None:
            return answer["result"] if "result" in answer else answer["error"]
        await asyncio.sleep(0.1)
    raise AssertionError(f"{method} was not answered")


def listed(state: dict[str, Any]) -> dict[int, tuple[str | None, bool]]:
    return {c["compid"]: (c["type"], c["autopilot"]) for c in state["components"]}


@pytest.mark.parametrize("companion_first", [True, False])
async def test_what_a_companion_says_is_found_under_its_vehicle(tmp_path: Path, companion_first: bool) -> None:
    async with asked(tmp_path, **FLEET) as gcs:
        system = System(gcs)
        order = [(191, beat(18)), (1, beat(2, 3))]
        for compid, heartbeat in order if companion_first else reversed(order):
            system.say(compid, heartbeat)
            await asyncio.sleep(0.2)
        watching = await told(gcs, "subscribe", topic="messages", targets="kite", names=["VISION_POSITION_ESTIMATE"])
        assert "subscription" in watching
        following = await told(gcs, "subscribe", topic="events", targets="kite", names=["statustext"])
        assert "subscription" in following
        system.say(191, vision(5), text(b"camera ready"))
        await asyncio.sleep(0.5)
        (message,) = [n["params"]["message"] for n in gcs.notices if n["method"] == "message"]
        assert (message["vehicle"], message["source"], message["sysid"], message["compid"]) == (
            "kite",
            "kite/191",
            7,
            191,
        )
        (event,) = [n["params"]["event"] for n in gcs.notices if n["method"] == "event"]
        assert event["text"] == "kite/191: camera ready" and event["vehicle"] == "kite"
        assert event["data"] == {"severity": "info", "level": 6, "text": "camera ready", "compid": 191}
        last = await told(gcs, "messages.latest", target="kite", name="VISION_POSITION_ESTIMATE")
        assert last["compid"] == 191 and last["fields"]["usec"] == 5 and last["count"] == 1
        state = await told(gcs, "vehicles.get", target="kite")
        assert listed(state) == {1: ("QUADROTOR", True), 191: ("ONBOARD_CONTROLLER", False)}
        (companion,) = [c for c in state["components"] if c["compid"] == 191]
        assert companion["name"] == "ONBOARD_COMPUTER" and companion["messages"] == 3 and companion["age_s"] < 1.0
        shown = state["companion"]
        assert shown["name"] is None and shown["link"] is None and shown["age_s"] == pytest.approx(0.5, abs=0.1)
        assert (await told(gcs, "vehicles.get", target="v1"))["companion"] is None
        assert [(t["compid"], t["text"]) for t in state["status_texts"]] == [(191, "camera ready")]
        assert state["autopilot"] == "ardupilot" and state["type"] == "QUADROTOR", "the state is the autopilot's"


async def test_all_components_are_listed_also_those_without_a_vehicle(tmp_path: Path) -> None:
    async with asked(tmp_path, **FLEET) as gcs:
        System(gcs).whole()
        System(gcs, 9).say(191, vision(1), text(b"alone"))
        System(gcs, 0).say(1, beat(2, 3), text(b"nobody"))
        System(gcs, 255).say(190, beat(6))
        await asyncio.sleep(0.2)
        heard = await told(gcs, "components.list")
        rows = {(c["sysid"], c["compid"]): (c["vehicle"], c["type"]) for c in heard}
        assert rows == {
            (1, 1): ("v1", "QUADROTOR"),
            (7, 1): ("kite", "QUADROTOR"),
            (7, 100): ("kite", "CAMERA"),
            (7, 154): ("kite", "GIMBAL"),
            (7, 156): ("kite", "ADSB"),
            (7, 191): ("kite", "ONBOARD_CONTROLLER"),
            (9, 191): (None, None),
            (255, 190): (None, "GCS"),
        }
        assert [e["text"] for e in gcs.events if e["kind"] == "statustext"] == ["9/191: alone"]
        alone = await told(gcs, "messages.latest", target="9/191", name="VISION_POSITION_ESTIMATE")
        assert alone["sysid"] == 9 and alone["fields"]["usec"] == 1
        assert "no vehicle '9'" in (await told(gcs, "vehicles.get", target="9"))["message"]


async def test_a_component_is_a_target_where_it_makes_sense(tmp_path: Path) -> None:
    async with asked(tmp_path, **FLEET) as gcs:
        system = System(gcs)
        system.whole()
        await asyncio.sleep(0.2)
        heard: list[tuple[int, int, int]] = []
        ground = PymavPeer(1, 1)

        def on_bytes(data: bytes) -> None:
            for m in ground.mav.parse_buffer(data) or []:
                if m.get_type() == "COMMAND_LONG":
                    heard.append((m.target_system, m.target_component, m.command))
                    if m.target_component == 191:
                        result = mav.MAV_RESULT_DENIED if m.command == 183 else mav.MAV_RESULT_ACCEPTED
                        ack = mav.MAVLink_command_ack_message(m.command, result, 0, 0, 255, 25)
                        more = [vision(9)] if m.command == 512 else []
                        system.say(191, ack, *more)

        link: Any = gcs.daemon.links.link("air")
        link.peer.on_bytes = on_bytes
        for target in ("7/191", "kite/191", "all/191"):
            outcomes = (await told(gcs, "vehicles.command", targets=target, command="DO_SET_RELAY"))["outcomes"]
            assert outcomes["kite/191"]["ok"], outcomes
        assert [h for h in heard if h[2] == 181] == [(7, 191, 181)] * 3
        denied = (await told(gcs, "vehicles.command", targets="7/191", command="DO_SET_SERVO"))["outcomes"]
        assert denied["kite/191"]["result"] == "denied"
        asked_for = await told(gcs, "vehicles.request", targets="7/191", message="VISION_POSITION_ESTIMATE")
        assert asked_for["outcomes"]["kite/191"]["message"] == "VISION_POSITION_ESTIMATE came"
        interval = await told(gcs, "vehicles.interval", targets="7/191", message="ODOMETRY", rate_hz=5)
        assert interval["outcomes"]["kite/191"]["message"] == "5 Hz"
        sent = await told(gcs, "messages.send", name="PING", fields={"seq": 3}, target="7/191")
        assert sent["sent"] == 1
        before = len(heard)
        arming = await told(gcs, "vehicles.command", targets="7/191", command="COMPONENT_ARM_DISARM", params=[1])
        assert "can turn motors" in arming["outcomes"]["kite/191"]["message"], "no way around the checks of an order"
        setpoint = {"target_component": 1, "thrust": 0.5}
        system.say(1, mav.MAVLink_heartbeat_message(2, 3, 0x80, 4, 4, 3))
        await asyncio.sleep(0.2)
        refused = await told(gcs, "messages.send", name="SET_ATTITUDE_TARGET", fields=setpoint, target="7/191")
        assert refused["code"] == -32002 and "kite, which is armed" in refused["message"] and len(heard) == before
        orders = [e for e in gcs.events if e["kind"] == "command"]
        assert {e["data"]["compid"] for e in orders} == {191} and {e["vehicle"] for e in orders} == {"kite"}
        for method, more in (("vehicles.arm", {}), ("vehicles.goto", {"enu_m": [0, 0, 5]}), ("vehicles.reboot", {})):
            refused = await told(gcs, method, targets="7/191", **more)
            assert refused["code"] == -32001 and "is not a vehicle" in refused["message"], refused
        missing = await told(gcs, "vehicles.command", targets="7/77", command="DO_SET_RELAY")
        assert missing["message"].endswith(
            "no component '7/77' was heard; heard of it: 7/1, 7/100, 7/154, 7/156, 7/191"
        )
        assert (await told(gcs, "vehicles.get", target="7/1"))["name"] == "kite"
        await asyncio.sleep(10.0)
        silent = await told(gcs, "vehicles.command", targets="7/191", command="DO_SET_RELAY")
        assert silent["outcomes"]["kite/191"]["result"] == "refused"
        assert not gcs.complaints and not gcs.faults()


async def test_a_message_of_the_autopilot_comes_before_that_of_a_companion(tmp_path: Path) -> None:
    async with asked(tmp_path, **FLEET) as gcs:
        System(gcs).whole()
        await asyncio.sleep(0.2)
        assert (await told(gcs, "messages.latest", target="kite", name="HEARTBEAT"))["compid"] == 1
        assert (await told(gcs, "messages.latest", target="kite/100", name="HEARTBEAT"))["compid"] == 100
        assert await told(gcs, "messages.latest", target="7/1", name="VISION_POSITION_ESTIMATE") is None


async def test_a_second_autopilot_is_a_vehicle_of_its_own_in_the_same_system(tmp_path: Path) -> None:
    async with asked(tmp_path, **FLEET) as gcs:
        system = System(gcs)
        system.say(2, text(b"before my heartbeat"))
        system.whole()
        system.say(2, beat(1, 12))
        await asyncio.sleep(0.2)
        system.say(191, text(b"hello"))
        await asyncio.sleep(0.2)
        first, second = await told(gcs, "vehicles.list", targets="7")
        assert (first["name"], second["name"], second["compid"]) == ("kite", "kite-2", 2)
        assert first["components"] == second["components"] and listed(first)[2] == ("FIXED_WING", True)
        assert len(first["status_texts"]) == 1 and not second["status_texts"]
        assert gcs.events[-1]["vehicle"] == "kite" and gcs.events[-1]["text"] == "kite/191: hello"
        assert gcs.daemon.fleet.sources("kite-2") == {7 << 8 | 2}
        assert 7 << 8 in gcs.daemon.fleet.sources("kite")


async def test_a_flood_of_components_is_bounded_and_counted(tmp_path: Path) -> None:
    async with asked(tmp_path, **FLEET) as gcs:
        for sysid in range(2, 52):  # a third of them would fill the table
            for compid in range(2, 50):
                System(gcs, sysid).say(compid, vision(1))
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.5)
        components = gcs.daemon.fleet.components
        assert len(components.all()) == MAX_COMPONENTS
        assert max(len(components.of_system(sysid)) for sysid in range(256)) == MAX_OF_SYSTEM
        assert components.not_kept == 50 * 48 - MAX_COMPONENTS
        System(gcs, 201).say(191, beat(18))
        await asyncio.sleep(0.2)
        assert components.get(201, 191) is None
        await asyncio.sleep(GIVES_WAY_S)
        System(gcs, 201).say(191, beat(18))
        await asyncio.sleep(0.2)
        assert components.get(201, 191) is not None and len(components.all()) == MAX_COMPONENTS
        assert not gcs.complaints and not gcs.faults()


async def test_one_component_that_sends_everything_is_bounded_too(tmp_path: Path) -> None:
    async with asked(tmp_path, **FLEET) as gcs:
        names = [info.name for info in DIALECT.messages.values() if info.name != "SETUP_SIGNING"]
        for seq, name in enumerate(names):
            gcs.send(message(name, 7, 191, seq & 0xFF))
        await asyncio.sleep(0.5)
        actor = gcs.daemon.fleet.components.get(7, 191)
        assert actor is not None and len(actor.component.slots) == MAX_MESSAGES
        (row,) = [c for c in await told(gcs, "components.list") if c["sysid"] == 7]
        assert row["messages"] == len(names) > MAX_MESSAGES


@pytest.fixture
def wires() -> Iterator[dict[str, socket.socket]]:
    """The vehicle's radio, and a ground station."""
    sockets = {name: socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for name in ("vehicle", "gcs")}
    yield sockets
    for each in sockets.values():
        each.close()


@on_every_loop
async def test_the_fast_path_notes_and_shows_what_companions_send(
    tmp_path: Path, wires: dict[str, socket.socket]
) -> None:
    port = free_port()
    links = {"udp": {"type": "udp_server", "host": "127.0.0.1", "port": port}}
    async with asked(tmp_path, links=links, **FLEET) as gcs:
        autopilot, companion, station = PymavPeer(7, 1), PymavPeer(7, 191), PymavPeer(255, 190)
        for wire in wires.values():
            wire.connect(("127.0.0.1", port))
        wires["gcs"].send(station.pack(beat(6)))

        def send(number: int) -> None:
            wires["vehicle"].send(autopilot.pack(beat(2, 3)) + companion.pack(beat(18)))
            wires["vehicle"].send(companion.pack(vision(number)))

        def count() -> int:
            gcs.daemon.hub.flows.take()
            rows = [c for c in gcs.daemon.fleet.components_status() if (c["sysid"], c["compid"]) == (7, 191)]
            return rows[0]["messages"] if rows else 0

        for number in range(200):
            send(number)
            if number % 20 == 0:
                await asyncio.sleep(0.001)
        await until(lambda: count() == 400)
        wanted = {"topic": "messages", "targets": "kite", "names": ["VISION_POSITION_ESTIMATE"]}
        assert "result" in await gcs.reply("subscribe", wanted)
        for number in range(200, 260):
            send(number)
        await until(lambda: count() == 520)
        await until(lambda: len(gcs.notices) == 60)
        seen = [n["params"]["message"]["fields"]["usec"] for n in gcs.notices]
        assert seen == list(range(200, 260))
        wires["vehicle"].send(companion.pack(text(b"done")))
        await until(lambda: gcs.events[-1]["text"] == "kite/191: done")
        wires["vehicle"].send(companion.pack(beat(30)))
        kind = gcs.daemon.fleet.components.get(7, 191)
        assert kind is not None
        await until(lambda: kind.component.type == 30)
        assert not gcs.complaints and not gcs.faults()
