"""The fleet files people start from."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from skygcs.cli.fleet_files import check
from skygcs.cli.main import app
from skygcs.config.loader import load_fleet
from support.public_data import ROOT
from support.table import each

CONFIGS = sorted((ROOT / "configs").glob("*.toml"))


def test_there_is_one_for_each_scenario() -> None:
    names = {path.stem for path in CONFIGS}
    assert names >= {"sim", "field-radio", "wifi-companions", "bench-usb", "mixed-px4-ardupilot", "replay"}


@pytest.mark.parametrize("path", CONFIGS, ids=lambda p: p.stem)
def test_it_passes_the_check(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert check(path) == 0
    out, err = capsys.readouterr()
    assert "no problem found" in out and err == ""
    assert "there is no file" not in out  # what it refers to is in the project


@each("path", CONFIGS)
def test_it_says_what_it_is_for_and_how_to_run_it(path: Path) -> None:
    first, *_ = path.read_text().splitlines()
    assert first.startswith("# ")
    assert f"skygcs run configs/{path.name}" in path.read_text()


@each("autopilot", ["px4", "ardupilot"])
def test_the_survey_is_a_mission_for_each_autopilot(autopilot: str) -> None:
    line = ["mission", "check", str(ROOT / "configs" / "survey.plan"), "--autopilot", autopilot]
    checked = CliRunner().invoke(app, line)
    assert checked.exit_code == 0 and "no problem found" in checked.output, checked.output


def test_together_they_show_every_kind_of_link_a_user_has() -> None:
    kinds = {link.type for path in CONFIGS for link in load_fleet(path).links.values()}
    assert kinds >= {"serial", "udp_server", "udp_client", "udp_broadcast", "tcp_server", "replay", "simulated"}


def test_what_is_commented_out_is_right_too(tmp_path: Path) -> None:
    text = (ROOT / "configs" / "wifi-companions.toml").read_text()
    text = text.replace("# tcp_port", "tcp_port").replace("# token_file", "token_file")
    tomllib.loads(text)
    (tmp_path / "f.toml").write_text(text)
    assert load_fleet(tmp_path / "f.toml").daemon.tcp_port == 5790
    text = (ROOT / "configs" / "field-radio.toml").read_text().replace("# block_msg", "block_msg")
    (tmp_path / "g.toml").write_text(text)
    assert load_fleet(tmp_path / "g.toml").links["radio"].block_msg_id_out == ("PARAM_REQUEST_LIST",)
