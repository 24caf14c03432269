"""Corrections over an emulated radio that is too narrow for them."""

from __future__ import annotations

import asyncio
import base64
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.core.radio_link.admission import CORRECTIONS_SHARE
from skygcs.rpc.methods import METHODS
from skygcs.runtime.vehicle_actor import VehicleActor
from support.on_air import OnAir, on_air
from support.rtcm import STANDARD_1005, rtcm_frame

OBSERVATIONS = (1077, 1087, 1097, 1127)


def ask(air: OnAir, name: str, **params: Any) -> Any:
    method = {m.name: m for m in (*METHODS.values(), *air.daemon.extensions.demand("corrections"))}[name]
    return method.handler(SimpleNamespace(services=air.daemon), method.params.model_validate(params))  # type: ignore[arg-type]


def epoch_of(second: int) -> bytes:
    """1.4 kB, the base's position last."""
    messages = [rtcm_frame(t, epoch=second, body_bytes=200 + 100 * n) for n, t in enumerate(OBSERVATIONS)]
    return b"".join(messages) + (STANDARD_1005 if second % 10 == 0 else b"")


async def test_a_narrow_radio_carries_whole_messages_of_every_kind(tmp_path: Path) -> None:
    async with on_air(tmp_path, px4=2, ardupilot=2, radio={"nodes": 11}) as air:
        await air.settled(4)
        before = ask(air, "corrections.status")["radios"][0]
        assert (before["link"], before["source"], before["messages"]) == ("air", None, 0)
        for second in range(60):
            data = base64.b64encode(epoch_of(second)).decode()
            assert ask(air, "corrections.send", data=data)["refused"] == 0
            await asyncio.sleep(1.0)
        told = ask(air, "corrections.status")
        (radio,) = told["radios"]
        assert radio["source"] == "255/25"
        assert radio["replaced"] > 100  # five times as much as it carries
        assert radio["bytes"] <= CORRECTIONS_SHARE * air.air()["up"]["base_bytes_per_s"] * 62
        for sim in (air.sim(sysid) for sysid in range(1, 5)):
            assert set(sim.rtk.types) == {1005, *OBSERVATIONS}
            assert min(sim.rtk.types.values()) >= 3
            assert sum(sim.rtk.types.values()) == pytest.approx(radio["messages"], abs=3)  # none of them in vain
        assert {v["fix"] for v in told["vehicles"]} <= {"rtk_float", "rtk_fixed"}


async def test_orders_do_not_wait_for_corrections(tmp_path: Path) -> None:
    async with on_air(tmp_path, px4=1, ardupilot=0, radio={"nodes": 11}) as air:
        await air.settled(1)

        async def base() -> None:
            for second in range(1000):
                ask(air, "corrections.send", data=base64.b64encode(epoch_of(second)).decode())
                await asyncio.sleep(1.0)

        sending = asyncio.create_task(base())
        await asyncio.sleep(10)
        outcomes = await air.daemon.fleet.orders.command_all("all", VehicleActor.set_mode, name="AUTO.LOITER")
        sending.cancel()
        (outcome,) = outcomes.values()
        up = air.air()["up"]
        assert outcome.ok
        assert outcome.elapsed_s <= 2 * up["round_s"] + 0.5
        assert up["classes"]["correction"]["sent"] > 10
        assert up["classes"]["command"]["wait_p95_s"] < 0.1
