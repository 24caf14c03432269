"""Alarms of a whole daemon: a vehicle lost in the air among others, and a stop that one did not take."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from support.flown import Flown, aloft


async def alarms(gcs: Flown) -> list[tuple[str, str | None]]:
    answer: dict[str, Any] = await gcs("alarms.list")
    return [(alarm["kind"], alarm["vehicle"]) for alarm in answer["alarms"]]


async def test_one_loss_is_one_alarm_and_a_stop_that_was_not_taken_is_one(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2, ardupilot=2, height_m=6.0) as gcs:
        assert await alarms(gcs) == []
        gcs.muted.add(2)
        await asyncio.sleep(30.0)
        (lost,) = (await gcs("alarms.list"))["alarms"]
        assert (lost["kind"], lost["vehicle"], lost["severity"], lost["active"]) == ("lost", "v2", "alarm", True)
        done = (await gcs("alarms.acknowledge", numbers=[lost["number"]], by="mia"))["acknowledged"]
        assert [alarm["acknowledged_by"] for alarm in done] == ["mia"]
        gcs.muted.clear()
        await asyncio.sleep(5.0)
        assert await alarms(gcs) == []
        # a stop that is refused: loud, until another order ends its flight
        gcs.sim("v4").faults.refuse_mode = "requires position"
        await gcs("vehicles.stop", targets="all")
        assert ("stop", "v4") in await alarms(gcs)
        gcs.sim("v4").faults.refuse_mode = ""
        await gcs.done("vehicles.hold", targets="v4")
        assert not [a for a in (await gcs("alarms.list"))["alarms"] if a["kind"] == "stop" and a["active"]]
