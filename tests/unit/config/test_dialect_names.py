"""A shipped dialect goes by its name and by `dialects/NAME.xml`, in every place that takes a dialect, in any folder."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from pymavlink.generator import mavparse
from typer.testing import CliRunner

from skygcs.cli.main import app
from skygcs.config.dialects import PX4_EXTRAS, load_dialect, shipped_dialects_dir
from skygcs.config.loader import load_fleet, load_fleet_and_dialect
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import encode
from skygcs.errors import ConfigError
from skygcs.tlog.format import encode_record
from support.frames import heartbeat
from support.public_data import ROOT
from support.table import each

SPELLINGS = ("utias", "utias.xml", "dialects/utias.xml", "./dialects/utias.xml")
WRONG = {
    "utis": "no dialect of this name; did you mean utias?",
    "dialects/utis.xml": "no such dialect file; did you mean dialects/utias.xml, which is shipped?",
    "dialects/common.xml": "no such dialect file; pymavlink's is called common",
    "nothing/utias.xml": "no such dialect file; the shipped one is called utias",
    "dialects": "no dialect of this name",
    "dialects/": "is a folder",
}
"""What is not there, and the text that says so."""


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that is empty at first: each table is made once, by whichever spelling asks first."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def empty(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of a user's own, where commands are given: without a checkout."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    folder = tmp_path / "lab"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def in_fleet_file(folder: Path, spelling: str) -> Dialect:
    (folder / "fleet.toml").write_text(f'dialect = ["{PX4_EXTRAS}", "{spelling}"]\n')
    load_fleet(folder / "fleet.toml")
    return load_fleet_and_dialect(folder / "fleet.toml")[1]


def crc_by_pymavlink(name: str, file: Path) -> int:
    """The oracle: CRC_EXTRA as mavgen computes it of the file."""
    xml = mavparse.MAVXML(str(file), mavparse.PROTOCOL_2_0)
    return int(next(message for message in xml.message if message.name == name).crc_extra)


@each("spelling", SPELLINGS)
def test_the_fleet_file_takes_each_spelling(empty: Path, spelling: str) -> None:
    found = in_fleet_file(empty, spelling).find("utias")
    assert (found.msgid, found.crc_extra) == (228, crc_by_pymavlink("utias", shipped_dialects_dir() / "utias.xml"))


COMMANDS: dict[str, Callable[[str], list[str]]] = {
    "tlog info": lambda name: ["tlog", "info", "lab.tlog", "--dialect", name],
    "tlog csv": lambda name: ["tlog", "csv", "lab.tlog", "--message", "utias", "-o", "out", "--dialect", name],
    "tlog filter": lambda name: ["tlog", "filter", "lab.tlog", "cut.tlog", "--message", "utias", "--dialect", name],
    "tlog merge": lambda name: ["tlog", "merge", "lab.tlog", "lab.tlog", "-o", "all.tlog", "--dialect", name],
    "tlog split": lambda name: ["tlog", "split", "lab.tlog", "-o", "split", "--dialect", name],
    "gate": lambda name: ["gate", "--dialect", name],
    "mission check": lambda name: ["mission", "check", "survey.plan", "--dialect", name],
}
"""Commands that need no daemon and take a dialect."""


def lab_files(folder: Path) -> None:
    """A recording with the lab's message, and a plan."""
    shutil.copy(ROOT / "configs" / "survey.plan", folder)
    values = {"quat": [1, 0, 0, 0], "pos": [1, 2, 3], "vel": [0, 0, 0], "gps": [43.78, -79.46, 180]}
    frames = [heartbeat(1), encode(load_dialect("utias").find("utias"), values, sysid=1, compid=1, seq=1), heartbeat(1)]
    records = [encode_record(1_700_000_000_000_000 + number, sent) for number, sent in enumerate(frames)]
    (folder / "lab.tlog").write_bytes(b"".join(records))


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("spelling", ["utias", "dialects/utias.xml"])
def test_the_commands_take_each_spelling(empty: Path, command: str, spelling: str) -> None:
    lab_files(empty)
    done = CliRunner().invoke(app, COMMANDS[command](spelling))
    assert done.exit_code == 0, done.output


@each("spelling", SPELLINGS)
def test_a_recording_of_it_has_nothing_unknown(empty: Path, spelling: str) -> None:
    lab_files(empty)
    done = CliRunner().invoke(app, ["tlog", "info", "lab.tlog", "--json", "--dialect", spelling])
    answer = json.loads(done.output)
    assert (answer["unknown"], answer["types"]["utias"]) == (0, 1)


def test_a_file_beside_the_fleet_file_goes_before_the_shipped_one(empty: Path) -> None:
    text = (shipped_dialects_dir() / "utias.xml").read_text().replace('id="228"', 'id="229"')
    (empty / "dialects").mkdir()
    (empty / "dialects" / "utias.xml").write_text(text)
    assert in_fleet_file(empty, "dialects/utias.xml").find("utias").msgid == 229
    assert in_fleet_file(empty, "utias").find("utias").msgid == 228


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_not_there_says_what_is(empty: Path, wrong: str) -> None:
    (empty / "dialects").mkdir()
    (empty / "fleet.toml").write_text(f'dialect = "{wrong}"\n')
    with pytest.raises(ConfigError) as problem:
        load_fleet(empty / "fleet.toml")
    assert WRONG[wrong] in str(problem.value)
    done = CliRunner().invoke(app, ["gate", "--dialect", wrong])
    assert done.exit_code == 1 and WRONG[wrong] in done.stderr
    assert "Traceback" not in done.output
