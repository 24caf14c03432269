"""What the shell proposes after TAB: vehicles and messages of the running daemon, if it answers quickly."""

from __future__ import annotations

import asyncio
import os
from typing import Any

import typer

from skygcs.cli.connection import client
from skygcs.errors import SkygcsError

WAIT_VARIABLE = "SKYGCS_COMPLETION_WAIT_S"
"""Environment variable: how long to wait for the daemon, for a daemon on another computer or a slow machine."""

DEFAULT_WAIT_S = 1.0
"""A person waits at the prompt; the daemon answers within 10 ms on an idle machine."""

MAX_WAIT_S = 600.0


def wait_s() -> float:
    """How long to wait for the daemon; what is no number of seconds counts as not set."""
    try:
        value = float(os.environ.get(WAIT_VARIABLE, ""))
    except ValueError:
        return DEFAULT_WAIT_S
    return min(value, MAX_WAIT_S) if value >= 0 else DEFAULT_WAIT_S


def targets(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names, groups and "all"; after a comma, the next part of the list."""
    states = _ask(ctx, "vehicles.list") or []
    words = {"all": None} | {s["name"]: None for s in states} | {g: None for s in states for g in s["groups"]}
    before, comma, last = incomplete.rpartition(",")
    return [before + comma + word for word in words if word.startswith(last)]


def messages(ctx: typer.Context, incomplete: str) -> list[str]:
    """Message names of the daemon's dialect, in any case."""
    found = _ask(ctx, "messages.list") or []
    return [m["name"] for m in found if m["name"].upper().startswith(incomplete.upper())]


def commands(ctx: typer.Context, incomplete: str) -> list[str]:
    """MAV_CMD names of the daemon's dialect, without their prefix."""
    found = _ask(ctx, "commands.list") or []
    return [c["name"] for c in found if c["name"].startswith(incomplete)]


def links(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of the links."""
    return [link["name"] for link in _ask(ctx, "links.list") or [] if link["name"].startswith(incomplete)]


def methods(ctx: typer.Context, incomplete: str) -> list[str]:
    """Method names."""
    document = _ask(ctx, "rpc.discover") or {"methods": []}
    return [m["name"] for m in document["methods"] if m["name"].startswith(incomplete)]


def modes(_: typer.Context, incomplete: str) -> list[str]:
    """The flight modes people use most; any other may be typed."""
    return [mode for mode in COMMON_MODES if mode.startswith(incomplete.upper())]


COMMON_MODES = (
    "AUTO.LAND",
    "AUTO.LOITER",
    "AUTO.MISSION",
    "AUTO.RTL",
    "AUTO.TAKEOFF",
    "ALTCTL",
    "POSCTL",
    "OFFBOARD",
    "MANUAL",
    "STABILIZED",
    "ALT_HOLD",
    "AUTO",
    "BRAKE",
    "GUIDED",
    "LAND",
    "LOITER",
    "POSHOLD",
    "RTL",
    "SMART_RTL",
    "STABILIZE",
)


def _ask(ctx: typer.Context, method: str) -> Any:
    async def ask() -> Any:
        async with asyncio.timeout(wait_s()), client(ctx.find_root().params.get("socket")) as gcs:
            return await gcs.call(method)

    try:
        return asyncio.run(ask())
    except (SkygcsError, OSError, TimeoutError):
        return None
