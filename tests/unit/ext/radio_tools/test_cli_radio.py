"""`radio …` without a radio: plans, refusals, wrong ports, and what is asked of the daemon."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from skygcs.cli.main import app
from skygcs.ext.radio_tools.settings import Firmware, RadioState, Register, to_toml

DONE, FAILED, USAGE = 0, 1, 2
FLEET = """
[links.wire]
type = "serial"
device = "/dev/null1"
[links.radio]
type = "serial"
device = "/dev/null2"
baud = [115200, 57600]
rtscts = true
role = "radio"
[vehicles.zulu]
sysid = 1
[vehicles.alpha]
sysid = 9
"""


@pytest.fixture(autouse=True)
def no_daemon(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SKYGCS_SOCKET", str(tmp_path / "nobody.sock"))


def run(*args: str | Path, code: int = DONE) -> str:
    result = CliRunner().invoke(app, ["radio", *map(str, args)])
    assert result.exit_code == code, result.output + repr(result.exception)
    return result.output


def test_a_plan_is_made_of_the_fleet_file_and_is_the_same_every_time(tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text(FLEET)
    words = ("provision", tmp_path / "fleet.toml", "--nodes", "4", "--net-id", "5", "--set", "TXPOWER=20", "--json")
    answer = json.loads(run(*words))
    assert [(row["node"], row["for"]) for row in answer["plan"]] == [
        (1, "ground"),
        (2, "zulu"),
        (3, "alpha"),
        (4, "spare"),
    ]
    settings = answer["plan"][0]["settings"]
    assert (settings["SERIAL_SPEED"], settings["RTSCTS"], settings["NETID"], settings["TXPOWER"]) == (115, 1, 5, 20)
    assert run(*words) == run(*words)
    shown = run("provision", tmp_path / "fleet.toml", "--nodes", "4")
    assert "all nodes: NODEDESTINATION 255 (all nodes), NETID 0, AIR_SPEED 64 kbit/s" in shown
    assert "node 1   ground         NODEID 1, NETCOUNT 1, NODECOUNT 4" in shown


def test_antennas_are_planned_for_the_ground_and_for_the_vehicles(tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text(FLEET)
    words = ("provision", tmp_path / "fleet.toml", "--antennas", "1", "--ground-antennas", "both")
    rows = json.loads(run(*words, "--json"))["plan"]
    assert [row["settings"]["ANT_MODE"] for row in rows] == [0, 1, 1]
    shown = run(*words)
    assert "ANT_MODE 0 (both antennas, the better one)" in shown and "ANT_MODE 1 (antenna 1 only)" in shown
    unasked = json.loads(run("provision", tmp_path / "fleet.toml", "--json"))["plan"]
    assert all("ANT_MODE" not in row["settings"] for row in unasked)
    for word in ("tx1-rx2", "TX1-RX2"):
        given = json.loads(run("provision", tmp_path / "fleet.toml", "--set", f"ANT_MODE={word}", "--json"))["plan"]
        assert {row["settings"]["ANT_MODE"] for row in given} == {3}


@pytest.mark.parametrize(
    ("args", "code", "said"),
    [
        (("provision", "{}/fleet.toml", "--antennas", "3"), USAGE, "both, 1, 2, tx1-rx2"),
        (("provision", "{}/fleet.toml", "--ground-antennas", ""), USAGE, "both, 1, 2, tx1-rx2"),
        (("provision", "{}/fleet.toml", "--antennas", "1", "--set", "ANT_MODE=2"), FAILED, "follows from the plan"),
        (("set", "{}/file", "ANT_MODE=left"), USAGE, "both, 1, 2, tx1-rx2"),
        (("show", "{}/none"), FAILED, "no such device"),
        (("show", "{}/file"), FAILED, "not a serial port"),
        (("show", "{}/file", "--baud", "fast"), USAGE, "--baud"),
        (("set", "{}/file", "NETID=a"), USAGE, "whole numbers"),
        (("set", "{}/file", "NETID"), USAGE, "name=value"),
        (("set", "{}/none", "NETID=7"), FAILED, "nothing was changed"),
        (("diff", "{}/file"), USAGE, "two or more"),
        (("diff", "{}/file", "{}/binary"), FAILED, "backup"),
        (("diff", "{}/none", "{}/file"), FAILED, "No such file"),
        (("backup", "{}/none", "{}/file"), FAILED, "--overwrite replaces"),
        (("restore", "{}/none", "{}/file"), FAILED, "version: must be 1"),
        (("provision", "{}/fleet.toml", "--nodes", "2"), FAILED, "give --nodes 3"),
        (("provision", "{}/fleet.toml", "p", "--node", "4"), FAILED, "more than the plan's 3 radios"),
        (("provision", "{}/fleet.toml", "{}/file", "{}/same"), FAILED, "is given twice"),
        (("emulate", "{}/file"), FAILED, "exists"),
        (("emulate", "{}/new", "--kind", "xbee"), USAGE, "--kind"),
        (("emulate", "{}/new", "--remotes", "a"), USAGE, "--remotes"),
    ],
)
def test_what_cannot_be_done_is_reported(args: tuple[str, ...], code: int, said: str, tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text(FLEET)
    (tmp_path / "file").write_text("x = 1\n")
    (tmp_path / "same").symlink_to(tmp_path / "file")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    assert said in run(*(arg.format(tmp_path) for arg in args), code=code)
    assert not (tmp_path / "new").exists()


def test_backups_are_compared_with_the_first_and_as_one_network(tmp_path: Path) -> None:
    def backup(name: str, unique_id: str, **values: int) -> Path:
        held = {"NETID": 0, "AIR_SPEED": 64, "RTSCTS": 1, **values}
        registers = {n: Register(f"S{i}", n, v) for i, (n, v) in enumerate(held.items())}
        state = RadioState("RFD SiK 3.00MP", Firmware.RFD_MULTIPOINT, registers, unique_id=unique_id)
        (tmp_path / name).write_text(to_toml(state))
        return tmp_path / name

    ground, alpha = backup("ground", "0x1", NODEID=1), backup("alpha", "0x2", NODEID=2)
    assert "the radios fit together as one network" in run("diff", ground, alpha)
    wrong = backup("bravo", "0x3", NODEID=2, AIR_SPEED=125)
    said = run("diff", ground, alpha, wrong, code=FAILED)
    assert "node id 2 is in 2 radios" in said
    assert "AIR_SPEED differs" in said
    before = backup("ground-before", "0x1", NODEID=1, NETID=5)
    answer = json.loads(run("diff", ground, before, "--json", code=FAILED))
    assert answer["problems"] == []
    assert answer["differences"][str(before)] == [{"name": "NETID", str(ground): 0, str(before): 5}]
