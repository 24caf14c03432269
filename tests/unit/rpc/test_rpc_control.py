"""The control methods over a socket: what reaches the vehicles, what comes back, what is no request at all."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter

from skygcs.core.vehicle.state import VehicleState
from skygcs.errors import RpcError, SkygcsError
from skygcs.rpc.address import TOKEN_FILE_VARIABLE, client_token
from skygcs.rpc.client import Client, connect
from skygcs.rpc.control import ControlState, GainsAnswer
from skygcs.rpc.server import RpcServer
from support.controlled import FLYING, OFF, ControlledFleet, ControlledVehicle
from support.fake_daemon import NAMES, FakeDaemon, FakeOutcome
from support.rpc_bench import Bench, running
from support.table import each
from support.vehicles import Ground, ScriptedVehicle

INVALID_PARAMS = -32602
UNKNOWN_TARGET = -32001


@dataclass
class Controlled:
    gcs: Client
    vehicles: dict[str, ControlledVehicle]

    async def call(self, method: str, **params: Any) -> Any:
        return await self.gcs.call(f"control.{method}", **params)

    async def refused(self, method: str, **params: Any) -> RpcError:
        with pytest.raises(RpcError) as caught:
            await self.call(method, **params)
        return caught.value


@pytest.fixture
async def fleet(tmp_path: Path) -> AsyncIterator[Controlled]:
    daemon = FakeDaemon()
    vehicles = {name: ControlledVehicle(i, name) for i, name in enumerate(NAMES, 1)}
    daemon.fleet = ControlledFleet(list(vehicles.values()))
    server = RpcServer(daemon, tmp_path / "s.sock")
    await server.start()
    async with asyncio.timeout(10), connect(server.socket_path) as gcs:
        yield Controlled(gcs, vehicles)
    await server.close()


@pytest.mark.parametrize("mode", ["off", "position", "velocity", "attitude"])
async def test_set_orders_a_mode_and_answers_each_outcome(fleet: Controlled, mode: str) -> None:
    fleet.vehicles["bravo"].outcome = FakeOutcome(False, "refused", "refused: it is on the ground")
    answer = await fleet.call("set", targets="alpha,bravo", mode=mode)
    assert {name: told["ok"] for name, told in answer["outcomes"].items()} == {"alpha": True, "bravo": False}
    assert answer["outcomes"]["bravo"]["message"] == "refused: it is on the ground"
    for name in ("alpha", "bravo"):
        ((order, arguments),) = fleet.vehicles[name].orders
        assert order == "control" and arguments["mode"] == mode
    assert fleet.vehicles["carol"].orders == []


async def test_set_knows_four_modes_and_the_fleets_vehicles(fleet: Controlled) -> None:
    assert (await fleet.refused("set", targets="alpha", mode="sport")).code == INVALID_PARAMS
    assert (await fleet.refused("set", targets="alpha")).code == INVALID_PARAMS
    assert (await fleet.refused("set", targets="zulu", mode="off")).code == UNKNOWN_TARGET


async def test_gains_without_changes_are_only_read(fleet: Controlled) -> None:
    answer = await fleet.call("gains", targets="all")
    assert answer["outcomes"] == {} and set(answer["gains"]) == set(NAMES)
    GainsAnswer.model_validate(answer)
    assert answer["gains"]["alpha"]["xy"]["vel_p"] == 0.08
    await fleet.call("gains", targets="alpha", xy={}, force=True)  # nothing in it is to change
    assert all(vehicle.orders == [] for vehicle in fleet.vehicles.values())


async def test_gains_change_only_what_is_named_and_are_told_as_they_are_then(fleet: Controlled) -> None:
    answer = await fleet.call("gains", targets="alpha", xy={"vel_p": 0.1}, hover_thrust=0.5, force=True)
    changes = {"xy": {"vel_p": 0.1}, "hover_thrust": 0.5}
    assert fleet.vehicles["alpha"].orders == [("change_gains", {"changes": changes, "force": True})]
    assert answer["outcomes"]["alpha"]["ok"]
    assert answer["gains"]["alpha"]["xy"] == {"pos_p_per_s": 0.95, "vel_p": 0.1, "vel_i": 0.02, "vel_d": 0.0}
    assert answer["gains"]["alpha"]["hover_thrust"] == 0.5
    await fleet.call("gains", targets="alpha", z={"vel_i": 0})  # none at all is a change, too
    assert fleet.vehicles["alpha"].orders[-1] == ("change_gains", {"changes": {"z": {"vel_i": 0.0}}, "force": False})


@each("wrong", [{"xy": {"vel_p": -1}}, {"z": {"p": 1}}, {"hover_thrust": 1}, {"xy": {"vel_i": 101}}, {"xy": 3}])
async def test_gains_nobody_can_mean_are_invalid(fleet: Controlled, wrong: dict[str, Any]) -> None:
    assert (await fleet.refused("gains", targets="alpha", **wrong)).code == INVALID_PARAMS
    assert fleet.vehicles["alpha"].orders == []


async def test_a_setpoint_reaches_each_vehicle_as_it_was_given(fleet: Controlled) -> None:
    wanted = {"pos_enu_m": [1.0, 2.0, None], "vel_enu_mps": [None, None, 0.5], "yaw_deg": 90.0, "valid_s": 1.0}
    said = {**wanted, "force": False}
    answer = await fleet.call("setpoint", targets="alpha", **wanted)
    assert answer["outcomes"]["alpha"]["ok"]
    assert fleet.vehicles["alpha"].setpoints == [said]
    await fleet.call("setpoint", targets="alpha", vel_enu_mps=[1, 0, 0])
    assert fleet.vehicles["alpha"].setpoints[-1] == {"vel_enu_mps": [1.0, 0.0, 0.0], "valid_s": 0.5, "force": False}
    fleet.vehicles["alpha"].refuses = "refused: control is off"
    answer = await fleet.call("setpoint", targets="alpha", vel_enu_mps=[1, 0, 0])
    assert answer["outcomes"]["alpha"]["message"] == "refused: control is off"


@each(
    ("wrong", "why"),
    [
        ({}, "x is given neither"),
        ({"pos_enu_m": [1, 2, None]}, "up is given neither"),
        ({"pos_enu_m": [1, None, 3], "vel_enu_mps": [0, 0, 0]}, "x and y together"),
        ({"pos_enu_m": [1, 2]}, "pos_enu_m"),
        ({"pos_enu_m": [1, 2, 3], "valid_s": 60}, "valid_s"),
        ({"pos_enu_m": [1, 2, 3], "valid_s": 0}, "valid_s"),
        ({"pos_enu_m": [1, 2, 3], "yaw_deg": 400}, "yaw_deg"),
        ({"pos_enu_m": [1, 2, 3], "acc_enu_mps2": [0, 0]}, "acc_enu_mps2"),
        ({"pos_enu_m": [1, 2, "3"]}, "pos_enu_m"),
        ({"pos_enu_m": [1, 2, 3], "speed": 3}, "speed"),
    ],
)
async def test_a_setpoint_that_leaves_an_axis_open_or_means_nothing_is_invalid(
    fleet: Controlled, wrong: dict[str, Any], why: str
) -> None:
    error = await fleet.refused("setpoint", targets="alpha", **wrong)
    assert error.code == INVALID_PARAMS and why in str(error) + str(error.data)
    assert fleet.vehicles["alpha"].setpoints == []


async def test_status_names_the_vehicle_and_has_the_described_shape(fleet: Controlled) -> None:
    fleet.vehicles["bravo"].control_told = FLYING
    told = await fleet.call("status", targets="alpha,bravo")
    assert [state["vehicle"] for state in told] == ["alpha", "bravo"]
    for state in told:
        ControlState.model_validate(state)
        assert set(state) == set(ControlState.model_fields)
    assert told[1] == {"vehicle": "bravo", **FLYING}
    assert len(await fleet.call("status")) == len(NAMES)


async def test_a_vehicles_state_has_the_same_section(fleet: Controlled) -> None:
    fleet.vehicles["alpha"].control_told = FLYING
    state = await fleet.gcs.call("vehicles.get", target="alpha")
    TypeAdapter(VehicleState).validate_python(state)
    assert state["control"] == FLYING


async def test_record_answers_the_file_of_each(fleet: Controlled) -> None:
    assert await fleet.call("record", targets="alpha,carol", on=True) == {
        "files": {"alpha": "/logs/alpha.csv", "carol": "/logs/carol.csv"}
    }
    assert (await fleet.call("record", targets="alpha", on=False))["files"] == {"alpha": None}
    assert (await fleet.refused("record", targets="alpha")).code == INVALID_PARAMS


@pytest.mark.looptime
async def test_the_shape_is_that_of_a_real_vehicle_and_the_fakes_have_it() -> None:
    async with Ground() as ground:
        (actor,) = await ground.met(ScriptedVehicle(ground))
        state = {"vehicle": actor.name, **actor.control_state(ground.loop.time())}
        ControlState.model_validate(state)
        assert set(state) == set(ControlState.model_fields) == {"vehicle", *OFF} == {"vehicle", *FLYING}
        assert {**OFF, "vehicle": actor.name} == state
        GainsAnswer.model_validate({"outcomes": {}, "gains": {"x": actor.offboard.gains()}})
        assert actor.state(ground.loop.time())["control"] is None


# -- Which requests count for operator_timeout_s: all of a client's, unless it relays for somebody who may have left.


@pytest.fixture
async def bench(tmp_path: Path) -> AsyncIterator[Bench]:
    async with running(tmp_path) as bench:
        yield bench


async def test_each_request_of_a_plain_client_counts(bench: Bench) -> None:
    peer = await bench.connect()
    await peer.call("vehicles.list")
    await peer.call("no.such.method")
    assert bench.daemon.requests_seen == 2


async def test_of_a_client_that_relays_only_a_persons_activity_counts(bench: Bench) -> None:
    relay, plain = await bench.connect(), await bench.connect()
    assert (await relay.call("operator.relay"))["result"] == {"ok": True}
    for method in ("vehicles.list", "daemon.info", "no.such.method", "operator.relay"):
        await relay.call(method)
    await relay.call("subscribe", topic="telemetry", rate_hz=20.0)
    await relay.call("vehicles.arm", targets="all")
    assert bench.daemon.requests_seen == 0
    await relay.call("operator.active")
    assert bench.daemon.requests_seen == 1
    await plain.call("vehicles.list")
    assert bench.daemon.requests_seen == 2


async def test_a_person_is_counted_once_by_a_plain_client_and_by_name(bench: Bench) -> None:
    peer = await bench.connect()
    await peer.call("operator.active")
    assert bench.daemon.requests_seen >= 1


# -- Where clients find the daemon, and its token.


def test_the_token_is_read_from_the_file_that_the_environment_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(TOKEN_FILE_VARIABLE, raising=False)
    assert client_token() is None
    file = tmp_path / "token"
    file.write_text("secret\n")
    monkeypatch.setenv(TOKEN_FILE_VARIABLE, str(file))
    assert client_token() == "secret"
    file.unlink()
    with pytest.raises(SkygcsError, match=f"cannot read the token file {file}"):
        client_token()
