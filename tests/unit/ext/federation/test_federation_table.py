"""[federation] of the fleet file, and the hub's inventory."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.config.loader import load_fleet
from skygcs.errors import ConfigError
from skygcs.ext.federation.config import FederationConfig, server_address
from skygcs.ext.federation.hub_inventory import HubInventory, inventory_of, load_inventory
from support.table import each

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
