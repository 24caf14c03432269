"""Control ordered while a PX4 still takes off, which changes its mode by itself when it is up."""

from __future__ import annotations

import asyncio
from pathlib import Path

from support.flown import flown


async def test_another_program_is_still_one(tmp_path: Path) -> None:
    async with flown(tmp_path, takeoff=False) as gcs:
        await gcs.done("vehicles.takeoff", targets="v1", height_m=8.0, wait_s=60.0)
        await gcs.until(lambda: gcs.sim().motion.up_m > 5.0, 60.0)
        engaging = asyncio.create_task(gcs.outcome("control.set", mode="position"))
        await asyncio.sleep(0.6)
        gcs.other_sets_mode(4, 5)  # AUTO.RTL
        outcome = await engaging
        assert not outcome["ok"] and "another program switched it to AUTO.RTL" in outcome["message"], outcome
