"""Where the user's autopilot binaries are looked for."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from skygcs.config.firmware import PROGRAMS, find_ardupilot, find_px4
from skygcs.errors import ConfigError
from support.fake_firmware import make_copter, make_px4
from support.table import each


def test_a_built_ardupilot_tree(tmp_path: Path) -> None:
    binary = make_copter(tmp_path)
    found = find_ardupilot("ardupilot", {"SKYGCS_ARDUCOPTER": str(binary)})
    assert found.binary == binary
    assert found.defaults == tmp_path / "Tools/autotest/default_params/copter.parm"


def test_a_binary_with_its_defaults_beside_it_or_named(tmp_path: Path) -> None:
    binary = make_copter(tmp_path / "tree")
    lone = tmp_path / "arducopter"
    lone.write_bytes(binary.read_bytes())
    lone.chmod(0o755)
    with pytest.raises(ConfigError, match="SKYGCS_ARDUCOPTER_DEFAULTS"):
        find_ardupilot("ardupilot", {"SKYGCS_ARDUCOPTER": str(lone)})
    named = tmp_path / "mine.parm"
    named.write_text("FRAME_CLASS 1\n")
    environment = {"SKYGCS_ARDUCOPTER": str(lone), "SKYGCS_ARDUCOPTER_DEFAULTS": str(named)}
    assert find_ardupilot("ardupilot", environment).defaults == named
    (tmp_path / "copter.parm").write_text("FRAME_CLASS 1\n")
    assert find_ardupilot("ardupilot", {"SKYGCS_ARDUCOPTER": str(tmp_path)}).defaults == tmp_path / "copter.parm"


def test_px4_by_its_folder_its_binary_or_a_link_to_it(tmp_path: Path) -> None:
    folder = make_px4(tmp_path / "opt/px4")
    link = tmp_path / "px4"
    link.symlink_to(folder / "bin/px4")
    for named in (folder, folder / "bin/px4", link):
        found = find_px4({"SKYGCS_PX4": str(named)})
        assert (found.binary, found.etc) == (folder / "bin/px4", folder / "etc")


def test_px4_without_its_startup_files(tmp_path: Path) -> None:
    folder = make_px4(tmp_path)
    (folder / "etc/init.d-posix/rcS").unlink()
    with pytest.raises(ConfigError, match="startup files"):
        find_px4({"SKYGCS_PX4": str(folder)})


@each("find", [find_px4, partial(find_ardupilot, "ardupilot")])
def test_what_is_not_set_or_not_there_says_what_to_do(find: object, tmp_path: Path) -> None:
    assert callable(find)
    with pytest.raises(ConfigError, match="is not set: build it"):
        find({})
    environment = {"SKYGCS_PX4": str(tmp_path / "no"), "SKYGCS_ARDUCOPTER": str(tmp_path / "no")}
    with pytest.raises(ConfigError, match="is not there: build it"):
        find(environment)
    flat = tmp_path / "flat"
    flat.write_text("text")
    with pytest.raises(ConfigError, match="not executable"):
        find({"SKYGCS_PX4": str(flat), "SKYGCS_ARDUCOPTER": str(flat)})


def test_each_of_ardupilots_programs_has_a_variable_and_default_parameters_of_its_own(tmp_path: Path) -> None:
    bin_folder = tmp_path / "build/sitl/bin"
    bin_folder.mkdir(parents=True)
    for kind, program in PROGRAMS.items():
        binary, defaults = bin_folder / program.binary, tmp_path / "Tools/autotest" / program.defaults
        binary.write_text("#!/bin/sh\n")
        binary.chmod(0o755)
        defaults.parent.mkdir(parents=True, exist_ok=True)
        with pytest.raises(ConfigError, match=program.defaults_variable):
            find_ardupilot(kind, {program.variable: str(binary)})
        defaults.write_text("")
        assert find_ardupilot(kind, {program.variable: str(binary)}).defaults == defaults
    with pytest.raises(ConfigError, match=r"(?s)SKYGCS_ROVER.*is not set: build it .*waf rover.*ardurover"):
        find_ardupilot("rover", {})
