"""The control table: laid over each other key by key, and nothing impossible gets by."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.cli.fleet_files import check
from skygcs.config.control import (
    ATTITUDE_HZ,
    ATTITUDE_MIN_HZ,
    POSITION_HZ,
    VELOCITY_HZ,
    ControlFenceSettings,
    ControlSettings,
    GainSettings,
)
from skygcs.config.loader import load_fleet
from skygcs.config.models import FleetConfig
from skygcs.core.control.control_fence import Fence
from skygcs.core.control.gains import UTIAS_XY, UTIAS_Z, ControlConfig
from skygcs.core.control.guard import GuardConfig
from skygcs.core.geo import Origin
from skygcs.core.trajectory import MotionLimits
from skygcs.core.vehicle.offboard_controller import OffboardConfig
from skygcs.errors import ConfigError
from support.table import each

HERE = Origin(47.4, 8.5, 488.0)
VEHICLE = "[vehicles.a]\nsysid = 1\n"


def loaded(tmp_path: Path, text: str) -> FleetConfig:
    path = tmp_path / "fleet.toml"
    path.write_text(text)
    return load_fleet(path)


def test_what_nobody_says_has_the_defaults_of_the_law_the_guard_and_the_fence() -> None:
    settings = ControlSettings()
    assert settings.law() == ControlConfig(acc_xy_max_mps2=2.0, acc_z_max_mps2=1.0)
    assert settings.guard() == GuardConfig()
    assert settings.fence_at(HERE) == Fence(HERE) and settings.problems() == []
    pilot = OffboardConfig(settings.law(), settings.guard())
    assert (pilot.attitude_hz, pilot.rate_min_hz) == (ATTITUDE_HZ, ATTITUDE_MIN_HZ)
    assert (pilot.velocity_hz, pilot.position_hz) == (VELOCITY_HZ, POSITION_HZ)


def test_every_key_reaches_what_it_is_for() -> None:
    settings = ControlSettings(
        rate_hz=40,
        xy=GainSettings(pos_p_per_s=0.5, vel_p=0.06, vel_i=0.01, vel_d=0.001),
        z=GainSettings(vel_p=0.2),
        hover_thrust=0.4,
        thrust_min=0.2,
        thrust_max=0.8,
        tilt_max_deg=20,
        vel_xy_max_mps=4,
        vel_z_max_mps=2,
        acc_xy_max_mps2=1.5,
        acc_z_max_mps2=0.7,
        attitude_delay_s=0.05,
        velocity_delay_s=0.3,
        stale_s=0.4,
        position_stale_s=1.5,
        battery_min_percent=30,
        return_after_s=5,
        fence=ControlFenceSettings(x_m=(-10, 20), y_m=(-5, 5), up_m=(2, 9), margin_m=1),
    )
    law = settings.law(0.7)  # the file's word counts more than the vehicle's
    assert (law.period_s, law.hover_thrust, law.thrust_min, law.thrust_max) == (1 / 40, 0.4, 0.2, 0.8)
    assert law.xy.pos_p_per_s == 0.5 and law.xy.vel_d == 0.001
    assert law.z.vel_p == 0.2 and law.z.vel_i == UTIAS_Z.vel_i
    assert law.tilt_max_rad == pytest.approx(0.349066, abs=1e-6)
    assert (law.vel_xy_max_mps, law.vel_z_max_mps) == (4, 2)
    assert (law.acc_xy_max_mps2, law.acc_z_max_mps2) == (1.5, 0.7)
    assert settings.guard() == GuardConfig(0.05, 0.3, 0.4, 1.5, 30, 5)
    assert settings.fence_at(HERE) == Fence(HERE, (-10, 20), (-5, 5), (2, 9), 1)
    assert ControlSettings().law(0.38).hover_thrust == 0.38


LAYERS = """
[defaults.control]
rate_hz = 40
hover_thrust = 0.4
xy = { pos_p_per_s = 0.5, vel_p = 0.06 }
fence = { x_m = [-10, 10], up_m = [0, 30] }
[types.heavy.control]
hover_thrust = 0.6
xy = { vel_p = 0.1 }
[types.plain]
[vehicles.a]
sysid = 1
type = "heavy"
[vehicles.a.control]
xy = { vel_i = 0.03 }
fence = { margin_m = 1 }
[vehicles.b]
sysid = 2
type = "plain"
"""


def test_levels_are_laid_over_each_other_key_by_key_also_within_gains_and_fence(tmp_path: Path) -> None:
    config = loaded(tmp_path, LAYERS)
    a, b = (vehicle.control for vehicle in config.vehicle_configs())
    assert (a.rate_hz, a.hover_thrust) == (40, 0.6)
    assert a.xy == GainSettings(pos_p_per_s=0.5, vel_p=0.1, vel_i=0.03)
    assert a.fence == ControlFenceSettings(x_m=(-10, 10), up_m=(0, 30), margin_m=1)
    law = a.law()
    assert (law.xy.vel_p, law.xy.vel_d) == (0.1, UTIAS_XY.vel_d)
    assert (b.hover_thrust, b.xy) == (0.4, GainSettings(pos_p_per_s=0.5, vel_p=0.06))
    assert config.default_vehicle(9).control == config.defaults.control


gains = st.builds(
    GainSettings,
    pos_p_per_s=st.none() | st.floats(0, 100),
    vel_p=st.none() | st.floats(0.001, 100),
    vel_i=st.none() | st.floats(0, 100),
)
tables = st.builds(
    ControlSettings,
    rate_hz=st.none() | st.floats(5, 200),
    hover_thrust=st.none() | st.floats(0.01, 0.99),
    xy=st.none() | gains,
    stale_s=st.none() | st.floats(0.1, 60),
)


@given(tables, tables, tables)
def test_laying_over_is_what_a_dictionary_would_do_and_associative(
    low: ControlSettings, middle: ControlSettings, high: ControlSettings
) -> None:
    assert high.over(middle.over(low)) == high.over(middle).over(low)
    assert high.over(ControlSettings()) == high == ControlSettings().over(high)
    merged = high.over(low)
    for key in ("rate_hz", "hover_thrust", "stale_s"):
        own = getattr(high, key)
        assert getattr(merged, key) == (getattr(low, key) if own is None else own)


IMPOSSIBLE = [
    # one key by itself
    ("rate_hz = 500", r"rate_hz \(line 4\): must be at most 200, not 500"),
    ("rate_hz = 4", r"rate_hz \(line 4\): must be at least 5, not 4"),
    ("velocity_hz = 2", r"velocity_hz \(line 4\): must be at least 3, not 2"),
    ("position_hz = 0", r"position_hz \(line 4\): must be at least 3, not 0"),
    ("hover_thrust = 1", r"hover_thrust \(line 4\): must be less than 1, not 1"),
    ("tilt_max_deg = 85", r"tilt_max_deg \(line 4\): must be at most 80, not 85"),
    ("vel_xy_max_mps = 0", r"vel_xy_max_mps \(line 4\): must be more than 0, not 0"),
    ("battery_min_percent = 120", r"battery_min_percent \(line 4\): must be at most 100, not 120"),
    ("hover_thrust = nan", r"hover_thrust \(line 4\): must be .*"),
    ("stale_s = '1'", r'stale_s \(line 4\): must be a number, not "1"'),
    ("xy = { vel_p = 0 }", r"xy\.vel_p \(line 4\): must be at least 0.001, not 0"),
    ("z = { vel_i = -1 }", r"z\.vel_i \(line 4\): must be at least 0, not -1"),
    ("fence = { x_m = [1] }", r"fence\.x_m(\[1\])? \(line 4\): .*"),
    ("fence = { margin_m = -1 }", r"fence\.margin_m \(line 4\): must be at least 0, not -1"),
    # names
    ("rate = 50", r"rate \(line 4\): unknown key; did you mean rate_hz\?"),
    ("xy = { p = 1 }", r"xy\.p \(line 4\): unknown key.*pos_p_per_s.*"),
    ("fence = { z_m = [0, 1] }", r"fence\.z_m \(line 4\): unknown key.*"),
    ("xy = 5", r"xy \(line 4\): must be a table, not 5"),
    # several together
    ("thrust_min = 0.5", r"thrust_min \(line 4\): .*0\.5, 0\.45, 0\.9 do not rise within 0\.\.1"),
    ("thrust_max = 0.4", r"thrust_max \(line 4\): .*do not rise.*"),
    ("hover_thrust = 0.95", r"hover_thrust \(line 4\): .*do not rise.*"),
    ("attitude_delay_s = 0.8", r"attitude_delay_s \(line 4\): 0\.8 is above velocity_delay_s \(0\.5\).*"),
    ("velocity_delay_s = 0.05", r"velocity_delay_s \(line 4\): 0\.1 is above velocity_delay_s \(0\.05\).*"),
    # gains against delay
    (
        "attitude_delay_s = 0.4",
        r"attitude_delay_s \(line 4\): xy: these gains are unstable from 0\.507 s.* z: .* 0\.213",
    ),
    ("z = { vel_p = 1.5 }", r"z \(line 4\): z: these gains are unstable from 0\.04\d s of delay.* allow at most 0\.01"),
    (
        "z = { vel_p = 1.5 }\nattitude_delay_s = 0.4",
        r"attitude_delay_s \(line 5\): xy: .*; z: these gains are unstable from 0\.04\d s of delay on",
    ),
    ("attitude_delay_s = 0.11", r"attitude_delay_s \(line 4\): z: .* allow at most 0\.101 s of delay, or divide"),
    ("xy = { pos_p_per_s = 0 }", r"xy \(line 4\): xy: these gains are unstable without any delay"),
    ("hover_thrust = 0.15", r"hover_thrust \(line 4\): z: these gains are unstable from 0\.07\d s"),
    (
        "velocity_predictor = true\nxy = { pos_p_per_s = 5, vel_p = 0.05 }",
        r"xy \(line 5\): .*prediction over 0\.100 s the delay may be wrong by 0\.029 s",
    ),
    ("stale_s = 3", r"stale_s \(line 4\): 3\.0 is above position_stale_s \(2\.0\).*"),
    ("return_after_s = 0.5", r"return_after_s \(line 4\): 0\.5 is not in 1\.\.3600"),
    ("vel_z_max_mps = 0.001", r"vel_z_max_mps \(line 4\): .*"),
    ("rate_hz = 10", r"rate_hz \(line 4\): 10 is below rate_min_hz \(20\): attitude is never flown"),
    ("rate_min_hz = 50.0\nrate_hz = 40", r"rate_hz \(line 5\): 40 is below rate_min_hz \(50\).*"),
    ("fence = { x_m = [5, -5] }", r"fence\.x_m \(line 4\): 5\.0\.\.-5\.0 does not rise.*"),
    ("fence = { x_m = [0, 3] }", r"fence\.margin_m \(line 4\): 2\.0 leaves nothing of the box to fly to"),
]


@each(("text", "complaint"), IMPOSSIBLE)
def test_what_is_impossible_is_named_by_check_with_its_key_and_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, complaint: str
) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(f"{VEHICLE}[vehicles.a.control]\n{text}\n")
    assert check(path) != 0
    out = " ".join("".join(capsys.readouterr()).split())
    assert re.search(rf"vehicles\.a\.control\.{complaint}", out), out
    assert out.count("vehicles.a.control") == 1 or "x_m = [5" in text, out  # of that box its margin is wrong, too


@each(
    "text",
    [
        "attitude_delay_s = 0.1",
        "hover_thrust = 0.3",  # attitude is flown with less delay than 0.1 s then
        "rate_hz = 25",
        "attitude_delay_s = 0.4\nxy = { pos_p_per_s = 0.55, vel_p = 0.046, vel_i = 0.0067 }\n"
        "z = { pos_p_per_s = 0.25, vel_p = 0.075, vel_i = 0.00125 }",
        "z = { vel_p = 1.5, vel_d = 0.01 }",  # whose margin nobody knows
        "velocity_predictor = true\nxy = { pos_p_per_s = 1.5 }",
    ],
)
def test_gains_that_bear_the_delay_pass(tmp_path: Path, text: str) -> None:
    assert loaded(tmp_path, f"{VEHICLE}[vehicles.a.control]\n{text}\n")


def test_what_is_possible_only_together_is_possible(tmp_path: Path) -> None:
    text = "[defaults.control]\nposition_stale_s = 5\nhover_thrust = 0.6\n[types.t.control]\nstale_s = 3\n"
    config = loaded(tmp_path, text + "thrust_min = 0.5\n[vehicles.a]\nsysid = 1\ntype = 't'\n")
    (vehicle,) = config.vehicle_configs()
    assert vehicle.control.guard().stale_s == 3 and vehicle.control.law().thrust_min == 0.5


def test_what_is_wrong_of_a_lower_level_is_told_there_and_once(tmp_path: Path) -> None:
    text = (
        f"[defaults.control]\nthrust_min = 0.5\n{VEHICLE}[vehicles.a.control]\nrate_hz = 30\n[vehicles.b]\nsysid = 2\n"
    )
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, text)
    (problem,) = caught.value.problems
    assert problem.startswith("defaults.control.thrust_min (line 2): ")


def test_what_is_wrong_only_over_the_lower_level_is_told_where_it_is_said(tmp_path: Path) -> None:
    text = "[defaults.control]\nhover_thrust = 0.6\n" + VEHICLE + "[vehicles.a.control]\nthrust_max = 0.55\n"
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, text)
    (problem,) = caught.value.problems
    assert problem.startswith("vehicles.a.control.thrust_max (line 6): ") and "0.6" in problem


def test_plans_for_a_type_are_timed_within_its_limits(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(
        "[defaults.control.trajectory]\nclimb_mps = 1.0\n"
        "[types.heavy.control.trajectory]\nspeed_mps = 8.0\nacceleration_mps2 = 1.0\njerk_mps3 = 2.0\n"
        '[vehicles.alpha]\nsysid = 1\ntype = "heavy"\n'
        '[vehicles.bravo]\nsysid = 2\ntype = "heavy"\n[vehicles.bravo.control.trajectory]\nspeed_mps = 3.0\n'
    )
    alpha, bravo = load_fleet(path).vehicle_configs()
    assert alpha.control.motion_limits() == MotionLimits(8.0, 1.0, 2.0, climb_mps=1.0)
    assert bravo.control.motion_limits() == MotionLimits(3.0, 1.0, 2.0, climb_mps=1.0)
    assert alpha.control.trajectory_limits().jerk_mps3 == 2.0
    assert load_fleet(path).default_vehicle(9).control.motion_limits() == MotionLimits(climb_mps=1.0)


def test_a_limit_of_a_type_that_is_none_is_named_with_its_file_and_key(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text("[types.heavy.control.trajectory]\njerk_mps3 = 0\n")
    with pytest.raises(ConfigError, match=r"fleet\.toml") as caught:
        load_fleet(path)
    assert "types.heavy.control.trajectory.jerk_mps3" in str(caught.value)
