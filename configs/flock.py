"""A flock in a box, on a formation of skygcs: `python configs/flock.py alpha,bravo,charlie`

Each vehicle flies on, keeps with its neighbours, off those that are near, and inside the box (Reynolds, "Flocks, herds
and schools", SIGGRAPH 1987). The program decides four times a second where each goes next; skygcs keeps them apart by
its separation filter, whatever is decided here. Ctrl-C: they stay where they are, about a second later.

The fleet file needs a table [formation], and the vehicles have to be in the air, inside the box.
"""

import asyncio
import contextlib
import math
import sys

from skygcs.rpc.client import Client, connect

LOW_M, HIGH_M = (-30.0, -30.0, 8.0), (30.0, 30.0, 14.0)  # of the fleet's frame; the same height twice: a flock in 2D
SPEED_MPS, PERIOD_S, AHEAD_S = 1.5, 0.25, 2.0
NEAR_M, SEEN_M = 9.0, 25.0

Vector = tuple[float, float, float]


def velocity(name: str, flock: dict[str, tuple[Vector, Vector]]) -> Vector:
    """Where one member flies next, from the places and velocities of all."""
    here, now = flock[name]
    wish = [0.4 * v for v in now]
    for other, (there, theirs) in flock.items():
        away_m = math.dist(here, there)
        if other == name or not 0.0 < away_m < SEEN_M:
            continue
        for k in range(3):
            wish[k] += 0.2 * theirs[k]  # as they fly
            towards = (there[k] - here[k]) / away_m
            wish[k] += 0.15 * towards if away_m > NEAR_M else -2.0 * towards * (1.0 - away_m / NEAR_M)
    for k in range(3):  # back into the box, before its wall
        margin_m = min(5.0, (HIGH_M[k] - LOW_M[k]) / 2)
        if margin_m > 0.0:
            wish[k] += max(0.0, LOW_M[k] + margin_m - here[k]) / margin_m * 2.0
            wish[k] -= max(0.0, here[k] - HIGH_M[k] + margin_m) / margin_m * 2.0
    if math.hypot(*wish[:2]) < 0.3:  # nobody near: fly on somewhere
        angle = sum(name.encode())
        wish = [math.cos(angle), math.sin(angle), 0.0]
    share = SPEED_MPS / max(math.hypot(*wish), SPEED_MPS)
    return wish[0] * share, wish[1] * share, wish[2] * share


def clipped(place: list[float]) -> list[float]:
    """The nearest place in the box."""
    return [min(max(p, low), high) for p, low, high in zip(place, LOW_M, HIGH_M, strict=True)]


async def guide(gcs: Client, flock: dict[str, tuple[Vector, Vector]]) -> dict[str, Vector]:
    """Decide for all, and send it. The velocities that were decided."""
    wishes = {name: velocity(name, flock) for name in flock}
    places = {
        name: {"pos_enu_m": clipped([p + AHEAD_S * v for p, v in zip(flock[name][0], wish, strict=True)])}
        for name, wish in wishes.items()
    }
    await gcs.call("formation.guide", places=places, valid_s=1.0)
    return wishes


async def main(targets: str) -> None:
    async with connect() as gcs:
        await gcs.call("formation.start", targets=targets, shape="current")
        flying: dict[str, Vector] = {}
        while True:
            states = await gcs.call("vehicles.list", targets=targets)
            flock = {
                state["name"]: (tuple(state["position"]["enu_m"]), flying.get(state["name"], (0.0, 0.0, 0.0)))
                for state in states
                if state["position"] is not None and state["position"]["enu_m"] is not None
            }
            flying = await guide(gcs, flock)
            await asyncio.sleep(PERIOD_S)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "all"))
