"""`skygcs init` writes files that pass the check; `skygcs completion` knows every command; help shows no <bool>."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from typer.testing import CliRunner

from skygcs.cli import serve
from skygcs.cli.completion import SHELLS, script
from skygcs.cli.fleet_files import check, write_example
from skygcs.cli.main import app
from skygcs.config.examples import scenarios
from skygcs.config.loader import load_fleet
from skygcs.config.models import SimulatedLinkConfig
from skygcs.core.geo import distance_m
from skygcs.errors import ConfigError
from skygcs.ext.federation.hub_inventory import load_inventory
from support.public_data import ROOT
from support.table import each


def test_every_example_is_a_scenario_with_its_purpose(capsys: pytest.CaptureFixture[str]) -> None:
    files = {path.stem for path in (ROOT / "configs").glob("*.toml")}
    assert scenarios().keys() == files | {"federation"}
    assert write_example(None, Path(), force=False) == 0
    out = capsys.readouterr().out
    assert all(name in out and purpose in out for name, purpose in scenarios().items())
    assert [purpose for purpose in scenarios().values() if not purpose.endswith(".")] == [], "a sentence broken off"


def test_what_init_writes_of_several_stations_stands_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new"
    assert write_example("federation", folder, force=False) == 0
    assert "skygcs run north.toml" in capsys.readouterr().out
    inventory = load_inventory(folder / "hub.toml")
    for site in inventory.sites:
        text = (folder / f"{site}.toml").read_text()
        assert '"../' not in text and "configs/" not in text and f"skygcs run {site}.toml" in text
        federation = load_fleet(folder / f"{site}.toml").extensions["federation"]
        assert federation is not None and federation.site == site
        assert federation.nkey == inventory.users[site].nkey_file, "`federation up` makes the key that it names"
        assert federation.servers == (inventory.local_url,)
    with pytest.raises(ConfigError, match="--force"):
        write_example("federation", folder, force=False)


@each("scenario", sorted(scenarios().keys() - {"federation"}))
def test_what_init_writes_stands_alone(scenario: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "folder"
    assert write_example(scenario, folder, force=False) == 0
    text = (folder / "fleet.toml").read_text()
    assert '"../' not in text and "configs/" not in text and "skygcs run fleet.toml" in text
    assert text.count("#") > 3, "it is commented"
    assert check(folder / "fleet.toml") == 0
    assert str(folder / "logs") in capsys.readouterr().out or "log_dir" not in text


def test_the_sites_of_the_example_stand_apart() -> None:
    """On one map, and without a warning that their vehicles meet."""
    places: list[float] = []
    for name in ("north", "south"):
        link = load_fleet(ROOT / "configs" / "federation" / f"{name}.toml").links["sim"]
        assert isinstance(link, SimulatedLinkConfig)
        places += (link.lat_deg, link.lon_deg)
    assert 20.0 < distance_m(*places) < 100.0


def test_init_overwrites_nothing_and_names_what_there_is(tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text("mine")
    with pytest.raises(ConfigError, match="--force"):
        write_example("sim", tmp_path, force=False)
    assert (tmp_path / "fleet.toml").read_text() == "mine"
    with pytest.raises(ConfigError, match=r"no scenario '../sim'; there are: .*sim-udp"):
        write_example("../sim", tmp_path, force=False)
    write_example("sim", tmp_path, force=True)
    assert "simulated" in (tmp_path / "fleet.toml").read_text()


def completed(*words: str) -> list[str]:
    """As bash completes the last word."""
    bash = shutil.which("bash")
    assert bash is not None
    typed = " ".join(repr(word) for word in words)
    line = f'COMP_WORDS=({typed}); COMP_CWORD={len(words) - 1}; _skygcs; echo "${{COMPREPLY[@]}}"'
    text = script(serve.new_parser(), "bash") + line
    return subprocess.run([bash], input=text, capture_output=True, text=True, check=True, cwd="/").stdout.split()


def test_bash_completes_commands_options_and_choices() -> None:
    assert completed("skygcs", "ini") == ["init"]
    assert {"run", "check", "sim", "demo", "metrics"} <= set(completed("skygcs", ""))
    assert completed("skygcs", "run", "--log") == ["--log-dir"]
    assert completed("skygcs", "metrics", "d") == ["dashboard"]


@each("shell", SHELLS)
def test_every_command_is_in_every_script(shell: str) -> None:
    text = script(serve.new_parser(), shell)
    assert all(f"{name}" in text for name in ("init", "run", "sitl", "completion"))


@each("words", [[], ["arm"], ["tlog", "csv"], ["link", "plan"], ["log", "get"]])
def test_help_shows_no_type_for_what_is_given_or_not(words: list[str]) -> None:
    for option in ("-h", "--help"):
        result = CliRunner().invoke(app, [*words, option])
        assert result.exit_code == 0 and "bool" not in result.output.lower(), result.output
