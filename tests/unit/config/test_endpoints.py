"""Links bound to vehicles in the fleet file: what goes together, and what a person is told where it does not."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.config.addresses import host_and_port
from skygcs.config.allow_list import allow_list, check_address
from skygcs.config.checks import endpoint_text, link_warnings
from skygcs.config.loader import load_fleet
from skygcs.config.models import FleetConfig
from skygcs.errors import ConfigError, RefusedError
from support.table import each

VEHICLES = "[vehicles.kite]\nsysid = 5\n[vehicles.hawk]\nsysid = 6\n"
LINK = '[links.p]\ntype = "udp_server"\nport = 14561\nrole = "gcs"\n'
SIGNED = '[links.radio]\ntype = "serial"\ndevice = "/dev/x"\nrole = "radio"\n[links.radio.signing]\nkey_file = "k"\n'


def load(folder: Path, text: str) -> FleetConfig:
    path = folder / "fleet.toml"
    path.write_text(text)
    return load_fleet(path)


@each(
    ("keys", "sysids", "shown"),
    [
        ('vehicles = ["kite"]', [5], "kite"),
        ('vehicles = ["kite", 7, "v8", "9"]', [5, 7, 8, 9], "kite, 7, v8, 9"),
        ("vehicles = [5]\ntranslated_sysid = 1", [5], "5 as 1"),
        ('vehicles = ["hawk"]\ntranslated_sysid = 6', [6], "hawk as 6"),
    ],
)
def test_vehicles_are_names_or_system_ids(tmp_path: Path, keys: str, sysids: list[int], shown: str) -> None:
    config = load(tmp_path, VEHICLES + LINK + keys)
    assert list(config.bound_sysids(config.links["p"]).values()) == sysids
    assert endpoint_text(config.links["p"]) == shown


def test_several_programs_may_see_one_id(tmp_path: Path) -> None:
    text = VEHICLES
    for n, vehicle in enumerate(("kite", "hawk", "kite")):
        text += LINK.replace("links.p", f"links.p{n}").replace("14561", f"1456{n}")
        text += f'vehicles = ["{vehicle}"]\ntranslated_sysid = 1\n'
    assert len(load(tmp_path, text).links) == 3


@each(
    ("text", "complaint"),
    [
        (LINK + 'vehicles = ["kit"]', "links.p.vehicles[0] (line 9): there is no vehicle 'kit'; did you mean kite?"),
        (LINK + 'vehicles = ["zoe"]', "there is no vehicle 'zoe'; there are: kite, hawk; or a system id, 1 to 255"),
        (LINK + "vehicles = [300]", "there is no vehicle 300"),
        (LINK + "vehicles = [0]", "there is no vehicle 0"),
        (LINK + "vehicles = [255]", "255 is skygcs's own system id (daemon.sysid), and no vehicle's"),
        (LINK + 'vehicles = ["kite", 5]', "5 is system 5, as 'kite' is: name it once"),
        (LINK.replace("gcs", "vehicle") + "vehicles = [5]", 'needs role = "gcs" (it is "vehicle")'),
        (
            LINK.replace('role = "gcs"\n', "") + "vehicles = [5]",
            'needs role = "gcs" (it is "peer"): a bound link has a program',
        ),
        (LINK + 'vehicles = ["kite", "hawk"]\ntranslated_sysid = 1', "and `vehicles` has 2: make a link for each"),
        (LINK + "translated_sysid = 1", "links.p.translated_sysid (line 9): gives one vehicle another id"),
        (LINK + "vehicles = [5]\ntranslated_sysid = 255", "255 is skygcs's own system id (daemon.sysid)"),
        (LINK + "vehicles = [5]\ntranslated_sysid = 0", "translated_sysid"),
        (
            LINK + 'vehicles = [5]\ntranslated_sysid = 1\n[links.p.signing]\nkey_file = "k"',
            "changes every frame, and a changed frame has no signature",
        ),
        (
            '[links.p]\ntype = "serial"\ndevice = "/dev/x"\nrole = "gcs"\nvehicles = [5]',
            "is for links to programs, udp_… and tcp_…; a serial link has the vehicles themselves behind it",
        ),
        ('[links.p]\ntype = "simulated"\npx4 = 1\nvehicles = [1]', "a simulated link has the vehicles"),
        ('[links.p]\ntype = "replay"\nfile = "x.tlog"\nvehicles = [1]', "a replay link has the vehicles"),
    ],
)
def test_what_does_not_go_together_is_told_with_what_to_do(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, VEHICLES + text)
    assert len(caught.value.problems) == 1, caught.value.problems
    assert complaint in caught.value.problems[0]


def test_what_is_wrong_by_itself_is_not_told_again_of_the_link(tmp_path: Path) -> None:
    text = "[daemon]\nsysid = 300\n[vehicles.kite]\nsysid = 300\n" + LINK.replace("gcs", "gsc")
    for keys, mistakes in (
        ('vehicles = ["kite"]\ntranslated_sysid = 255', 3),
        ("vehicles = [1.5]\ntranslated_sysid = 1", 4),
    ):
        with pytest.raises(ConfigError) as caught:
            load(tmp_path, text + keys)
        assert len(caught.value.problems) == mistakes, caught.value.problems


@each(
    ("keys", "warned"),
    [
        ("vehicles = [5]", "a frame that names no target from it is readdressed and loses its signature"),
        ("vehicles = [5]\ntranslated_sysid = 1", "every frame from it is readdressed and loses its signature"),
        ("vehicles = [5, 6]", None),
        ("", None),
        ("vehicles = [5]\nenabled = false", None),
    ],
)
def test_orders_that_lose_their_signature_are_warned_of(tmp_path: Path, keys: str, warned: str | None) -> None:
    found = link_warnings(load(tmp_path, SIGNED + LINK + keys))
    assert (warned in found["p"] and "links.radio" in found["p"]) if warned is not None else not found
    assert not link_warnings(load(tmp_path, LINK + keys)), "nobody checks"


def test_the_old_key_is_answered_with_the_new_one(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text('[links.p]\ntype = "udp_server"\nport = 14561\nrole = "gcs"\nvehicles = [5]\npresent_as = 1\n')
    with pytest.raises(ConfigError) as found:
        load_fleet(path)
    assert found.value.problems == ["links.p.present_as (line 6): is called translated_sysid now: rename the key"]


def test_a_vehicle_that_is_not_there_in_a_file_without_vehicles(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no vehicle 'zoe'; the fleet file names none; or a system id, 1 to 255"):
        load(tmp_path, LINK + 'vehicles = ["zoe"]')


# -- ``HOST:PORT`` in files.


@each("text", ["", ":", "h:", ":1", "h:65536", "h:-1", "h:1x", "h:١", "h:000001", "a:b:1"])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        host_and_port(text)


# -- Exact lists of hosts and origins.


LOCAL = allow_list("127.0.0.1", 8750, (), tls=False)


@each("host", ["127.0.0.1:8750", "localhost:8750", "[::1]:8750"])
def test_this_machine_is_served_under_its_own_names(host: str) -> None:
    assert LOCAL.refusal(host, None, websocket=False) is None
    assert LOCAL.refusal(host, f"http://{host}", websocket=True, site="same-origin") is None


@each(
    "host",
    [
        None,
        "",
        "127.0.0.1",
        "127.0.0.1:8751",
        "127.evil.com",
        "127.evil.com:8750",
        "127.0.0.1.evil.com:8750",
        "localhost.:8750",
        "LOCALHOST:8750",
        "evil@127.0.0.1:8750",
        "127.0.0.1:8750:80",
        "0.0.0.0:8750",
        "127.1:8750",
        "2130706433:8750",
        " 127.0.0.1:8750",
    ],
)
def test_any_other_host_is_refused(host: str | None) -> None:
    assert LOCAL.refusal(host, None, websocket=False) is not None


@each(
    "origin",
    [
        *("null", "", "http://evil.com", "https://127.0.0.1:8750", "http://127.0.0.1"),
        *("http://127.0.0.1:8751", "http://127.0.0.1:8750.evil.com", "http://127.0.0.1:8750/", "file://"),
    ],
)
@each("websocket", [False, True])
def test_a_foreign_origin_is_refused(origin: str, websocket: bool) -> None:
    assert LOCAL.refusal("127.0.0.1:8750", origin, websocket=websocket) is not None


def test_a_websocket_needs_an_origin_and_no_other_site() -> None:
    own = "http://127.0.0.1:8750"
    assert LOCAL.refusal("127.0.0.1:8750", None, websocket=True) is not None
    assert LOCAL.refusal("127.0.0.1:8750", own, websocket=True, site="cross-site") is not None
    assert LOCAL.refusal("127.0.0.1:8750", own, websocket=True, site="same-site") is not None
    assert LOCAL.refusal("127.0.0.1:8750", own, websocket=True) is None  # a browser that does not send it


def test_another_address_is_served_under_itself_and_its_names_only() -> None:
    allowed = allow_list("192.168.1.10", 8750, ("gcs.lan",), tls=True)
    assert allowed.hosts == {"192.168.1.10:8750", "gcs.lan:8750"}
    assert allowed.origins == {"https://192.168.1.10:8750", "https://gcs.lan:8750"}
    assert allow_list("fd00::1", 443, (), tls=True).hosts == {"[fd00::1]:443", "[fd00::1]"}
    assert allow_list("0.0.0.0", 8750, ("gcs",), tls=True).hosts == {"gcs:8750"}


def test_another_address_needs_tls_and_a_wildcard_needs_names() -> None:
    check_address("127.0.0.1", (), tls=False)
    check_address("::1", (), tls=False)
    check_address("192.168.1.10", (), tls=True)
    check_address("0.0.0.0", ("gcs",), tls=True)
    for address in ("192.168.1.10", "0.0.0.0", "::", "127.0.0.2"):
        with pytest.raises(RefusedError, match="needs TLS"):
            check_address(address, ("gcs",), tls=False)
    with pytest.raises(RefusedError, match="names"):
        check_address("0.0.0.0", (), tls=True)
    with pytest.raises(RefusedError, match="IP address"):
        check_address("gcs.lan", (), tls=True)
