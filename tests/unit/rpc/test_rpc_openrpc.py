"""The interface's description of itself agrees with what it does."""

from __future__ import annotations

import inspect
import json
from typing import Any

import pytest

from skygcs.core.vehicle.state import VehicleState as CoreState
from skygcs.rpc import models, openrpc
from skygcs.rpc.methods import METHODS
from support.fake_daemon import FakeDaemon

DOCUMENT: dict[str, Any] = json.loads(json.dumps(openrpc.document(METHODS.values())))

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
    described = {m["name"]: m for m in DOCUMENT["methods"]}
    names = {f"{area}.{verb}" for area, verbs in CONTRACT.items() for verb in verbs.split()}
    assert names | {"subscribe", "unsubscribe"} <= described.keys()
    for name, method in described.items():
        assert method["summary"], name
        assert method["result"]["schema"], name
        assert [p["name"] for p in method["params"]] == list(METHODS[name].params.model_fields)


def test_required_members_of_openrpc_are_there() -> None:
    assert DOCUMENT["openrpc"].startswith("1.")
    assert {"title", "version"} <= DOCUMENT["info"].keys()
    for method in DOCUMENT["methods"]:
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

    found = references(DOCUMENT)
    assert found
    for reference in found:
        assert reference.removeprefix("#/components/schemas/") in DOCUMENT["components"]["schemas"]


def test_the_described_state_has_the_keys_of_the_real_one() -> None:
    assert list(models.VehicleState.model_fields) == list(CoreState.__annotations__)


def test_a_state_of_the_fake_vehicle_is_one_of_the_described_kind() -> None:
    state = FakeDaemon().vehicle("alpha").state(0.0)
    models.VehicleState.model_validate(state)
    assert set(state) == set(models.VehicleState.model_fields)


@pytest.mark.parametrize("name", METHODS)
def test_every_handler_says_what_it_does(name: str) -> None:
    text = inspect.getdoc(METHODS[name].handler)
    assert text and text[0].isupper() and "." in text
