"""Control at the companion: two daemons in virtual time, and a simulated vehicle behind the companion."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from support.companion_pair import companion_pair
from support.flown import SETPOINTS

pytestmark = pytest.mark.looptime

KINDS = pytest.mark.parametrize("kind", [{"px4": 1}, {"px4": 0, "ardupilot": 1}], ids=["px4", "ardupilot"])


@KINDS
async def test_the_ground_orders_and_the_companion_flies(tmp_path: Path, kind: dict[str, Any]) -> None:
    async with companion_pair(tmp_path, **kind) as pair:
        shown = pair.control()
        assert shown["state"] == "off" and shown["companion"]["up"]
        outcome = await pair.outcome("control.set", mode="attitude")
        assert outcome["message"] == "flown by attitude setpoints", outcome
        assert pair.control()["state"] == "flying" and pair.control()["control_mode"] == "attitude"
        await pair.done("vehicles.goto", enu_m=[5.0, 0.0, 12.0])
        await asyncio.sleep(12)
        assert pair.pi.place() == pytest.approx((5.0, 0.0, 12.0), abs=0.3)
        assert pair.control()["reference"]["pos_enu_m"] == pytest.approx([5.0, 0.0, 12.0], abs=0.01)
        assert not SETPOINTS & set(pair.from_ground)
        await pair.done("vehicles.hold")
        assert pair.control()["state"] == "off"
        ended = pair.now
        await asyncio.sleep(10)
        assert not pair.pi.setpoints(ended + 0.1)
        assert pair.pi.is_safe()
