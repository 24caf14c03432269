"""Ten vehicles that follow a virtual leader along a square, in a whole daemon in virtual time."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass
from pathlib import Path

from skygcs.config.models import FleetConfig
from skygcs.core.separation import POSITION_ERROR_M, WINGSPAN_M
from skygcs.ext.formation.config import FormationConfig
from support.flown import flown
from support.planned import least_distance

FENCE = {"x_m": (-200.0, 200.0), "y_m": (-200.0, 200.0), "up_m": (0.0, 60.0)}
SQUARE = ((60.0, 0.0, 20.0), (60.0, 60.0, 25.0), (0.0, 60.0, 20.0), (0.0, 0.0, 20.0))
LOOK_S = 0.5
SPEED_MPS = 3.0


@dataclass(frozen=True, slots=True)
class Led:
    """The flight in figures; ``rms_m`` in truth, while the leader moves; infinite if the formation stopped."""

    speed_mps: float
    rms_m: float
    least_m: float
    footprints_m: float
    reason: str


async def led_formation(tmp_path: Path) -> Led:
    """Fly it, in calm air."""
    table = FormationConfig(speed_mps=SPEED_MPS)

    def prepared(config: FleetConfig) -> FleetConfig:
        return config.model_copy(update={"extensions": {"formation": table}})

    names = [f"v{i + 1}" for i in range(10)]
    control = {"fence": FENCE}
    async with flown(tmp_path, px4=5, ardupilot=5, height_m=20.0, control=control, prepared=prepared) as gcs:
        extension = gcs.daemon.extensions["formation"]
        began = gcs.now
        await gcs("formation.start", targets=names, shape="v", spacing_m=9.0)
        await gcs.until(lambda: extension.status()["settled"], 120.0)
        squares: list[float] = []
        for corner in SQUARE:
            await gcs("formation.move", to_enu_m=list(corner))
            await asyncio.sleep(LOOK_S)
            while not extension.status()["settled"]:
                state = extension.status()
                if state["state"] != "flying":
                    return Led(SPEED_MPS, math.inf, 0.0, 0.0, state["reason"])
                if math.hypot(*state["vel_enu_mps"]) > 0.3:
                    squares += [
                        math.dist(gcs.place(member["vehicle"]), member["place_enu_m"]) ** 2
                        for member in state["members"]
                    ]
                await asyncio.sleep(LOOK_S)
        least_m, _, _ = least_distance(gcs, began)
    return Led(SPEED_MPS, math.sqrt(math.fsum(squares) / len(squares)), least_m, WINGSPAN_M + 2 * POSITION_ERROR_M, "")
