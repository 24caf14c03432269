"""[federation]: the command line that it makes is one that `skygcs` takes, and what `skygcs check` says of it."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from skygcs.cli.serve import new_parser
from skygcs.config.models import FleetConfig, VehicleEntry
from skygcs.errors import SkygcsError
from skygcs.ext.federation import extension
from skygcs.ext.federation.config import FederationConfig, SharedVehicle
from skygcs.ext.federation.extension import PACKAGES, Federation, federation_arguments
from support.public_data import ROOT

TABLE = FederationConfig(site="north", servers=("nats://127.0.0.1",), nkey=Path("n.nk"))


def test_the_bridge_gets_its_fleet_file_and_the_daemons_socket() -> None:
    args = new_parser().parse_args(federation_arguments("/etc/fleet.toml", Path("/run/x y.sock")))
    assert (args.file, args.socket) == (Path("/etc/fleet.toml"), "/run/x y.sock")
    assert args.supervised and not args.no_daemon


def test_only_the_vehicles_of_the_table_are_delegated() -> None:
    table = TABLE.model_copy(update={"vehicles": {"alpha": SharedVehicle(home="north")}})
    vehicles = {"alpha": VehicleEntry(sysid=1), "bravo": VehicleEntry(sysid=2)}
    applied = Federation.applied(table, FleetConfig(vehicles=vehicles))
    assert {v.name: v.delegated for v in applied.vehicle_configs()} == {"alpha": True, "bravo": False}


def test_what_is_missing_is_noted_and_no_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> str:
        raise SkygcsError("nats-server is not installed")

    monkeypatch.setattr(extension, "find_server", missing)
    monkeypatch.setattr(extension, "find_spec", lambda name: None)
    assert Federation.notes(TABLE) == [
        "nats, nkeys is not installed here: pip install 'skygcs[federation]'",
        "the file n.nk (nkey) does not exist now",
        "servers: nats-server is not installed",
    ]
    assert Federation.summary(TABLE) == "nats://127.0.0.1:4222 as site north"


def test_the_packages_are_those_of_the_extra() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for package in PACKAGES:
        assert any(required.startswith(package) for required in extras["federation"]), package
