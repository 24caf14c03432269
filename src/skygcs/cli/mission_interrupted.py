"""What the vehicles hold when a transfer to them was ended with Ctrl-C: their own word, not a guess.

The daemon ends a transfer when its client goes away, and keeps how it ended (`missions.status`, ``last``). Then the
list is read. An ArduPilot denies it for 8 s from an upload that was broken off; the download waits for that.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from pathlib import PurePath
from typing import Any

import typer

from skygcs.cli.connection import Exit, client, waiting
from skygcs.core.mission.firmware_items import Family, for_firmware
from skygcs.core.mission.formats import read_plan
from skygcs.core.mission.item import MissionType
from skygcs.core.mission.plan import MissionPlan, same_start
from skygcs.errors import SkygcsError
from skygcs.rpc.client import Client

END_S = 3.0
"""The daemon sees a client go at once; a busy one may take a moment."""

POLL_S = 0.1


async def tell_held(targets: str, lists: Sequence[str], sent: MissionPlan, file: str, json_output: bool) -> int:
    """Ask the vehicles and say what they hold of these lists of ``sent``, the plan of ``file``. To be awaited after a
    CancelledError by Ctrl-C; a second Ctrl-C ends it."""
    if (task := asyncio.current_task()) is not None:
        task.uncancel()
    typer.echo("interrupted; asking what is held now (an ArduPilot answers after 8 s; Ctrl-C ends this)", err=True)
    answers: dict[str, Any] = {}
    try:
        async with client() as gcs, waiting(f"reading {targets}"):
            names = [state["name"] for state in await gcs.vehicles(targets)]
            told = await asyncio.gather(*(_held(gcs, name, lists) for name in names))
        answers = dict(zip(names, told, strict=True))
    except (SkygcsError, OSError) as error:
        typer.echo(f"what they hold is not known: {error}", err=True)
    for name, by_list in answers.items():
        for kind, answer in by_list.items():
            family = answer["autopilot"] if answer["autopilot"] in ("px4", "ardupilot") else None
            answer["message"] = _line(answer, sent, MissionType[kind.upper()], file, family)
            if not json_output:
                typer.echo(f"{name}: {answer['message']}")
    if json_output:
        kept = {
            n: {k: {"message": a["message"], "items": a["items"]} for k, a in b.items()} for n, b in answers.items()
        }
        typer.echo(json.dumps({"interrupted": True, "held": kept}, indent=2))
    return Exit.INTERRUPTED


async def _held(gcs: Client, name: str, lists: Sequence[str]) -> dict[str, Any]:
    """By list: how the transfer ended, and what was read then (``plan`` None: it could not be)."""
    for _ in range(round(END_S / POLL_S)):
        (status,) = await gcs.call("missions.status", targets=name)
        if status["transfer"] is None:
            break
        await asyncio.sleep(POLL_S)
    autopilot = (await gcs.vehicle(name))["autopilot"]
    held = {}
    for kind in lists:
        answer = await gcs.call("missions.download", target=name, lists=[kind])
        ok = answer["outcome"]["ok"]
        held[kind] = {
            "autopilot": autopilot,
            "last": status["last"][kind],
            "plan": answer["plan"],
            "items": len(answer[kind]) if ok else None,
            "why": "" if ok else answer["outcome"]["message"],
        }
    return held


def _line(answer: dict[str, Any], sent: MissionPlan, kind: MissionType, file: str, family: Family | None) -> str:
    count, last = answer["items"], answer["last"]
    if count is None:
        ended = "" if last is None else f"{last['message']}; "
        return f"{ended}what it holds could not be read: {answer['why']}"
    word = f"{kind.word} item" + ("" if count == 1 else "s")
    if count == 0:
        return f"holds no {kind.word}"
    if answer["plan"] is None:
        return f"holds {count} {word}"
    new = for_firmware(sent.mission, family, {}).items if kind is MissionType.MISSION else sent.items(kind)
    same = same_start(new, read_plan(answer["plan"].encode(), "the vehicle's plan").plan.items(kind))
    name = PurePath(file).name
    if same == count == len(new):
        return f"holds the whole {kind.word} of {name} ({count} {word})"
    unchanged = last is not None and last["state"] == "unchanged"
    if unchanged or same == 0:
        return f"holds {count} {word}, not those of {name}" + (": as before" if unchanged else "; look before you fly")
    rest = f"the other {count - same} are not" if count > same else f"{len(new) - same} are missing"
    todo = "do not fly it: upload it again, or clear it"
    start = "the first is" if same == 1 else f"the first {same} are"
    return f"holds {count} {word}: {start} of {name}, {rest}; {todo}"
