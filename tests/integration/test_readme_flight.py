"""The orders of README in the order in which they stand there, with the demo's three vehicles: none is harmed."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from support.flown import Flown, flown
from support.shell_examples import ROOT, commands

NAMES = ("alpha", "bravo", "charlie")
READING_S = 5.0
"""A person reads the next line and types it."""


def given(words: list[str]) -> tuple[str, dict[str, Any]] | None:
    """The method and the parameters of an order; None for what is no order to vehicles."""
    order, arguments = words[1], []
    options: dict[str, Any] = {}
    if order not in ("arm", "takeoff", "goto", "mode", "land", "stop", "hold", "disarm", "rtl"):
        return None
    rest = iter(words[2:])
    for word in rest:
        if word.startswith("--"):
            options[word] = True if word == "--force" else next(rest)
        else:
            arguments.append(word)
    params: dict[str, Any] = {"targets": arguments[0]}
    if "--force" in options:
        params["force"] = True
    if "--wait" in options:
        params["wait_s"] = float(options["--wait"])
    if order == "takeoff":
        params |= {"height_m": float(arguments[1])}
    elif order == "mode":
        params |= {"mode": arguments[1]}
    elif order == "goto" and "--enu" in options:
        params |= {"enu_m": [float(part) for part in options["--enu"].split(",")]}
    elif order == "goto":
        params |= dict(zip(("lat_deg", "lon_deg", "height_m"), map(float, arguments[1:]), strict=True))
    return f"vehicles.{order}", params


async def landed(gcs: Flown) -> None:
    await gcs.until(lambda: not any(sim.armed for sim in gcs.sims), 240.0)


async def test_the_orders_of_readme_fly_land_and_harm_nothing(tmp_path: Path) -> None:
    """`disarm all --force` after `stop all`, while they flew: they fell, and said "Arm: Leaning" for ever."""
    vehicles = {name: {"sysid": number} for number, name in enumerate(NAMES, 1)}
    orders = [order for words in commands(ROOT / "README.md") if words[0] == "skygcs-cli" and (order := given(words))]
    assert [method for method, _ in orders].count("vehicles.takeoff") >= 2
    async with flown(tmp_path, px4=2, ardupilot=1, takeoff=False, tables={"vehicles": vehicles}) as gcs:
        done: dict[str, int] = {}
        for method, params in orders:
            outcomes = (await gcs(method, **params))["outcomes"]
            done[method] = done.get(method, 0) + sum(o["ok"] for o in outcomes.values())
            await asyncio.sleep(READING_S)
            assert not [sim.sysid for sim in gcs.sims if sim.motion.crashed], (method, params)
        assert all(done.values()), done
        await landed(gcs)
        # and they fly again
        await asyncio.sleep(READING_S)
        outcomes = (await gcs("vehicles.mode", targets="charlie", mode="GUIDED"))["outcomes"]
        outcomes = (await gcs("vehicles.takeoff", targets="all", height_m=5.0, wait_s=60.0))["outcomes"]
        assert all(o["ok"] for o in outcomes.values()), outcomes
