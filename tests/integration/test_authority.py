"""A vehicle that another site may command: orders are refused in words, control ends without a frame, a stop passes."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.cli.status import commander_word
from skygcs.daemon import Daemon
from skygcs.errors import RefusedError
from skygcs.ext.federation.config import FederationConfig, SharedVehicle
from skygcs.runtime.fence_orders import VehicleFence
from skygcs.runtime.supervised_child import SupervisedChild
from skygcs.sim.firmware_modes import Px4Mode
from support.extension_parts import PLAIN_METHODS
from support.flown import Flown, aloft
from support.pymav import PymavPeer

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
        shared = daemon.extensions["federation"].authority
        while True:
            now = daemon.hub.boot_clock()
            if self.granting:
                self.token += 1
                assert shared.grant("v1", now + VALID_S, now, token=self.token, hub="h") == "granted"
                self.until = now + VALID_S
            await asyncio.sleep(1.0)


async def _no_process(child: SupervisedChild) -> None:
    """In the place of `SupervisedChild.run`."""


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
    monkeypatch.setattr(SupervisedChild, "run", _no_process)
    shares = {"v1": SharedVehicle(home="north")}
    table = FederationConfig(site="north", servers=("nats://127.0.0.1:4222",), nkey=Path("north.nk"), vehicles=shares)
    tables = {"vehicles": {"v1": {"sysid": 1}}, "extensions": {"federation": table}, "delegated": {"v1"}}
    async with aloft(folder, tables=tables) as gcs:
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


PLACE = {"lat_deg": 47.0, "lon_deg": 8.0}
PLAN = "QGC WPL 110\n0\t0\t3\t16\t0\t0\t0\t0\t47\t8\t10\t1\n1\t0\t3\t16\t0\t0\t0\t0\t47\t8\t10\t1\n"

ORDERS: dict[str, dict[str, Any]] = {
    "vehicles.arm": {},
    "vehicles.disarm": {"force": True},
    "vehicles.land": {},
    "vehicles.rtl": {},
    "vehicles.hold": {},
    "vehicles.mode": {"mode": "AUTO.LOITER"},
    "vehicles.takeoff": {},
    "vehicles.goto": {"enu_m": [1.0, 1.0, 10.0]},
    "vehicles.reboot": {"force": True},
    "vehicles.set_home": PLACE | {"alt_amsl_m": 400.0},
    "vehicles.calibrate": {"sensor": "gyro"},
    "vehicles.calibrate_confirm": {},
    "vehicles.calibrate_cancel": {},
    "vehicles.request": {"message": "HOME_POSITION"},
    "vehicles.interval": {"message": "ATTITUDE", "rate_hz": 10.0},
    "vehicles.stream": {"stream": "all", "rate_hz": 2.0},
    "vehicles.command": {"command": "DO_SET_SERVO", "params": [1, 1500]},
    "origin.push": {},
    "control.set": {"mode": "position"},
    "control.setpoint": {"pos_enu_m": [0.0, 0.0, 10.0]},
    "trajectory.start": {},
    "trajectory.pause": {},
    "trajectory.resume": {},
    "trajectory.speed": {"speed": 0.5},
    "trajectory.abort": {},
    "missions.upload": {"plan": PLAN},
    "missions.download": {},
    "missions.clear": {},
    "missions.start": {},
    "missions.pause": {},
    "missions.resume": {},
    "missions.set_current": {"item": 1},
    "fence.set": {"radius_m": 50.0},
    "fence.status": {},
    "fence.test": {"radius_m": 2.0},
    "logs.list": {},
    "logs.get": {},
    "params.set": {"params": {"MPC_XY_VEL_MAX": 5.0}},
    "params.get": {"names": ["MPC_XY_VEL_MAX"]},
    "params.list": {},
    "signing.setup": {"key_file": "KEY"},
    "signing.off": {},
    "preflight.run": {"fix": True},
}
"""All methods that send something to a vehicle for a person."""

ANSWERED_HERE = {
    *("vehicles.list", "vehicles.get", "vehicles.forget", "messages.latest", "subscribe", "origin.from_vehicle"),
    *(
        "params.status",
        "params.metadata",
        "params.cancel",
        "control.status",
        "control.gains",
        "control.record",
        "link.select",
    ),
    *("trajectory.load", "trajectory.unload", "trajectory.paths", "trajectory.status", "missions.status"),
    "preflight.status",
}
"""They send nothing."""

ELSEWHERE = {"vehicles.stop", "vehicles.renumber", "messages.send"}
"""A stop is exempt; a vehicle that sites share keeps its id; for messages see below."""

COMPONENT_ORDERS: list[tuple[str, dict[str, Any]]] = [
    ("vehicles.command", {"command": "DO_GIMBAL_MANAGER_PITCHYAW", "params": [0, 0, 0, 0, 0, 0, 0]}),
    ("vehicles.command", {"command": "IMAGE_START_CAPTURE", "params": [0, 0, 1]}),
    ("vehicles.request", {"message": "CAMERA_INFORMATION"}),
    ("vehicles.interval", {"message": "CAMERA_FOV_STATUS", "rate_hz": 1.0}),
    ("vehicles.stream", {"stream": "all", "rate_hz": 1.0}),
]


def test_every_method_that_names_vehicles_is_in_a_table() -> None:
    named = {n for n, m in PLAIN_METHODS.items() if {"target", "targets"} & m.params.model_fields.keys()}
    assert named == ORDERS.keys() | ANSWERED_HERE | ELSEWHERE


async def test_every_order_is_refused_in_words_and_only_a_stop_passes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = tmp_path / "key"
    key.write_text("ab" * 32)
    key.chmod(0o600)
    async with shared(tmp_path, monkeypatch) as (gcs, authority):
        camera = PymavPeer(1, 100)
        gcs.link.peer.send(camera.pack(mav.MAVLink_heartbeat_message(30, 8, 0, 0, 4, 3)))
        await asyncio.sleep(0.5)
        authority.granting = False
        shared_vehicles = gcs.daemon.extensions["federation"].authority
        shared_vehicles.revoke("v1", token=authority.token, hub="h", commander="south")
        gcs.daemon.check_sending()
        since = gcs.now
        for method, params in ORDERS.items():
            given = {name: str(key) if value == "KEY" else value for name, value in params.items()}
            one = "target" if "target" in PLAIN_METHODS[method].params.model_fields else "targets"
            answer = await gcs(method, **{one: "v1"}, **given)
            assert WORDS in str(answer), (method, answer)
            assert gcs.now == since, f"{method} waited for the vehicle"
            PLAIN_METHODS[method].result.model_validate(answer)  # clients index its keys
            if method.startswith("logs."):
                assert answer["outcomes"]["v1"]["logs"] == answer["outcomes"]["v1"]["files"] == []
        for method, params in COMPONENT_ORDERS:
            answer = await gcs(method, targets="v1/100", **params)
            assert answer["outcomes"]["v1/100"]["message"] == f"refused: {WORDS}", (method, answer)
        for target in ("v1", "v1/100"):
            with pytest.raises(RefusedError, match="is commanded by south"):
                await gcs("messages.send", name="PING", target=target)
        await asyncio.sleep(3.0)
        assert sent(gcs, since) == []
        await gcs.done("vehicles.stop", action="land")
        assert gcs.sim().mode == Px4Mode.LAND
        assert {name for name, _ in sent(gcs, since)} <= {"COMMAND_LONG", "COMMAND_INT", "SET_MODE"}


async def test_a_fault_in_an_order_has_the_keys_of_its_outcomes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def faulty(*_: object) -> None:
        raise RuntimeError("a bug")

    monkeypatch.setattr(VehicleFence, "status", faulty)
    async with shared(tmp_path, monkeypatch) as (gcs, _):
        outcome = (await gcs("fence.status", targets="v1"))["outcomes"]["v1"]
        assert outcome["result"] == "failed" and outcome["fence"] is None and outcome["record"] is None
        (reported,) = gcs.texts(0.0, "fault")
        assert reported == "read_fence failed inside skygcs: RuntimeError('a bug')"
        gcs.told.clear()


async def test_the_state_says_who_commands_it_as_status_shows_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with shared(tmp_path, monkeypatch) as (gcs, authority):

        async def shown() -> str:
            (state,) = await gcs("vehicles.list", targets="v1")  # what `status --json` prints
            return commander_word(state)

        assert await shown() == "here"
        authority.granting = False
        shared_vehicles = gcs.daemon.extensions["federation"].authority
        shared_vehicles.revoke("v1", token=authority.token, hub="h", commander="south")
        assert await shown() == "south"
        shared_vehicles.revoke("v1", token=authority.token, hub="h")
        assert await shown() == "nobody"
