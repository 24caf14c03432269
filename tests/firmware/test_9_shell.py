"""The console of a real PX4, by the command line and by the methods."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest

from skygcs.errors import RpcError
from skygcs.rpc.client import connect
from support.firmware_field import Field

pytestmark = pytest.mark.only("px4")

CLI_S = 120.0


def typed(field: Field, *words: str, name: str = "") -> Any:
    return field.daemon.cli("shell", name or field.one, *words, timeout_s=CLI_S)


def test_it_answers_and_only_the_one_that_is_meant(console: Field, figures: dict[str, Any]) -> None:
    began = time.monotonic()
    done = typed(console, "ver all")
    assert done.returncode == 0, done.stdout + done.stderr
    figures["one line s"] = time.monotonic() - began
    lines = done.stdout.splitlines()
    assert lines[0].startswith("HW arch:") and any(line.startswith("PX4 version:") for line in lines)
    assert "\x1b" not in done.stdout and "pxh>" not in done.stdout
    # each has its own system id, as its own console says
    for name, sysid in zip(console.names, console.sysids, strict=True):
        shown = typed(console, "param show MAV_SYS_ID", name=name)
        assert f": {sysid}" in shown.stdout, shown.stdout


def test_a_long_output_comes_whole_and_the_vehicle_goes_on(console: Field, figures: dict[str, Any]) -> None:
    done = typed(console, "param show -a")
    assert done.returncode == 0, done.stdout[-500:] + done.stderr
    figures["bytes"] = len(done.stdout)
    assert "MAV_SYS_ID" in done.stdout and "parameters total" in done.stdout.replace("\n", " ")[-400:]
    assert console.state(console.one)["connected"]


async def armed_in_the_middle(field: Field) -> str:
    """Why an open shell takes nothing any more once its vehicle is armed."""
    async with connect(str(field.daemon.socket)) as gcs:
        session = (await gcs.call("shell.open", vehicle=field.one))["session"]
        outcome = (await gcs.arm(field.one, wait_s=30))[field.one]
        assert outcome["ok"], outcome
        with pytest.raises(RpcError) as refused:
            await gcs.call("shell.write", session=session, text="reboot\n")
        return str(refused.value)


def test_an_armed_vehicle_is_typed_at_by_force_only(console: Field, figures: dict[str, Any]) -> None:
    try:
        figures["refused"] = asyncio.run(armed_in_the_middle(console))
        assert "is armed" in figures["refused"]
        refused = typed(console, "reboot")
        assert refused.returncode == 1 and "is armed" in refused.stderr, refused.stderr
        forced = typed(console, "commander status", "--force")
        assert forced.returncode == 0 and "Armed" in forced.stdout, forced.stdout + forced.stderr
    finally:
        console.order("vehicles.disarm", console.one)
    assert "Disarmed" in typed(console, "commander status").stdout
