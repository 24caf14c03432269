"""Federation of the fleet file and of the command line."""

from __future__ import annotations

import asyncio
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.cli.connection import client, names_other_sites
from skygcs.cli.serve import new_parser
from skygcs.config.loader import load_fleet
from skygcs.config.models import FleetConfig, VehicleEntry
from skygcs.config.station_path import station_socket
from skygcs.errors import ConfigError, DaemonUnreachable, RpcError, SkygcsError
from skygcs.ext.federation import commands, extension
from skygcs.ext.federation.authority import MAX_VALID_S, Authority
from skygcs.ext.federation.config import FederationConfig, SharedVehicle, server_address
from skygcs.ext.federation.extension import PACKAGES, Federation, federation_arguments
from skygcs.ext.federation.hub_inventory import HubInventory, inventory_of, load_inventory
from skygcs.rpc.address import SOCKET_VARIABLE
from skygcs.rpc.error_codes import METHOD_NOT_FOUND
from support.public_data import ROOT
from support.table import each

# -- [federation] of the fleet file, and the hub's inventory.


KEYS = ["U" + letter * 55 for letter in "ABCDEFGH"]
TABLE = 'site = "north"\nservers = ["tls://10.0.0.1:4222"]\nnkey = "n.nk"\n'


def problems(folder: Path, text: str) -> list[str]:
    file = folder / "fleet.toml"
    file.write_text(text)
    try:
        load_fleet(file)
    except ConfigError as error:
        return error.problems
    return []


def test_paths_begin_at_the_fleet_file_and_the_rest_has_its_defaults(tmp_path: Path) -> None:
    text = f'[federation]\n{TABLE}ca = "ca.crt"\n[federation.vehicles.alpha]\nhome = "south"\n'
    text += "[vehicles.alpha]\nsysid = 1\n"
    assert problems(tmp_path, text) == []
    fleet = load_fleet(tmp_path / "fleet.toml")
    federation = fleet.extensions["federation"]
    assert isinstance(federation, FederationConfig)
    assert (federation.nkey, federation.ca, federation.cert) == (tmp_path / "n.nk", tmp_path / "ca.crt", None)
    assert (federation.rate_hz, federation.subscribe_hz, federation.share) == (10, 10, ("all",))
    assert federation.vehicles["alpha"].without_hub == "continue"
    assert fleet.delegated == {"alpha"} and fleet.vehicle_configs()[0].delegated


@each(
    ("text", "expected"),
    [
        ("[federation]\n", "federation.servers"),
        (f"[federation]\n{TABLE}cert = 'c'\n", "federation (line 1): key is missing: cert needs it"),
        (f"[federation]\n{TABLE}role = 'pilot'\n", "one of site, operator, observer"),
        (f"[federation]\n{TABLE}subscribe_hz = 5\n", "federation.subscribe_hz (line 5): must be one of 10, 2"),
        (
            f"[federation]\n{TABLE}[federation.vehicles.a]\nhome='south'\n",
            "federation.vehicles.a (line 5): is not a vehicle",
        ),
        (
            f"[federation]\n{TABLE}[federation.vehicles.a]\nhome='south'\nwithout='x'\n[vehicles.a]\nsysid=1\n",
            "unknown key",
        ),
        (f"[federation]\n{TABLE}[vehicles.'a.b']\nsysid = 1\n", 'vehicles."a.b" (line 5): is part of the hub'),
        (
            f"[federation]\n{TABLE}role = 'observer'\n[federation.vehicles.a]\nhome = 'south'\n",
            "has no meaning for role",
        ),
    ],
)
def test_each_mistake_is_said_with_its_key_and_line(text: str, expected: str, tmp_path: Path) -> None:
    found = problems(tmp_path, text)
    assert any(expected in problem for problem in found), found


@each(
    "address",
    [
        *(
            "nats://10.0.0.1:4222",
            "nats://hub.example",
            "nats://0.0.0.0:4222",
            "nats://[::]:1",
            "nats://127.0.0.1.evil.com",
        ),
        *("http://127.0.0.1", "tls://", "tls://10.0.0.1/path", "tls://10.0.0.1:99999", "tls://10.0.0.1:x", "10.0.0.1"),
        *(
            "tls://user:secret@10.0.0.1",
            "ws://127.0.0.1:80",
            "tls://10.0.0.1?tls=no",
            "tls://[::1",
            "nats://localhost.evil",
        ),
    ],
)
def test_an_address_that_is_not_safe_or_none_is_refused_and_its_secret_is_not_repeated(address: str) -> None:
    with pytest.raises(ValueError) as caught:
        server_address(address)
    assert "secret" not in str(caught.value)


@each(
    ("address", "url"),
    [
        ("nats://127.0.0.1", "nats://127.0.0.1:4222"),
        ("nats://localhost:7", "nats://localhost:7"),
        ("nats://[::1]:7", "nats://[::1]:7"),
        ("tls://hub.example:443/", "tls://hub.example:443"),
        ("tls://[fd00::1]", "tls://[fd00::1]:4222"),
    ],
)
def test_an_address_has_a_port(address: str, url: str) -> None:
    assert server_address(address).url == url


@given(st.text(max_size=60))
def test_any_text_is_an_address_or_a_value_error(text: str) -> None:
    try:
        address = server_address(text)
    except ValueError:
        return
    assert server_address(address.url) == address


def users(**tables: str) -> str:
    return "".join(f'[users.{n}]\nnkey = "{key}"\n{t}\n' for (n, t), key in zip(tables.items(), KEYS, strict=False))


def test_an_inventory_has_absolute_paths_and_knows_who_orders_whom(tmp_path: Path) -> None:
    text = users(north='role="site"\norders=["south"]', south='role="site"', boss='role="operator"\norders=["*"]')
    (tmp_path / "hub.toml").write_text(f'[tls]\ncert="c"\nkey="k"\n{text}')
    inventory = load_inventory(tmp_path / "hub.toml")
    assert inventory.tls is not None and inventory.tls.cert == tmp_path / "c"
    assert inventory.store == tmp_path / "jetstream"
    ordered = {name: inventory.sites_ordered_by(name) for name in inventory.users}
    assert ordered == {"north": ["south"], "south": [], "boss": ["north", "south"]}


@each(
    ("text", "expected"),
    [
        ("", "users: is missing"),
        ("[users.north]\nrole = 'site'\n", "users.north (line 1): needs nkey"),
        ("[users.north]\nrole = 'site'\nnkey = 'SUAB'\n", "users.north.nkey (line 3): is not a public key"),
        (users(north='role="pilot"'), "users.north.role (line 3)"),
        (
            users(north='role="observer"\norders=["*"]'),
            'users.north (line 1): orders has no meaning for role "observer"',
        ),
        (
            users(north='role="site"\norders=["south"]'),
            'users.north.orders (line 4): names "south", which is not a user',
        ),
        (users(North='role="site"'), "users.North (line 1): must be a small letter"),
        (f'listen="0.0.0.0:4222"\n{users(north="role=" + repr("site"))}', "listen (line 1): 0.0.0.0:4222: an address"),
        (f'listen="127.0.0.1"\n{users(north="role=" + repr("site"))}', "listen (line 1)"),
        (f"password = 'x'\n{users(north='role=' + repr('site'))}", "password (line 1): unknown key"),
        (f"[federation]\n{TABLE}", "is a station's fleet file"),
        ("listen = ", "not TOML"),
        (
            f"[users.a]\nrole='site'\nnkey='{KEYS[0]}'\n[users.b]\nrole='site'\nnkey='{KEYS[0]}'\n",
            "users.b.nkey (line 6): is that of a: each station has a key of its own",
        ),
    ],
)
def test_each_mistake_of_an_inventory_is_said_with_its_key_and_line(text: str, expected: str, tmp_path: Path) -> None:
    (tmp_path / "hub.toml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_inventory(tmp_path / "hub.toml")
    assert any(expected in problem for problem in caught.value.problems), caught.value.problems


def test_an_inventory_without_a_file_is_the_same() -> None:
    made = inventory_of({"users": {"a": {"role": "observer", "nkey": KEYS[0]}}}, "test")
    assert isinstance(made, HubInventory) and made.local_url == "nats://127.0.0.1:4222"


# -- [federation]: the command line that it makes is one that `skygcs` takes, and what `skygcs check` says of it.


EXTENSION_TABLE = FederationConfig(site="north", servers=("nats://127.0.0.1",), nkey=Path("n.nk"))


def test_the_bridge_gets_its_fleet_file_and_the_daemons_socket() -> None:
    args = new_parser().parse_args(federation_arguments("/etc/fleet.toml", Path("/run/x y.sock")))
    assert (args.file, args.socket) == (Path("/etc/fleet.toml"), "/run/x y.sock")
    assert args.supervised and not args.no_daemon


def test_only_the_vehicles_of_the_table_are_delegated() -> None:
    table = EXTENSION_TABLE.model_copy(update={"vehicles": {"alpha": SharedVehicle(home="north")}})
    vehicles = {"alpha": VehicleEntry(sysid=1), "bravo": VehicleEntry(sysid=2)}
    applied = Federation.applied(table, FleetConfig(vehicles=vehicles))
    assert {v.name: v.delegated for v in applied.vehicle_configs()} == {"alpha": True, "bravo": False}


def test_what_is_missing_is_noted_and_no_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> str:
        raise SkygcsError("nats-server is not installed")

    monkeypatch.setattr(extension, "find_server", missing)
    monkeypatch.setattr(extension, "find_spec", lambda name: None)
    assert Federation.notes(EXTENSION_TABLE) == [
        "nats, nkeys is not installed here: pip install 'skygcs[federation]'",
        "the file n.nk (nkey) does not exist now",
        "servers: nats-server is not installed",
    ]
    assert Federation.summary(EXTENSION_TABLE) == "nats://127.0.0.1:4222 as site north"


def test_the_packages_are_those_of_the_extra() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for package in PACKAGES:
        assert any(required.startswith(package) for required in extras["federation"]), package


# -- Orders to other sites go to the station socket, everything else to the daemon's.


@each(
    ("targets", "with_station", "without"),
    [
        ("south/alpha", True, True),
        ("alpha, south/all", True, True),
        ("*/all", True, True),
        ("all sites", True, True),
        ("south/3", True, False),  # without a station: component 3 of a vehicle
        ("7/191", False, False),
        ("all", False, False),
        ("1-5,alpha", False, False),
    ],
)
def test_which_socket_an_order_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, targets: str, with_station: bool, without: bool
) -> None:
    monkeypatch.setenv(SOCKET_VARIABLE, str(tmp_path / "d.sock"))
    assert names_other_sites(targets) == without
    Path(station_socket(str(tmp_path / "d.sock"))).touch()
    assert names_other_sites(targets) == with_station


def test_without_a_station_socket_the_error_says_what_is_needed(tmp_path: Path) -> None:
    with pytest.raises(DaemonUnreachable, match=r"\[federation\]"):
        client(str(tmp_path / "d.sock"), station=True)


class StationWithoutLeases:
    async def call(self, method: str, **_: Any) -> Any:
        raise RpcError(METHOD_NOT_FOUND, f"no method {method}")


@each("order", ["take", "release"])
def test_a_station_without_leases_says_what_they_need(order: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def called(command: Any) -> None:
        await command(StationWithoutLeases())

    monkeypatch.setattr(commands, "run", lambda command, *, station: asyncio.run(called(command)))
    with pytest.raises(SkygcsError, match=r"no leases.*\[federation.vehicles\]"):
        getattr(commands, order)("alpha")


# -- Authority over shared vehicles: what a grant opens, what ends it, and what is fenced off.


ALPHA, BRAVO, OWN = 7, 8, 9


def shared() -> Authority:
    return Authority("north", {"alpha": ALPHA, "bravo": BRAVO})


def is_closed(authority: Authority, now: float) -> bool:
    return authority.refusal(ALPHA, now) is not None


def test_a_vehicle_is_closed_until_it_is_granted_and_again_when_the_time_is_over() -> None:
    a = shared()
    assert set(a.sysids) == {ALPHA, BRAVO}
    assert is_closed(a, 10.0)
    assert a.grant("alpha", 12.5, 10.0, token=1) == "granted"
    assert not is_closed(a, 12.499)
    assert is_closed(a, 12.5)
    assert a.refusal(BRAVO, 11.0) is not None


def test_older_tokens_and_revoked_ones_are_fenced_off_until_another_hub_counts() -> None:
    a = shared()
    assert a.grant("alpha", 12.0, 10.0, token=5, hub="a") == "granted"
    assert a.grant("alpha", 12.0, 10.0, token=4, hub="a") == "fenced"
    a.revoke("alpha", token=5, hub="a", commander="south")
    assert a.grant("alpha", 12.0, 10.0, token=5, hub="a") == "fenced"
    assert is_closed(a, 10.0)
    assert a.grant("alpha", 12.0, 10.0, token=6, hub="a") == "granted"
    a.revoke("alpha", token=6, hub="a")
    assert a.grant("alpha", 12.0, 10.0, token=1, hub="b") == "granted"


def test_a_grant_that_was_under_way_too_long_grants_nothing_and_keeps_what_is_in_force() -> None:
    a = shared()
    a.grant("alpha", 12.0, 10.0, token=1)
    assert a.grant("alpha", 10.5, 10.5, token=2) == "late"
    assert not is_closed(a, 11.9)


@each("until", [10.0 + MAX_VALID_S + 0.2, float("inf"), float("nan")])
def test_no_grant_outlives_a_lease(until: float) -> None:
    with pytest.raises(ValueError, match="one clock"):
        shared().grant("alpha", until, 10.0, token=1)


def test_a_refusal_names_the_commander_and_what_to_do() -> None:
    a = shared()
    assert a.refusal(ALPHA, 10.0) == "alpha is not commanded by north now; `skygcs-cli federation take alpha`"
    a.revoke("alpha", token=3, commander="south")
    assert a.refusal(ALPHA, 10.0) == "alpha is commanded by south; `skygcs-cli federation take alpha`"
    a.grant("alpha", 12.0, 10.0, token=4)
    assert a.refusal(ALPHA, 11.0) is None
    assert a.refusal(ALPHA, 12.0) == "alpha is not commanded by north now; `skygcs-cli federation take alpha`"


def test_state_shows_authority() -> None:
    a = shared()
    assert a.status_of(OWN, 10.0) is None
    a.grant("alpha", 12.0, 10.0, token=1, hub="h")
    state = a.status_of(ALPHA, 11.0)
    assert state == {"held": True, "commander": "north", "remaining_s": 1.0, "token": 1, "hub": "h"}
    lapsed = a.status_of(ALPHA, 12.0)
    assert lapsed is not None
    assert (lapsed["held"], lapsed["commander"]) == (False, None)
