"""`skygcs-cli companions`, `up` and `down` on the command line, with companions that exist in the test alone."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from skygcs.cli.main import app
from skygcs.errors import CompanionError
from skygcs.ext.companions import bring_up_commands as bring_up_commands
from skygcs.ext.companions import commands as companion_commands
from skygcs.ext.companions.bring_up.inventory import Companion
from support.fake_companion import ARMED, FakeSession
from support.table import each

FLEET = """
[defaults]
group = "field"
[vehicles.alpha]
sysid = 1
[vehicles.bravo]
sysid = 2
[vehicles.carol]
sysid = 3
[companions.alpha]
host = "10.0.0.1"
[companions.pi]
host = "10.0.0.2"
vehicle = "bravo"
"""


class Field:
    def __init__(self, folder: Path) -> None:
        self.fleet = folder / "fleet.toml"
        self.fleet.write_text(FLEET)
        self.sessions = {name: FakeSession(state="active") for name in ("alpha", "pi")}
        self.out_of_reach: set[str] = set()

    @contextlib.asynccontextmanager
    async def connected(self, companion: Companion, *_: Any) -> AsyncIterator[FakeSession]:
        if companion.name in self.out_of_reach:
            raise CompanionError("reach", f"{companion.host} port 22: connection refused", "is it on?")
        yield self.sessions[companion.name]

    def run(self, *words: str) -> Result:
        return CliRunner().invoke(app, list(words))

    def outcomes(self, *words: str) -> Any:
        return json.loads(self.run("--json", *words).stdout)["outcomes"]


@pytest.fixture
def field(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Field:
    field = Field(tmp_path)
    for module in (companion_commands, bring_up_commands):
        monkeypatch.setattr(module, "connected", field.connected)
    monkeypatch.setenv("SKYGCS_FLEET", str(field.fleet))
    monkeypatch.setenv("SKYGCS_SOCKET", str(tmp_path / "no-daemon"))
    monkeypatch.setenv("HOME", str(tmp_path))
    return field


def test_companions_are_named_by_themselves_by_their_vehicles_and_by_groups(field: Field) -> None:
    for targets, names in (("all", ["alpha", "pi"]), ("bravo", ["pi"]), ("2", ["pi"]), ("pi,1", ["alpha", "pi"])):
        assert list(field.outcomes("companions", "status", targets)) == names
    assert list(field.outcomes("companions", "status", "field")) == ["alpha", "pi"]
    unknown = field.run("companions", "status", "carol")
    assert unknown.exit_code == 1 and "no vehicle 'carol'" in unknown.stderr


def test_a_fleet_without_companions_is_named(field: Field) -> None:
    field.fleet.write_text("[vehicles.alpha]\nsysid = 1\n")
    done = field.run("companions", "status")
    assert done.exit_code == 1 and "[companions.NAME]" in done.stderr


def test_one_that_is_out_of_reach_fails_and_the_other_one_is_shown(field: Field) -> None:
    field.out_of_reach.add("pi")
    done = field.run("companions", "status")
    assert done.exit_code == 1
    assert "ok   alpha  skygcs 0.1.0, active, aarch64, Python 3.11, 9.2 GB free" in done.stdout
    assert "FAIL pi     reach: 10.0.0.2 port 22: connection refused; is it on?" in done.stdout


def test_what_stands_after_the_dashes_is_the_command(field: Field) -> None:
    field.sessions["alpha"].answer("df -h", 0, "one\ntwo\n")
    done = field.run("companions", "run", "alpha", "--", "df", "-h", "--json")
    assert (done.exit_code, done.stdout) == (0, "alpha  one\nalpha  two\n")
    assert field.sessions["alpha"].commands == ["df -h --json"]
    done = field.run("companions", "run", "--", "ls | wc -l")
    assert field.sessions["pi"].commands == ["ls | wc -l"] and done.exit_code == 0


def test_a_command_that_fails_somewhere_fails(field: Field) -> None:
    field.sessions["pi"].answer("false", 7)
    done = field.run("companions", "run", "--", "false")
    assert done.exit_code == 1 and "FAIL pi  run: exit code 7" in done.stderr
    assert field.outcomes("companions", "run", "--", "false")["pi"]["exit_code"] == 7


@each(
    "words",
    [
        ("run",),
        ("run", "all"),
        ("run", "--"),
        ("stop",),
        ("bundle", "-o", "x", "--arch", "z80"),
        ("bundle", "-o", "x", "--arch", "aarch64", "--python", "2.7"),
        ("install", "all"),
        ("status", "--at-once", "0"),
    ],
)
def test_what_is_missing_on_the_command_line_is_a_usage_error(field: Field, words: tuple[str, ...]) -> None:
    assert field.run("companions", *words).exit_code == 2


def test_a_bundle_for_companions_without_a_known_architecture_needs_one(field: Field, tmp_path: Path) -> None:
    done = field.run("companions", "bundle", "-o", str(tmp_path / "x"))
    assert done.exit_code == 1 and "--arch is needed" in done.stderr


def test_up_without_a_daemon_on_the_ground_says_so_and_exits_with_3(field: Field) -> None:
    done = field.run("up", "alpha", "--wait", "0")
    assert done.exit_code == 3
    assert "alpha  service    was running" in done.stdout
    assert "0 of 1 ready" in done.stdout and "start one with: skygcs run" in done.stdout


def test_up_takes_vehicles_without_companion_too(field: Field) -> None:
    report = json.loads(field.run("up", "carol,pi", "--wait", "0", "--json").stdout)
    assert list(report["vehicles"]) == ["pi", "carol"]
    assert list(report["vehicles"]["carol"]["stages"]) == ["heard"]


WITHOUT_EXTRA = ("asyncssh", "cryptography", "zeroconf")
"""What the extra `companions` installs."""


@pytest.fixture
def plain(field: Field, monkeypatch: pytest.MonkeyPatch) -> Field:
    """The same field, where the extra is not installed: its modules are neither found nor imported."""
    for name in [name for name in sys.modules if name.partition(".")[0] in WITHOUT_EXTRA] + list(WITHOUT_EXTRA):
        monkeypatch.setitem(sys.modules, name, None)
    return field


@each("table", ["", "[companions]\nadvertise = false\n"])
def test_up_of_a_fleet_without_companions_needs_no_ssh(plain: Field, table: str) -> None:
    plain.fleet.write_text(f"{table}[vehicles.alpha]\nsysid = 1\n[vehicles.bravo]\nsysid = 2\n")
    done = plain.run("up", "--wait", "0", "--json")
    report = json.loads(done.stdout)
    assert done.exit_code == 3, done.stderr  # no daemon, which is all that is missing
    wanted = {"alpha": ["heard"], "bravo": ["heard"]}
    assert {name: list(outcome["stages"]) for name, outcome in report["vehicles"].items()} == wanted


def test_up_of_vehicles_without_a_computer_needs_no_ssh_in_a_fleet_that_has_some(plain: Field) -> None:
    assert list(json.loads(plain.run("up", "carol", "--wait", "0", "--json").stdout)["vehicles"]) == ["carol"]


def test_up_of_a_vehicle_with_a_computer_says_what_to_install(plain: Field) -> None:
    done = plain.run("up", "--wait", "0")
    assert (done.exit_code, done.stdout) == (1, "")
    assert done.stderr == "skygcs-cli: companions need the package asyncssh: pip install 'skygcs[companions]'\n"


@each("command", [("down",), ("companions", "status")])
def test_without_companions_the_table_is_missing_and_no_package(plain: Field, command: tuple[str, ...]) -> None:
    plain.fleet.write_text("[vehicles.alpha]\nsysid = 1\n")
    done = plain.run(*command)
    assert done.exit_code == 1 and "has no table [companions.NAME]" in done.stderr


def test_up_of_a_fleet_file_without_vehicles_says_so(field: Field) -> None:
    field.fleet.write_text("[daemon]\nsysid = 255\n")
    done = field.run("up", "--wait", "0")
    assert done.exit_code == 1 and "has no table [vehicles.NAME]" in done.stderr


def test_down_stops_nothing_while_one_vehicle_is_armed(field: Field) -> None:
    field.sessions["pi"].answer("status", 0, ARMED.replace("alpha", "bravo"))
    done = field.run("down")
    assert done.exit_code == 1 and "bravo: armed or in the air; nothing was stopped" in done.stderr
    assert not field.sessions["alpha"].ran("stop")
    assert field.run("down", "alpha").exit_code == 0 and field.sessions["alpha"].ran("systemctl --user stop")
    assert field.run("down", "--force").exit_code == 0 and field.sessions["pi"].ran("systemctl --user stop")
