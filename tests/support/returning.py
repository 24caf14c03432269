"""Two vehicles above each other's home, and their return."""

from __future__ import annotations

import asyncio

from support.flown import Flown


async def swapped(gcs: Flown) -> None:
    """v1 and v2 each above the home of the other, by way of places beside and above that."""
    a, b = gcs.place_of_home("v1"), gcs.place_of_home("v2")
    for name, x, y, up in (
        ("v1", a[0], -8.0, 10.0),
        ("v2", a[0], 0.0, 10.0),
        ("v1", b[0] + 3.0, -8.0, 10.0),
        ("v1", b[0], 0.0, 10.0),
    ):
        await gcs.done("vehicles.goto", targets=name, enu_m=[x, y, up], force=True)
        await asyncio.sleep(12.0)


async def all_down(gcs: Flown, seconds: float = 300.0) -> None:
    await gcs.until(lambda: not any(sim.armed for sim in gcs.sims), seconds)
    for sim in gcs.sims:
        name = f"v{sim.sysid}"
        home, place = gcs.place_of_home(name), gcs.place(name)
        assert abs(place[0] - home[0]) < 1.5 and abs(place[1] - home[1]) < 1.5, (name, place)
