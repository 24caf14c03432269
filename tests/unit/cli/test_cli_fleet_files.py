"""`skygcs check`: a summary of what is right, every problem of what is not."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.cli.fleet_files import check

FLEET = """
[daemon]
sysid = 250
[origin]
lat_deg = 43.5
lon_deg = -79.5
alt_amsl_m = 180
[links.radio]
type = "serial"
device = "/dev/absent"
baud = [57600, 115200]
role = "radio"
[links.gcs]
type = "udp_client"
host = "10.0.0.1"
port = 14550
enabled = false
[links.flight]
type = "replay"
file = "absent.tlog"
[vehicles.alpha]
sysid = 1
autopilot = "px4"
group = ["red", "fast"]
"""


def test_what_is_right_is_summed_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET)
    assert check(path) == 0
    out, err = capsys.readouterr()
    assert err == ""
    for text in (
        *("no problem found", "250/25", "ardupilotmega+px4-extras", "/dev/absent at 57600 or 115200 baud"),
        *("10.0.0.1:14550", "not enabled", "red, fast", "43.5, -79.5, 180.0 m"),
        *("links.radio: /dev/absent does not exist now", "links.flight: the file"),
    ):
        assert text in " ".join(out.split()), text


def test_a_replay_beside_a_link_that_may_carry_vehicles_is_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET)
    assert check(path) == 0
    assert "note: links.flight: a replay beside radio: nothing of it is sent there" in capsys.readouterr().out
    path.write_text(FLEET.replace("baud = [57600, 115200]", "enabled = false"))
    assert check(path) == 0
    assert "a replay beside" not in capsys.readouterr().out


def test_a_fleet_without_links_and_vehicles_says_what_happens(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text("[daemon]\nrecord = false\n")
    assert check(path) == 0
    out, _ = capsys.readouterr()
    assert "can be added while the daemon runs" in out and "not recorded" in out and "none named" in out


def test_every_problem_is_printed_and_the_answer_is_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET.replace("250", "900").replace("udp_client", "udp_klient"))
    assert check(path) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert f"{path}: 2 problems" in err
    assert "daemon.sysid (line 3)" in err and "did you mean udp_client?" in err
    assert check(tmp_path / "gone.toml") == 1
    assert "no such file" in capsys.readouterr().err


SERVERS = """
[links.wifi]
type = "udp_server"
host = "0.0.0.0"
port = 14550
role = "vehicle"
[links.tcp]
type = "tcp_server"
host = "::"
port = 5760
[links.here]
type = "udp_server"
host = "127.0.0.1"
port = 14551
[links.office]
type = "udp_server"
port = 14552
allow_from = ["10.0.0.0/24"]
[links.signed]
type = "udp_server"
port = 14553
[links.signed.signing]
key_file = "key"
[links.asked]
type = "udp_server"
port = 14554
[links.asked.signing]
key_file = "key"
link_id = 1
accept_unsigned = ["*"]
[links.off]
type = "udp_server"
port = 14555
enabled = false
"""


def test_servers_that_anybody_may_speak_to_are_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(SERVERS)
    assert check(path) == 0
    out = capsys.readouterr().out
    noted = [line.split(":")[1].strip() for line in out.splitlines() if "can act as a vehicle" in line]
    assert noted == ["links.wifi", "links.tcp", "links.asked"]
    assert "any host that reaches 0.0.0.0:14550" in out


def test_a_package_that_a_table_needs_is_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text("[metrics]\n")
    assert check(path) == 0 and "not installed" not in capsys.readouterr().out
    monkeypatch.setattr("skygcs.ext.metrics.find_spec", lambda module: None)
    assert check(path) == 0
    notes = [line for line in capsys.readouterr().out.splitlines() if "not installed" in line]
    assert notes == ["note: metrics: prometheus_client is not installed here: pip install 'skygcs[metrics]'"]
