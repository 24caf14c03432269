"""The preflight tables of a fleet file: what they mean, how they are laid over each other, what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from skygcs.config.loader import load_fleet
from skygcs.config.models import FleetConfig, VehicleConfig
from skygcs.config.vehicle_tables import PreflightSettings
from skygcs.core.params.expectations import Expectations, Rule
from skygcs.errors import ConfigError
from support.table import each


def load(tmp_path: Path, text: str) -> FleetConfig:
    path = tmp_path / "fleet.toml"
    path.write_text(text)
    return load_fleet(path)


def vehicle(tmp_path: Path, text: str) -> VehicleConfig:
    return load(tmp_path, text + '\n[vehicles.alpha]\nsysid = 1\ntype = "t"\n').vehicle_configs()[0]


def expected(settings: PreflightSettings, **how: Any) -> Expectations:
    return settings.expectations(**{"control": False, "setpoint_hz": 5.0, **how})


def test_nothing_said_is_the_defaults() -> None:
    assert expected(PreflightSettings()) == Expectations()


def test_a_value_or_a_table_of_comparisons(tmp_path: Path) -> None:
    text = """
[types.t.preflight]
battery_min_percent = 60
firmware = "4.6.2"
[types.t.preflight.params]
mav_sys_id = 11
NAV_RCL_ACT = { in = [0, 2], set = 2 }
RTL_RETURN_ALT = { min = 5, max = 30.5 }
GUID_OPTIONS = { bits = 8, no_bits = 0x10, why = "thrust", optional = true }
ANY = {}
"""
    wanted = expected(vehicle(tmp_path, text).preflight)
    assert wanted.battery_min_percent == 60 and wanted.firmware == ("4.6.2",)
    assert wanted.params == {
        "MAV_SYS_ID": Rule(one_of=(11,)),
        "NAV_RCL_ACT": Rule(one_of=(0, 2), set_to=2),
        "RTL_RETURN_ALT": Rule(least=5, most=30.5),
        "GUID_OPTIONS": Rule(bits=8, no_bits=16, why="thrust", optional=True),
        "ANY": Rule(),
    }


def test_levels_are_laid_over_each_other_key_by_key(tmp_path: Path) -> None:
    text = """
[defaults.preflight]
satellites_min = 9
battery_min_percent = 50
params = { A = 1, B = 2, C = 3 }
[types.t.preflight]
battery_min_percent = 70
params = { B = 5 }
[vehicles.alpha.preflight]
params = { C = {} }
[vehicles.alpha]
sysid = 1
type = "t"
"""
    config = load(tmp_path, text).vehicle_configs()[0]
    wanted = expected(config.preflight)
    assert (wanted.satellites_min, wanted.battery_min_percent) == (9, 70)
    assert wanted.params == {"A": Rule(one_of=(1,)), "B": Rule(one_of=(5,)), "C": Rule()}


def test_a_control_table_means_attitude_unless_said_otherwise(tmp_path: Path) -> None:
    assert not vehicle(tmp_path, "[types.t]").control_planned
    config = vehicle(tmp_path, "[types.t.control]")
    assert config.control_planned and expected(config.preflight, control=True).control == "attitude"
    settings = vehicle(tmp_path, '[types.t]\ncontrol = {}\npreflight = {control_mode = "none"}').preflight
    assert expected(settings, control=True).control is None


def test_a_pass_may_be_required_of_all_or_of_some(tmp_path: Path) -> None:
    assert vehicle(tmp_path, "[daemon]\nrequire_preflight = true\n[types.t]").require_preflight
    assert not vehicle(
        tmp_path, "[daemon]\nrequire_preflight = true\n[types.t]\nrequire_preflight = false"
    ).require_preflight
    config = load(tmp_path, "[vehicles.alpha]\nsysid = 1\n")
    assert config.vehicle_configs()[0].named and not config.default_vehicle(9).named


@each(
    ("line", "says"),
    [
        ("batery_min_percent = 3", "did you mean battery_min_percent?"),
        ("params = { A = { mni = 3 } }", "did you mean min?"),
        ('params = { A = "x" }', 'must be a whole number or a number or a table, not "x"'),
        ("params = { A = { min = 5, max = 3 } }", "min 5 is above max 3: no value satisfies both"),
        ("params = { A = { in = [1, 2], set = 5 } }", "set 5 is itself not as expected (1 or 2)"),
        ("params = { A = { bits = 3, no_bits = 1 } }", "bits and no_bits both have 1"),
        ("params = { A = { in = [1], min = 2 } }", "no value of in satisfies the rest of it"),
        ("params = { A = { in = [] } }", "a list of at least one"),
        ('params = { "NOT A NAME" = 3 }', "is not a parameter's name"),
        ("params = { A_NAME_OF_SEVENTEEN = 3 }", "is not a parameter's name"),
        ("params = { A = nan }", "finite"),
        ('firmware_min = "new"', "'new' is not a version such as 1.16.0"),
        ('gps_fix_min = "4d"', "must be one of no_gps"),
        ("rtl_height_m = [30, 3]", "the first is above the second"),
        ("battery_min_percent = 130", "at most 100"),
        ('control_mode = "atitude"', "attitude"),
    ],
)
def test_what_is_refused(tmp_path: Path, line: str, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, f"[defaults.preflight]\n{line}\n")
    (problem,) = caught.value.problems
    assert says in problem and "line 2" in problem
