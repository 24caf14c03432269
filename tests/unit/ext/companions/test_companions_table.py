"""[companion] and [companions] of the fleet file: what they make of the rest, and what is wrong, with its key."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.config.loader import load_fleet
from skygcs.config.models import FleetConfig, TcpClientLinkConfig, UdpClientLinkConfig
from skygcs.errors import ConfigError
from skygcs.ext.companions.companion_table import companion_table
from skygcs.ext.companions.companions_table import companions_table
from support.table import each

AUTOPILOT = '[links.autopilot]\ntype = "serial"\ndevice = "/dev/ttyACM0"\nrole = "vehicle"\n'
VEHICLE = "[vehicles.alpha]\nsysid = 7\n"
ON_BOARD = '[companion]\nvehicle = "alpha"\n'
WIFI = '[links.wifi]\ntype = "udp_server"\nport = 14650\n'


def load(tmp_path: Path, *tables: str) -> FleetConfig:
    path = tmp_path / "fleet.toml"
    path.write_text("\n".join(tables))
    return load_fleet(path)


def test_a_companion_has_its_vehicles_system_id_and_an_onboard_computers_component(tmp_path: Path) -> None:
    config = load(tmp_path, ON_BOARD + 'ground = "udp:10.0.0.1:14650"\n', VEHICLE, AUTOPILOT)
    assert (config.daemon.sysid, config.daemon.compid) == (7, 191)
    table = companion_table(config)
    assert table is not None
    assert table.key_dir == tmp_path / "keys"
    assert config.aboard == "alpha"
    link = config.links["ground"]
    assert isinstance(link, UdpClientLinkConfig)
    assert (link.name, link.role, link.host, link.port) == ("ground", "gcs", "10.0.0.1", 14650)


def test_the_ground_may_be_a_tcp_server_or_be_found_by_mdns(tmp_path: Path) -> None:
    tcp = load(tmp_path, ON_BOARD + 'ground = "tcp:[fe80::1]:5770"\n', VEHICLE, AUTOPILOT).links["ground"]
    assert isinstance(tcp, TcpClientLinkConfig)
    assert (tcp.host, tcp.port) == ("fe80::1", 5770)
    assert set(load(tmp_path, ON_BOARD, VEHICLE, AUTOPILOT).links) == {"autopilot"}  # until one is found


def test_the_links_key_file_begins_at_the_files_folder(tmp_path: Path) -> None:
    signing = '[companion.signing]\nkey_file = "link.key"\n'
    found = load(tmp_path, ON_BOARD, signing, VEHICLE, AUTOPILOT)
    table = companion_table(found)
    assert table is not None and table.signing is not None
    assert table.signing.key_file == tmp_path / "link.key"
    named = load(tmp_path, ON_BOARD + 'ground = "udp:10.0.0.1:14650"\n', signing, VEHICLE, AUTOPILOT).links["ground"]
    assert named.signing is not None
    assert named.signing.key_file == tmp_path / "link.key"


def test_companions_are_the_tables_of_companions(tmp_path: Path) -> None:
    alpha = '[companions]\nadvertise = true\n[companions.alpha]\nrpc = "10.0.0.7:5790"\n'
    config = load(
        tmp_path, alpha, '[companions.pi]\nvehicle = "bravo"\n', VEHICLE, "[vehicles.bravo]\nsysid = 8\n", WIFI
    )
    table = companions_table(config)
    assert table is not None
    assert table.entries["alpha"].rpc == "10.0.0.7:5790"
    assert [table.vehicle_of(name) for name in table.entries] == ["alpha", "bravo"]
    assert table.of_vehicle("bravo") == "pi"
    assert table.of_vehicle("charlie") is None
    assert table.key_dir == tmp_path / "keys"


@each(
    ("tables", "words"),
    [
        ((ON_BOARD, AUTOPILOT), ("companion.vehicle (line 2)", "not a vehicle of this file", "vehicles: none")),
        ((ON_BOARD + 'ground = "10.0.0.1:14650"\n', VEHICLE), ("companion.ground", "udp:HOST:PORT")),
        ((ON_BOARD + 'ground = "udp:10.0.0.1:0"\n', VEHICLE), ("companion.ground", "1 to 65535")),
        ((ON_BOARD + 'ground = "udp:fe80::1:14650"\n', VEHICLE), ("companion.ground", "[IPV6]:PORT")),
        ((ON_BOARD + 'rpc_listen = "5790"\n', VEHICLE), ("companion.rpc_listen", "HOST:PORT")),
        ((ON_BOARD + 'ground = "udp:g:1"\nground_name = "g"\n', VEHICLE), ("ground_name", "no meaning")),
        ((ON_BOARD + 'grund = "mdns"\n', VEHICLE), ("companion.grund", "did you mean ground")),
        ((ON_BOARD, VEHICLE, "[daemon]\nsysid = 9\n"), ("daemon.sysid", "remove the key")),
        ((ON_BOARD, VEHICLE, "[vehicles.bravo]\nsysid = 8\n"), ("vehicles.bravo", "has one vehicle")),
        ((ON_BOARD, VEHICLE, WIFI.replace("wifi", "ground")), ("links.ground", "choose another")),
        ((ON_BOARD, VEHICLE, "[companions]\n"), ("companions", "is for the ground")),
        (("[companions.alpha]\n",), ("companions.alpha", "not a vehicle of this file")),
        (('[companions.pi]\nvehicle = "x"\n', VEHICLE), ("companions.pi.vehicle", "vehicles: alpha")),
        (("[companions.alpha]\n", '[companions.pi]\nvehicle = "alpha"\n', VEHICLE), ("companions.pi", "alpha already")),
        (('[companions.alpha]\nrpc = "h"\n', VEHICLE), ("companions.alpha.rpc", "HOST:PORT")),
        (('[companions.alpha]\nhots = "h"\n', VEHICLE), ("companions.alpha.hots", "did you mean host")),
        (('[companions."../x"]\nvehicle = "alpha"\n', VEHICLE), ('companions."../x"', "letters, digits")),
        (("[companions]\nadvertise = true\n",), ("companions.advertise", "needs `link`", "none")),
        (('[companions]\nadvertise = true\nlink = "radio"\n', WIFI), ("companions.link", "wifi")),
        (('[companions]\nlink = "wifi"\n', WIFI), ("companions.link", "advertise")),
        ((VEHICLE + 'control.at = "companion"\n',), ("vehicles.alpha.control.at", "needs the table [companions]")),
        ((VEHICLE + 'control.at = "moon"\n',), ("vehicles.alpha.control.at", "one of ground, companion, not 'moon'")),
    ],
)
def test_what_is_wrong_is_named_with_its_key(tmp_path: Path, tables: tuple[str, ...], words: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, *tables)
    for word in words:
        assert word in str(caught.value)
