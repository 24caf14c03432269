"""Which raw messages and commands do what an order does, and for which vehicles they are refused."""

from __future__ import annotations

import math
from typing import Any

import pytest

from skygcs.config.dialects import load_dialect
from skygcs.core.vehicle.unguarded import (
    ENDS_FLIGHT,
    GUARDED_COMMANDS,
    GUARDED_MESSAGES,
    TURNS_MOTORS,
    unguarded_command,
    unguarded_message,
)

COMMANDS = load_dialect("ardupilotmega").enums["MAV_CMD"]


def test_the_table_names_messages_and_commands_that_there_are() -> None:
    known = set(load_dialect("ardupilotmega").by_name) | set(load_dialect("common").by_name)
    assert set(GUARDED_MESSAGES) <= known
    names = COMMANDS | load_dialect("common").enums["MAV_CMD"]
    assert {n for n in (*GUARDED_COMMANDS, *TURNS_MOTORS, *ENDS_FLIGHT) if n not in names} == set()


@pytest.mark.parametrize(
    ("name", "fields", "instead"),
    [
        ("MANUAL_CONTROL", {}, "control set"),
        ("MISSION_ITEM_INT", {"current": 2}, "mission upload"),
        ("COMMAND_LONG", {"command": 400, "param1": 1.0}, "arm"),
        ("COMMAND_LONG", {"command": 400.0, "param1": 0.0}, "disarm"),
        ("COMMAND_LONG", {"command": 400}, "disarm"),
        ("COMMAND_INT", {"command": 192}, "goto"),
        ("COMMAND_LONG", {"command": 16}, "goto and mission"),
        ("COMMAND_LONG", {"command": 22}, "takeoff"),
        ("COMMAND_LONG", {"command": 310}, "nothing"),
    ],
)
def test_the_guarded_way_is_named(name: str, fields: dict[str, Any], instead: str) -> None:
    way = unguarded_message(name, fields, COMMANDS)
    assert way is not None and way.instead.startswith(instead)
    refusal = way.refusal((), 0.0)
    assert refusal is not None and name in refusal and "--force" in refusal


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("HEARTBEAT", {}),
        ("PARAM_SET", {"param_id": "X"}),
        ("COMMAND_LONG", {}),
        ("COMMAND_LONG", {"command": 512, "param1": 400.0}),
        ("COMMAND_LONG", {"command": 21}),
        ("COMMAND_INT", {"command": 20}),
        ("COMMAND_LONG", {"command": "no number"}),
        ("COMMAND_LONG", {"command": math.inf}),
        ("STATUSTEXT", {"text": "arm"}),
    ],
)
def test_all_else_may_be_sent(name: str, fields: dict[str, Any]) -> None:
    assert unguarded_message(name, fields, COMMANDS) is None


@pytest.mark.parametrize("param1", [1.0, 0.4, -1.0, 1e-40, math.nan, math.inf])
def test_whatever_is_not_plainly_a_disarming_counts_as_arming(param1: float) -> None:
    way = unguarded_command(400, param1, "COMPONENT_ARM_DISARM")
    assert way is not None and way.always and way.instead == "arm"
