"""A vehicle that another site may command: orders are refused in words, control ends without a frame, a stop passes."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.daemon import Daemon
from skygcs.errors import RefusedError
from skygcs.sim.firmware_modes import Px4Mode
from support.flown import Flown, flown

pytestmark = pytest.mark.looptime

WORDS = "v1 is commanded by south; `skygcs-cli federation take v1`"
VALID_S = 2.5


class Authority:
    """In the place of the bridge: a grant each second until it is told to stop."""

    def __init__(self) -> None:
        self.gcs: Flown | None = None
        self.granting = True
        self.until = 0.0
        self.token = 0

    async def run(self, daemon: Daemon) -> None:
        gate = daemon.hub.authority
        assert gate is not None
        while True:
            now = daemon.hub.authority_clock()
            if self.granting:
                self.token += 1
                assert gate.grant("v1", now + VALID_S, now, token=self.token, hub="h") == "granted"
                self.until = now + VALID_S
            await asyncio.sleep(1.0)


@contextlib.asynccontextmanager
async def shared(folder: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[tuple[Flown, Authority]]:
    """v1 hovers, held by this site. The bridge is not started: it is a process."""
    authority = Authority()
    tasks: list[asyncio.Task[None]] = []
    ready = Daemon._run_inner

    async def run_inner(self: Daemon) -> None:
        tasks.append(asyncio.create_task(authority.run(self)))
        await ready(self)

    monkeypatch.setattr(Daemon, "_run_inner", run_inner)
    monkeypatch.setattr(Daemon, "_federation_child", lambda self: None)
    table = {"site": "north", "servers": ["nats://127.0.0.1:4222"], "nkey": "north.nk"}
    tables = {"vehicles": {"v1": {"sysid": 1}}, "federation": {**table, "vehicles": {"v1": {"home": "north"}}}}
    async with flown(folder, tables=tables) as gcs:
        try:
            yield gcs, authority
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


def sent(gcs: Flown, since: float) -> list[tuple[str, float]]:
    return [(s.name, round(s.at - since, 2)) for s in gcs.sent if s.at >= since]


async def test_control_that_loses_its_authority_ends_and_nothing_leaves_any_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with shared(tmp_path, monkeypatch) as (gcs, authority):
        await gcs.fly("position")
        await asyncio.sleep(3.0)
        began, authority.granting = gcs.now, False
        await asyncio.sleep(10.0)
        assert gcs.setpoints(began)[-1].at == pytest.approx(authority.until, abs=0.3), "it flew to the end"
        assert sent(gcs, authority.until) == []
        assert gcs.control()["state"] == "off"
        assert gcs.texts(began) == ["control ended: v1 is not commanded by north now; `skygcs-cli federation take v1`"]
        assert gcs.texts(began, "authority") == ["v1 is not commanded by north now; `skygcs-cli federation take v1`"]
        (state,) = await gcs("vehicles.list", targets="v1")
        assert (state["authority"]["held"], state["authority"]["commander"]) == (False, None)
        assert state["authority"]["blocked_frames"] > 0


ORDERS: list[tuple[str, dict[str, Any]]] = [
    ("vehicles.arm", {}),
    ("vehicles.disarm", {"force": True}),
    ("vehicles.land", {}),
    ("vehicles.rtl", {}),
    ("vehicles.hold", {}),
    ("vehicles.mode", {"mode": "AUTO.LOITER"}),
    ("vehicles.takeoff", {}),
    ("vehicles.goto", {"enu_m": [1.0, 1.0, 10.0]}),
    ("vehicles.reboot", {"force": True}),
    ("vehicles.request", {"message": "HOME_POSITION"}),
    ("vehicles.command", {"command": "DO_SET_SERVO", "params": [1, 1500]}),
    ("control.set", {"mode": "position"}),
    ("control.setpoint", {"pos_enu_m": [0.0, 0.0, 10.0]}),
    ("missions.clear", {}),
    ("missions.start", {}),
    ("params.set", {"params": {"MPC_XY_VEL_MAX": 5.0}}),
    ("params.get", {"names": ["MPC_XY_VEL_MAX"]}),
]


async def test_every_order_is_refused_in_words_and_only_a_stop_passes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with shared(tmp_path, monkeypatch) as (gcs, authority):
        authority.granting = False
        gate = gcs.daemon.hub.authority
        assert gate is not None
        gate.revoke("v1", token=authority.token, hub="h", commander="south")
        gcs.daemon.check_authority()
        since = gcs.now
        for method, params in ORDERS:
            answer = await gcs(method, targets="v1", **params)
            assert WORDS in str(answer), (method, answer)
        with pytest.raises(RefusedError, match="is commanded by south"):
            await gcs("messages.send", name="PING", target="v1")
        await asyncio.sleep(3.0)
        assert sent(gcs, since) == []
        await gcs.done("vehicles.stop", action="land")
        assert gcs.sim().mode == Px4Mode.LAND
        assert {name for name, _ in sent(gcs, since)} <= {"COMMAND_LONG", "COMMAND_INT", "SET_MODE"}
