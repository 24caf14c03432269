"""Other programs behind the daemon, each bound to one vehicle that it sees as system 1."""

from __future__ import annotations

import time
from typing import Any

from support.firmware_field import Field


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
            if message is not None and message.get_type() != "BAD_DATA":
                sources.add(message.get_srcSystem())
        figures["systems seen"] = sorted(sources)
        assert ground.sysids[1] not in sources
        assert ground.sysids[0] not in sources
    ground.land()
