"""`radio …` without a radio: plans, refusals, wrong ports, and what is asked of the daemon."""

from __future__ import annotations

import json
import tomllib
from functools import partial
from pathlib import Path

import pytest

from skygcs.ext.radio_tools.settings import Firmware, RadioState, Register, to_toml
from skygcs.ext.radio_tools.timing_file import joined, pair_problems, spoils, to_text
from support.command_line import said
from support.table import each

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


run = partial(said, "radio")


def test_a_plan_is_made_of_the_fleet_file_and_is_the_same_every_time(tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text(FLEET)
    words = ("provision", tmp_path / "fleet.toml", "--nodes", "4", "--net-id", "5", "--set", "TXPOWER=20", "--json")
    answer = json.loads(run(*words))
    wanted = [(1, "ground"), (2, "zulu"), (3, "alpha"), (4, "spare")]
    assert [(row["node"], row["for"]) for row in answer["plan"]] == wanted
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


@each(
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


STATE = RadioState(
    "RFD SiK 3.00MP on RFD900x2",
    Firmware.RFD_MULTIPOINT,
    {n: Register(f"S{i}", n, v) for i, (n, v) in enumerate({"NETID": 0, "AIR_SPEED": 64, "NODEID": 1}.items())},
    unique_id="0x1",
)


def changed(unique_id: str = "0x2", firmware: Firmware = Firmware.RFD_MULTIPOINT, **values: int) -> RadioState:
    held = {**STATE.values, "NODEID": 2, **values}
    return RadioState(
        STATE.banner,
        firmware,
        {n: Register(f"S{i}", n, v) for i, (n, v) in enumerate(held.items())},
        None,
        None,
        unique_id,
    )


@each(
    ("other", "said"),
    [
        (changed(), None),
        (changed("0x1"), "are one radio (id 0x1)"),
        (
            changed(AIR_SPEED=125),
            "AIR_SPEED differs: a 64, b 125; make them alike: skygcs-cli radio set b AIR_SPEED=64",
        ),
        (changed(NETID=3), "NETID differs"),
        (changed(NODEID=1), "both have node id 1"),
        (changed(NODEDESTINATION=5), "b sends to node 5 only (NODEDESTINATION), and the other is node 1"),
        (changed(NODEDESTINATION=1), None),
        (changed(firmware=Firmware.SIK_MULTIPOINT), "firmware differs"),
    ],
)
def test_radios_that_cannot_be_measured_together_are_named(other: RadioState, said: str | None) -> None:
    problems = pair_problems(("a", "b"), (STATE, other))
    assert (problems == []) if said is None else any(said in text for text in problems)


@each(
    ("args", "code", "said"),
    [
        (("{}/none", "{}/other"), FAILED, "no such device"),
        (("{}/file", "{}/none"), FAILED, "not a serial port"),
        (("{}/file", "{}/same"), FAILED, "are one port"),
        (("{}/none", "{}/other", "-o", "{}/file"), FAILED, "is not a timing file"),
        (("{}/none", "{}/other", "-o", "{}/binary"), FAILED, "is not a timing file"),
        (("{}/none", "{}/other", "-o", "{}"), FAILED, "is not a timing file"),
        (("{}/none", "{}/other", "-o", "{}/nowhere/t.toml"), FAILED, "cannot be written"),
        (("{}/none", "{}/other", "--seconds", "1"), USAGE, "--seconds"),
        (("{}/none", "{}/other", "--nodes", "1"), USAGE, "--nodes"),
    ],
)
def test_a_measurement_that_cannot_begin_leaves_every_file_alone(
    args: tuple[str, ...], code: int, said: str, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("x = 1\n")
    (tmp_path / "same").symlink_to(tmp_path / "file")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    assert said in " ".join(run("measure", *(arg.format(tmp_path) for arg in args), code=code).split())
    assert (tmp_path / "file").read_text() == "x = 1\n" and (tmp_path / "binary").read_bytes() == b"\xff\xfe\x00"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["binary", "file", "same"]


def test_a_pair_does_not_spoil_the_file_of_a_network() -> None:
    network = {"air_speed_kbps": 64, "multipoint": True}
    assert spoils(None, {"air_speed_kbps": 0, "multipoint": False}) is None
    held = {"measurement": [network]}
    assert spoils(held, {"air_speed_kbps": 125, "multipoint": True}) is None
    assert "another kind of radios" in (spoils(held, {"air_speed_kbps": 64, "multipoint": False}) or "")
    assert "AIR_SPEED" in (spoils(held, {"air_speed_kbps": 0, "multipoint": True}) or "")


def test_a_file_of_measurements_is_read_back_as_it_was_written() -> None:
    """tomllib is the oracle. A file may have been edited by hand: what it holds beside ours stays."""
    row = {"air_speed_kbps": 64, "remarks": ['a "b" \\ é'], "settings": {"RATE/FREQBAND": 0}, "frames": [{"loss": 0.5}]}
    old = {"measurement": [{"air_speed_kbps": 64}, {"air_speed_kbps": 125, "note": "mine", "empty": []}]}
    document = tomllib.loads(to_text(joined(old, row), "radio timing", 1))
    assert document == {"kind": "radio timing", "version": 1, "measurement": [row, old["measurement"][1]]}
