"""The interface's description of itself agrees with what it does."""

from __future__ import annotations

import inspect
import json
from functools import cache
from typing import Any

from pydantic import TypeAdapter

from skygcs.core.vehicle.orders import Where
from skygcs.core.vehicle.state import VehicleState
from skygcs.rpc import dispatch
from skygcs.rpc.client import Client
from skygcs.runtime import home_orders
from skygcs.runtime.vehicle_actor import VehicleActor
from support.extension_parts import ALL_METHODS
from support.fake_daemon import FakeDaemon
from support.table import each


@cache
def document() -> dict[str, Any]:
    made: dict[str, Any] = json.loads(json.dumps(dispatch.document(ALL_METHODS.values())))
    return made


CONTRACT = {
    "daemon": "info",
    "vehicles": "list get arm disarm mode takeoff land rtl hold goto reboot set_home interval stream command",
    "control": "set gains setpoint status record",
    "messages": "latest send list",
    "links": "list add change remove",
    "router": "stats",
    "events": "recent",
    "recorder": "status",
    "rpc": "discover",
}


def test_every_method_of_the_contract_is_there_and_described() -> None:
    described = {m["name"]: m for m in document()["methods"]}
    names = {f"{area}.{verb}" for area, verbs in CONTRACT.items() for verb in verbs.split()}
    assert names | {"subscribe", "unsubscribe"} <= described.keys()
    for name, method in described.items():
        assert method["summary"], name
        assert method["result"]["schema"], name
        assert [p["name"] for p in method["params"]] == list(ALL_METHODS[name].params.model_fields)


def test_required_members_of_openrpc_are_there() -> None:
    assert document()["openrpc"].startswith("1.")
    assert {"title", "version"} <= document()["info"].keys()
    for method in document()["methods"]:
        assert method["paramStructure"] in ("by-name", "by-position", "either")
        names = [p["name"] for p in method["params"]]
        assert len(set(names)) == len(names)
        required = [p["required"] for p in method["params"]]
        assert required == sorted(required, reverse=True), f"{method['name']}: required parameters come first"
        assert all("schema" in p for p in method["params"])
        assert all(isinstance(e["code"], int) and e["message"] for e in method["errors"])


def test_every_reference_leads_somewhere() -> None:
    def references(node: Any) -> list[str]:
        if isinstance(node, dict):
            own = [node["$ref"]] if "$ref" in node else []
            return own + [r for v in node.values() for r in references(v)]
        return [r for v in node for r in references(v)] if isinstance(node, list) else []

    found = references(document())
    assert found
    for reference in found:
        assert reference.removeprefix("#/components/schemas/") in document()["components"]["schemas"]


def test_every_group_of_the_state_is_described() -> None:
    state = document()["components"]["schemas"]["VehicleState"]
    assert list(state["properties"]) == list(VehicleState.__annotations__)
    gps = document()["components"]["schemas"]["GpsPart"]
    assert {"fix", "fix_type", "age_s"} <= set(gps["properties"])
    assert state["properties"]["status_texts"]["items"] == {"$ref": "#/components/schemas/StatusTextEntry"}


ORDERS = {
    "arm": VehicleActor.arm,
    "disarm": VehicleActor.disarm,
    "takeoff": VehicleActor.takeoff,
    "land": VehicleActor.land,
    "rtl": VehicleActor.rtl,
    "hold": VehicleActor.hold,
    "stop": VehicleActor.stop,
    "goto": VehicleActor.goto,
    "reboot": VehicleActor.reboot,
    "set_home": home_orders.set_home,
    "interval": VehicleActor.set_message_interval,
    "request": VehicleActor.request_message,
    "stream": VehicleActor.request_stream,
    "command": VehicleActor.command,
}
CHECKED_BY_THE_FLEET = {"targets", "confirm", "same_place", "together"}

OF_THE_DAEMON = {"engage", "spares"}
"""Given by a plan only, which engages control itself, and by returns only."""


@each("order", ORDERS)
def test_the_parameters_of_an_order_are_those_of_the_actors_method(order: str) -> None:
    given = ALL_METHODS[f"vehicles.{order}"].params.model_fields.keys() - CHECKED_BY_THE_FLEET
    parameters = inspect.signature(ORDERS[order]).parameters
    if "where" in parameters:
        assert given == Where.__annotations__.keys()
    else:
        assert given == parameters.keys() - {"self", "actor"} - OF_THE_DAEMON


@each("order", ["arm", "disarm", "takeoff", "land", "rtl", "hold", "goto", "reboot", "mode"])
def test_the_clients_method_of_an_order_has_its_parameters(order: str) -> None:
    fields = ALL_METHODS[f"vehicles.{order}"].params.model_fields
    parameters = inspect.signature(getattr(Client, order)).parameters
    assert set(parameters) - {"self"} == set(fields)
    for name, field in fields.items():
        if name != "targets":
            expected = inspect.Parameter.empty if field.is_required() else field.default
            assert parameters[name].default == expected, name


def test_a_state_of_the_fake_vehicle_is_one_of_the_described_kind() -> None:
    state = FakeDaemon().vehicle("alpha").state(0.0)
    TypeAdapter(VehicleState).validate_python(state)
    assert set(state) == set(VehicleState.__annotations__)


@each("name", ALL_METHODS)
def test_every_handler_says_what_it_does(name: str) -> None:
    text = inspect.getdoc(ALL_METHODS[name].handler)
    assert text and text[0].isupper() and "." in text
