"""How `skygcs sim` words the air and the sensors, and what it says of words it cannot use."""

from __future__ import annotations

import pytest

from skygcs.cli.serve import main
from skygcs.cli.sim import parse_conditions
from skygcs.errors import LinkError
from skygcs.sim.conditions import Conditions, Dynamics
from support.table import each


def parse(wind: str = "0", **words: object) -> Conditions:
    reported: dict[str, object] = {
        "dynamics": "rigid",
        "airframe": "f450",
        "attitude_lag_s": None,
        "gps_noise_m": 0.0,
        "attitude_noise_deg": 0.0,
        "sensor_latency_s": 0.0,
    }
    return parse_conditions(wind, **(reported | words))  # type: ignore[arg-type]


def test_no_options_are_calm_air_and_a_rigid_f450() -> None:
    assert parse() == Conditions()


@each(("wind", "east", "north", "gust"), [("5", 5, 0, 0), ("5,0", 0, -5, 0), ("4,90,1.5", -4, 0, 1.5)])
def test_wind_is_a_speed_a_direction_and_gusts(wind: str, east: float, north: float, gust: float) -> None:
    conditions = parse(wind)
    assert conditions.wind_enu_mps == pytest.approx((east, north, 0), abs=1e-9)
    assert conditions.gust_mps == gust


def test_the_other_options_arrive() -> None:
    conditions = parse(dynamics="kinematic", attitude_lag_s=0.3, gps_noise_m=0.5, sensor_latency_s=0.1)
    assert conditions.dynamics is Dynamics.KINEMATIC
    assert conditions.airframe.attitude_lag_s == 0.3
    assert (conditions.gps_noise_m, conditions.sensor_latency_s) == (0.5, 0.1)


@each("wind", ["", "strong", "1,2,3,4", "40", "nan", "-3", "5,inf", "5,0,-1"])
def test_a_wind_that_is_none_is_refused_in_words(wind: str) -> None:
    with pytest.raises(LinkError, match=r"--wind|wind|gust"):
        parse(wind)


def test_the_command_line_ends_with_one_line_and_no_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["sim", "--wind", "99"])
    assert end.value.code == 1
    said = capsys.readouterr()
    assert said.err == "skygcs: wind 99 is not in 0..30\n"
