"""[corrections] of the fleet file: what it takes, and what is wrong with it, with its key."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.config.loader import load_fleet
from skygcs.errors import ConfigError
from skygcs.ext.corrections.config import CorrectionsConfig, parse_ntrip
from skygcs.ext.corrections.extension import OwnCorrections
from skygcs.ext.corrections.ntrip import Mountpoint
from skygcs.ext.corrections.receiver import receiver_port
from support.table import each

NTRIP = 'ntrip = "ntrip://ada@caster.example:2102/MOUNT"\n'
SERIAL = 'serial = "/dev/ttyACM7"\n'


def load(tmp_path: Path, table: str, rest: str = "") -> CorrectionsConfig:
    path = tmp_path / "fleet.toml"
    path.write_text(f"[corrections]\n{table}\n[vehicles.alpha]\nsysid = 1\n{rest}")
    found = load_fleet(path).extensions["corrections"]
    assert isinstance(found, CorrectionsConfig)
    return found


@each(
    ("text", "mountpoint"),
    [
        ("ntrip://caster.example/M", Mountpoint("caster.example", 2101, "M")),
        ("ntrips://caster.example/M", Mountpoint("caster.example", 443, "M", True)),
        ("ntrip://ada%40example.org@h:80/M-1_x", Mountpoint("h", 80, "M-1_x", False, "ada@example.org")),
        ("ntrip://[2001:db8::1]:2101/M", Mountpoint("2001:db8::1", 2101, "M")),
    ],
)
def test_an_address_is_read(text: str, mountpoint: Mountpoint) -> None:
    assert parse_ntrip(text) == mountpoint
    assert "ada" not in mountpoint.text


@each(
    ("text", "why"),
    [
        ("ntrip://ada:secret@h/M", "no password in the address"),
        ("http://h/M", "must begin with ntrip://"),
        ("caster.example:2101/M", "must begin with ntrip://"),
        ("ntrip://h", "host and mountpoint"),
        ("ntrip:///M", "host and mountpoint"),
        ("ntrip://h/a/b", "host and mountpoint"),
        ("ntrip://h/M?x=1", "host and mountpoint"),
        ("ntrip://h:0/M", "port must be"),
        ("ntrip://h:70000/M", "port is 1 to 65535"),
        ("ntrip://h/M\r\nX: y", "without spaces"),
        ("ntrip://h/M M", "without spaces"),
        ("ntrip://h/Mä", "without spaces"),
        ("ntrip://a%0d%0aX@h/M", "no control characters"),
        ("ntrip://a%3ab@h/M", "no colon"),
        ("ntrip://[::1/M", "must be an address"),
        ("", "without spaces"),
    ],
)
def test_a_wrong_address_is_named_and_a_password_never_shown(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why) as wrong:
        parse_ntrip(text)
    assert "secret" not in str(wrong.value)


def test_a_caster_and_a_receiver(tmp_path: Path) -> None:
    config = load(tmp_path, NTRIP + 'password_file = "caster.password"\ngga_from = "alpha"\n')
    assert config.password_file == tmp_path / "caster.password"
    assert config.mountpoint == Mountpoint("caster.example", 2102, "MOUNT", user="ada")
    config = load(tmp_path, SERIAL + "position = [43.78, -79.46, 150]\n")
    assert (config.position, config.observations) == ((43.78, -79.46, 150.0), "msm4")


@each(
    ("table", "rest", "words"),
    [
        ("", "", ("needs one of ntrip", "serial")),
        (NTRIP + SERIAL, "", ("needs one of",)),
        (NTRIP + "baud = 9600\n", "", ("baud has no meaning with ntrip",)),
        (SERIAL + "gga_s = 5\n", "", ("gga_s has no meaning with serial",)),
        (NTRIP + 'password_file = "a"\npassword_env = "B"\n', "", ("give one of them",)),
        (NTRIP + 'password_env = "A B"\n', "", ("corrections.password_env",)),
        (NTRIP + 'ca_file = "a"\n', "", ("without TLS",)),
        (NTRIP + 'gga_s = 0\ngga_from = "alpha"\n', "", ("gga_from has no meaning",)),
        (NTRIP + 'gga_from = "alfa"\n', "", ("corrections.gga_from", "vehicles: alpha")),
        (NTRIP + "revision = 3\n", "", ("corrections.revision",)),
        (NTRIP + "silent_s = 1\n", "", ("corrections.silent_s", "at least 3")),
        (NTRIP.replace("ada@", "ada:secret@"), "", ("corrections.ntrip", "password_file")),
        (SERIAL + "position = [100, 0, 0]\n", "", ("corrections.position", "above the ellipsoid")),
        (SERIAL + "position = [1, 2, 3]\nsurvey_s = 60\n", "", ("there is no survey",)),
        (SERIAL + 'observations = "msm5"\n', "", ("corrections.observations",)),
        (
            SERIAL,
            '[links.radio]\ntype = "serial"\ndevice = "/dev/ttyACM7"\nrole = "radio"\n',
            ("corrections.serial", "the link radio"),
        ),
    ],
)
def test_what_is_wrong_is_named_with_its_key(tmp_path: Path, table: str, rest: str, words: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError) as wrong:
        load(tmp_path, table, rest)
    for word in words:
        assert word in str(wrong.value)
    assert "secret" not in str(wrong.value)


def test_what_is_missing_for_now_is_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_SUCH_PASSWORD", raising=False)
    config = load(tmp_path, NTRIP + 'password_env = "NO_SUCH_PASSWORD"\n')
    assert OwnCorrections.notes(config) == ["the environment variable NO_SUCH_PASSWORD (password_env) is not set now"]
    assert "caster.password" in OwnCorrections.notes(load(tmp_path, NTRIP + 'password_file = "caster.password"\n'))[0]
    assert "/dev/ttyACM7" in OwnCorrections.notes(load(tmp_path, SERIAL))[0]


def test_the_port_of_the_receiver_follows_from_the_device(tmp_path: Path) -> None:
    by_id = tmp_path / "usb-u-blox"
    by_id.symlink_to("/dev/ttyACM7")
    assert receiver_port("auto", "/dev/ttyACM0") == receiver_port("auto", str(by_id)) == "usb"
    assert receiver_port("auto", "/dev/ttyUSB0") == "uart1"
    assert receiver_port("uart2", "/dev/ttyACM0") == "uart2"
