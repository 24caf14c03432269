"""Other programs behind the daemon, each bound to one vehicle that it sees as system 1."""

from __future__ import annotations

import socket
import threading
import time
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from clients.environments import CLIENTS
from clients.flights import PROGRAM_OF, fly
from support.firmware_field import Field
from support.process import free_port

PROGRAM_PARAMS = {"px4": {"RTL_RETURN_ALT": 25}, "ardupilot": {"RTL_ALT": 2500, "WPNAV_SPEED": 1000}}
"""What the programs set, as it was."""


def await_message(program: Any, kind: str, limit_s: float, good: Any = lambda m: True) -> Any:
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        program.mav.heartbeat_send(6, 8, 0, 0, 4)
        message = program.recv_match(type=kind, blocking=True, timeout=0.5)
        if message is not None and good(message):
            return message
    raise AssertionError(f"no {kind} within {limit_s:g} s")


def test_pymavlink_flies_its_vehicle_as_system_1(ground: Field, figures: dict[str, Any]) -> None:
    with ground.ground_station(ground.bound_port, sysid=255) as program:
        heartbeat = await_message(program, "HEARTBEAT", 10, lambda m: m.get_srcSystem() == 1)
        figures["autopilot"] = heartbeat.autopilot

        def order(command: int, *params: float) -> int:
            values = (*params, *[0.0] * (7 - len(params)))
            program.mav.command_long_send(1, 1, command, 0, *values)
            return int(await_message(program, "COMMAND_ACK", 10, lambda m: m.command == command).result)

        if not ground.px4:
            assert order(176, 1, 4) == 0
        else:
            position = await_message(program, "GLOBAL_POSITION_INT", 10)
            nan = float("nan")
            assert order(22, nan, nan, nan, nan, nan, nan, position.alt / 1000 + 8) == 0
        assert order(400, 1) == 0
        if not ground.px4:
            assert order(22, 0, 0, 0, 0, 0, 0, 8) == 0
        began = time.monotonic()
        await_message(program, "GLOBAL_POSITION_INT", 60, lambda m: m.relative_alt > 5000)
        figures["up s"] = time.monotonic() - began
        assert not ground.truth(ground.two).armed
        assert order(176, 1, 9) == 0 if not ground.px4 else order(21, 0, 0, 0, float("nan"), 0, 0, 0) == 0
        sources = {1}
        end = time.monotonic() + 3
        while time.monotonic() < end:
            message = program.recv_match(blocking=True, timeout=0.5)
            if message is not None and not message.get_type().startswith(("BAD_DATA", "UNKNOWN")):
                sources.add(message.get_srcSystem())
        figures["systems seen"] = sorted(sources)
        assert ground.sysids[1] not in sources
        assert ground.sysids[0] not in sources
    ground.land()


@pytest.mark.minutes
@pytest.mark.parametrize("client", PROGRAM_OF)
def test_a_program_flies_its_vehicle(ground: Field, figures: dict[str, Any], client: str) -> None:
    """Those of `make test-clients`, on the first vehicle."""
    if not CLIENTS[client].is_installed:
        pytest.skip(f"{client} is not installed: `make test-clients` does that")
    program = PROGRAM_OF[client]
    port = {"udp_server": ground.bound_port, "tcp_server": ground.bound_tcp_port, "udp_client": ground.program_port}
    words = [program.connect.format(port=port[program.link]), ground.firmware]
    if program.needs_server_port:
        words.append(str(free_port(socket.SOCK_STREAM)))
    if not ground.px4:  # from LAND, MAVSDK takes BRAKE before it arms, in which no ArduCopter arms
        ground.order("vehicles.mode", ground.one, mode="GUIDED")
    try:
        flight = fly(client, words, ground.folder)
    finally:
        ground.order("params.set", ground.one, params=PROGRAM_PARAMS[ground.firmware])
    figures["steps"], figures["mission"] = flight.order, flight.steps.get("mission")
    program.check(flight, ground.firmware)
    assert not ground.truth(ground.two).armed


COMPANION = 191


def companion(field: Field, ending: threading.Event, heard: list[str]) -> None:
    """An onboard computer of the first vehicle, on a connection of its own: heartbeat, a value, a text, an answer."""
    began = time.monotonic()
    with field.peer(field.sysids[0], COMPANION) as program:
        while not ending.is_set():
            program.mav.heartbeat_send(mav.MAV_TYPE_ONBOARD_CONTROLLER, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4)
            passed_s = time.monotonic() - began
            program.mav.named_value_float_send(int(passed_s * 1000), b"cpu_temp", 50.0 + passed_s)
            program.mav.statustext_send(mav.MAV_SEVERITY_INFO, b"camera ready")
            message = program.recv_match(type="COMMAND_LONG", blocking=True, timeout=0.5)
            if message is None:
                continue
            heard.append(f"{message.target_system}/{message.target_component} {message.command}")
            if message.target_component == COMPANION:
                program.mav.command_ack_send(message.command, mav.MAV_RESULT_ACCEPTED)
                program.mav.autopilot_version_send(0, 0x01020304, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0)


def test_a_companion_beside_the_autopilot(air: Field, figures: dict[str, Any]) -> None:
    """A vehicle is its system: the companion is heard, asked and listed, and the state stays the autopilot's."""
    began = time.monotonic()
    before = [air.state(air.one)[key] for key in ("autopilot", "type", "armed", "mode", "firmware")]
    target = f"{air.one}/{COMPANION}"
    ending, heard = threading.Event(), list[str]()
    beside = threading.Thread(target=companion, args=(air, ending, heard), daemon=True)
    beside.start()
    try:
        air.wait(lambda: COMPANION in compids(air), 10, "the companion is listed")
        time.sleep(6)
        value = air.daemon.call("messages.latest", target=target, name="NAMED_VALUE_FLOAT")
        figures["value Hz"], figures["value"] = value["rate_hz"], value["fields"]["value"]
        answer = air.daemon.call("vehicles.request", targets=target, message="AUTOPILOT_VERSION")
        figures["request"] = [outcome["ok"] for outcome in answer["outcomes"].values()]
        air.order("vehicles.hold", air.one)
        assert [air.state(air.one)[key] for key in ("autopilot", "type", "armed", "mode", "firmware")] == before
    finally:
        ending.set()
        beside.join(5)
    figures["components"], figures["heard"] = compids(air), heard[:4]
    texts = [e["text"] for e in air.watcher.events_since(began, "statustext", vehicle=air.one)]
    figures["texts"] = texts[:2]
    assert figures["request"] == [True]
    assert any("camera ready" in text for text in texts)
    assert not air.watcher.events_since(began, "duplicate", "conflict")


def compids(field: Field) -> list[int]:
    return [component["compid"] for component in field.state(field.one)["components"]]
