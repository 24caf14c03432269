"""Calibrating sensors: progress, and the poses that a vehicle asks for."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import AsyncIterator
from enum import StrEnum
from typing import Annotated, Any

import typer

from skygcs.cli.connection import bytes_of, fail, print_outcomes, run
from skygcs.cli.options import Json, Targets
from skygcs.cli.render import say
from skygcs.rpc.client import Client

KIND = "calibration"

POSES = {
    "level": "level",
    "left": "on its left side",
    "right": "on its right side",
    "nose_down": "nose down",
    "nose_up": "nose up",
    "upside_down": "upside down",
}


class CalibrateSensor(StrEnum):
    """Argument of `calibrate`."""

    GYRO = "gyro"
    LEVEL = "level"
    COMPASS = "compass"
    ACCEL = "accel"


def add_to(app: typer.Typer) -> None:
    app.command()(calibrate)


def calibrate(
    targets: Targets,
    sensor: Annotated[
        CalibrateSensor | None, typer.Argument(metavar="SENSOR", help="gyro, level, compass or accel.")
    ] = None,
    cancel: Annotated[bool, typer.Option("--cancel", help="End the calibration that runs.")] = False,
    confirm: Annotated[
        bool,
        typer.Option(
            "--confirm", help="The vehicle is in the pose that it asked for; for a calibration begun elsewhere."
        ),
    ] = False,
    json_output: Json = False,
) -> None:
    """Calibrate a sensor, disarmed and on the ground. Ctrl-C cancels it.

    gyro, level: leave the vehicle standing still. compass: turn it around all axes. accel: six poses; a PX4 finds them
    by itself, an ArduCopter waits for Enter in each. Reboot an ArduCopter afterwards.

    Example: skygcs-cli calibrate alpha compass
    """
    if cancel + confirm + (sensor is not None) != 1:
        raise typer.BadParameter("give a sensor (gyro, level, compass, accel), --cancel or --confirm")
    if sensor is None:
        method = "vehicles.calibrate_cancel" if cancel else "vehicles.calibrate_confirm"

        async def order(gcs: Client) -> int:
            return print_outcomes((await gcs.call(method, targets=targets))["outcomes"], json_output)

        run(order)

    async def command(gcs: Client) -> int:
        async with _guide(gcs):
            answer = await gcs.call("vehicles.calibrate", targets=targets, sensor=sensor.value)
        return print_outcomes(answer["outcomes"], json_output)

    run(command)


@contextlib.asynccontextmanager
async def _guide(gcs: Client) -> AsyncIterator[None]:
    """While the body runs, print on stderr what the vehicles do and ask for; confirm a pose at each line of stdin."""
    waiting: set[str] = set()
    tasks = [
        asyncio.create_task(_show(gcs, waiting), name="calibration events"),
        asyncio.create_task(_confirm(gcs, waiting), name="calibration prompts"),
    ]
    try:
        await asyncio.sleep(0)  # the subscription goes out before the order
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _show(gcs: Client, waiting: set[str]) -> None:
    """Print each change. ``waiting``: the vehicles that wait for a confirmation now."""
    shown: dict[str, str] = {}
    async for event in gcs.events(kinds=[KIND]):
        name, status = event["vehicle"], event["data"]
        if status["confirm"]:
            waiting.add(name)
        else:
            waiting.discard(name)
        line = _line(status)
        if shown.get(name) != line:
            shown[name] = line
            say(f"{name}: {line}", err=True)


def _line(status: dict[str, Any]) -> str:
    """Return what the person at the vehicle has to know."""
    pose = POSES.get(status["pose"] or "", "")
    if status["confirm"]:
        return f"lay it {pose}, then press Enter"
    parts = [status["sensor"]]
    if status["percent"] is not None:
        parts.append(f"{status['percent']} %")
    if pose:
        parts.append(f"lies {pose}: {'turn it slowly' if status['sensor'] == 'compass' else 'hold it still'}")
    elif status["pending"]:
        parts.append(f"lay it {', '.join(POSES[p] for p in status['pending'])}, in any order, and hold it still")
    elif status["text"] and status["percent"] is None:
        parts.append(status["text"])
    return ": ".join((parts[0], ", ".join(parts[1:]))) if len(parts) > 1 else f"{parts[0]}: begun"


async def _confirm(gcs: Client, waiting: set[str]) -> None:
    """Confirm the pose of the vehicles that wait at each line of stdin."""
    async for data in bytes_of(sys.stdin.fileno()):
        if b"\n" not in data or not (names := sorted(waiting)):
            continue
        waiting.clear()
        answer = await gcs.call("vehicles.calibrate_confirm", targets=names)
        for name, outcome in answer["outcomes"].items():
            if not outcome["ok"]:
                waiting.add(name)
                fail(f"{name}: {outcome['message']}; press Enter again")
