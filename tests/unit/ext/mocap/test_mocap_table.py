"""[mocap] of the fleet file: what it takes, and what is wrong with it, with its key."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.config.loader import load_fleet
from skygcs.config.models import FleetConfig
from skygcs.errors import ConfigError
from skygcs.ext.mocap.capture_process import arguments
from skygcs.ext.mocap.config import MocapConfig
from support.table import each

REST = """
[origin]
lat_deg = 43.78
lon_deg = -79.46
alt_amsl_m = 180
[vehicles.alpha]
sysid = 1
[vehicles.bravo]
sysid = 2
"""

VICON = 'type = "vicon"\nhost = "10.0.0.5"\nbodies = { alpha = "quad1" }\n'


def load(tmp_path: Path, mocap: str, rest: str = REST) -> FleetConfig:
    path = tmp_path / "fleet.toml"
    path.write_text(f"[mocap]\n{mocap}{rest}")
    return load_fleet(path)


def test_a_system_and_its_bodies(tmp_path: Path) -> None:
    config = load(tmp_path, VICON)
    mocap = config.extensions["mocap"]
    assert isinstance(mocap, MocapConfig) and mocap.bodies == {"alpha": "quad1"}
    assert arguments(mocap) == ["--system", "vicon", "--host", "10.0.0.5", "--body=quad1"]


def test_a_recording_is_found_beside_the_fleet_file(tmp_path: Path) -> None:
    config = load(tmp_path, 'type = "recorded"\nfile = "flight.jsonl"\nloop = true\nbodies = { alpha = "-a" }\n')
    mocap = config.extensions["mocap"]
    assert isinstance(mocap, MocapConfig)
    assert arguments(mocap) == ["--file", str(tmp_path / "flight.jsonl"), "--loop", "--body=-a"]


@each(
    ("mocap", "rest", "words"),
    [
        ('type = "vicom"\nbodies = { alpha = "a" }\n', REST, ("mocap.type", "did you mean vicon")),
        ('type = "vicon"\nbodies = { alpha = "a" }\n', REST, ("mocap", "host", "is missing")),
        ('type = "vrpn"\nhost = "h"\nport = 3883\nbodies = { alpha = "a" }\n', REST, ("port", "has no meaning")),
        ('type = "recorded"\nbodies = { alpha = "a" }\n', REST, ("file", "recorded")),
        ('type = "simulated"\nbodies = { alpha = "a" }\n', REST, ("mocap.type", "no link of type")),
        (
            VICON.replace("alpha", "alfa"),
            REST,
            ("mocap.bodies.alfa", "not a vehicle of this file; vehicles: alpha, bravo"),
        ),
        (
            'type = "vicon"\nhost = "h"\nbodies = { alpha = "a", bravo = "a" }\n',
            REST,
            ("mocap.bodies.bravo", "that of alpha already"),
        ),
        (VICON, "[vehicles.alpha]\nsysid = 1\n", ("mocap", "needs a table [origin]")),
        (VICON, REST + "[daemon]\nkeep_vehicles = false\n", ("mocap", "keep_vehicles = true")),
        (VICON + "rate_hz = 5\n", REST, ("mocap.rate_hz", "at least 10")),
        (VICON + "max_jump = 1\n", REST, ("mocap.max_jump", "unknown key; did you mean max_jump_m")),
        ('type = "vicon"\nhost = "h"\nbodies = {}\n', REST, ("mocap.bodies",)),
        (VICON + "[mocap.simulated]\nnoise_m = 0.1\n", REST, ("simulated", 'is for type "simulated"')),
    ],
)
def test_what_is_wrong_is_named_with_its_key(tmp_path: Path, mocap: str, rest: str, words: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, mocap, rest)
    text = "\n".join(caught.value.problems)
    assert all(word in text for word in words), text
