"""Parameters of a simulated vehicle in both encodings, and its seeded chance and battery."""

from __future__ import annotations

import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.params.param_file import parse
from skygcs.errors import ConfigError
from skygcs.sim.battery import Battery
from skygcs.sim.firmware_params import copter_params, px4_params
from skygcs.sim.param_set import param_set
from skygcs.sim.param_table import INTEGER_RANGE, Param, Params
from skygcs.sim.rng import Rng
from skygcs.sim.vehicle_group import make_vehicles
from support.public_data import present, public_file
from support.sim_pilot import FIELD, Pilot, sim_dialect
from support.table import each

INT32, INT8, FLOAT = 6, 2, 9


def make(bytewise: bool) -> Params:
    return Params(
        [Param("B_INT", 7, INT32), Param("A_FLOAT", 2.5, FLOAT), Param("C_BYTE", -3, INT8)], bytewise=bytewise
    )


def as_float(value: int) -> float:
    result: float = struct.unpack("<f", struct.pack("<i", value))[0]
    return result


def test_px4_sends_an_integers_bytes_and_ardupilot_its_value() -> None:
    found = make(True).find("B_INT")
    assert found is not None
    assert make(True).encode(found[1]) == as_float(7)
    assert make(False).encode(found[1]) == 7


@each("bytewise", [True, False])
def test_what_is_set_is_what_is_read(bytewise: bool) -> None:
    params = make(bytewise)
    for name, value in (("B_INT", -123456), ("C_BYTE", 100), ("A_FLOAT", -0.25)):
        wire = as_float(int(value)) if bytewise and name != "A_FLOAT" else value
        param = params.set(name, wire)
        assert param is not None and params[name] == value
        assert struct.pack("<f", params.encode(param)) == struct.pack("<f", wire)


@each("bad", [float("nan"), float("inf"), 300.0])
def test_a_value_the_type_cannot_hold_changes_nothing(bad: float) -> None:
    params = make(False)
    assert params.set("C_BYTE", bad) is not None
    assert params["C_BYTE"] == -3


def test_an_unknown_name_is_not_made_up() -> None:
    params = make(True)
    assert params.set("NOPE", 1.0) is None
    assert params.find("NOPE") is None
    assert params.at(3) is None and params.at(-1) is None


def test_indices_follow_the_alphabet() -> None:
    params = make(True)
    assert [params.at(i).name for i in range(len(params))] == ["A_FLOAT", "B_INT", "C_BYTE"]  # type: ignore[union-attr]


def test_the_same_seed_gives_the_same_numbers_and_another_others() -> None:
    def draw(seed: int) -> list[float]:
        rng = Rng(seed)
        return [rng.random() for _ in range(5)]

    assert draw(7) == draw(7)
    assert draw(7) != draw(8)
    assert draw(0) != draw(1)


def test_probabilities_are_kept() -> None:
    rng = Rng(42)
    values = [rng.random() for _ in range(20_000)]
    assert all(0 <= v < 1 for v in values)
    for decile in range(10):
        assert sum(decile / 10 <= v < (decile + 1) / 10 for v in values) == pytest.approx(2000, abs=200)
    assert sum(rng.happens(0.3) for _ in range(10_000)) == pytest.approx(3000, abs=200)
    assert not any(rng.happens(0.0) for _ in range(100))


def test_a_battery_lasts_about_twenty_minutes_of_hover_and_its_voltage_falls() -> None:
    battery = Battery()
    full = battery.volts
    minutes = 0
    while battery.percent > 0 and minutes < 100:
        battery.step(60.0, flying=True)
        minutes += 1
    assert 15 <= minutes <= 25
    assert battery.volts < full - 3
    battery.set_percent(42)
    assert battery.percent == 42


# -- Parameter files taken in by simulated vehicles.


FILES = [
    ("made-px4.params", "px4", 1000),
    ("made-px4-mavproxy.parm", "px4", 700),
    ("made-copter-mavproxy.parm", "ardupilot", 1000),
    ("made-copter-comments.param", "ardupilot", 5),
    ("px4-amovlab-f410-v1.15.4.params", "px4", 1000),
    ("px4-mavproxy.parm", "px4", 700),
    ("apcopter-4.5-eagle-mavproxy.parm", "ardupilot", 1000),
    ("apcopter-methodic-11_battery.param", "ardupilot", 5),
]


@each(("name", "family", "at_least"), [f for f in FILES if present("params", f[:1])])
def test_a_file_is_taken_in_by_the_vehicles_of_its_firmware(name: str, family: str, at_least: int) -> None:
    text = public_file(f"params/{name}").read_text()
    taken = param_set(parse(text, name), name)
    assert (taken.family, len(taken.params) >= at_least) == (family, True)
    vehicles = make_vehicles(sim_dialect(), px4=2, ardupilot=1, first_sysid=5, home=FIELD, params=[taken])
    assert [v.sysid for v in vehicles] == [5, 6, 7], "system ids stay"
    px4_count, _, copter_count = (len(v.params) for v in vehicles)
    assert (px4_count > len(px4_params(1)) + 100) == (family == "px4" and at_least > 100)
    assert (copter_count > len(copter_params(1)) + 100) == (family == "ardupilot" and at_least > 100)
    first, second = vehicles[:2]
    first.params.set("MPC_XY_CRUISE", 9.0)
    assert second.params["MPC_XY_CRUISE"] != 9.0, "each has its own"


@each("name", present("params", ["made-px4.params", "px4-amovlab-f410-v1.15.4.params"]))
def test_a_taken_in_vehicle_lists_and_flies(name: str) -> None:
    text = public_file(f"params/{name}").read_text()
    taken = param_set(parse(text, "f410"), "f410")
    pilot = Pilot(*make_vehicles(sim_dialect(), px4=1, ardupilot=0, first_sysid=1, home=FIELD, params=[taken]))
    pilot.send(mav.MAVLink_param_request_list_message(1, 1))
    pilot.run(15.0)
    values = {x.param_id: x for x in pilot.all("PARAM_VALUE")}
    assert len(values) == values["MPC_XY_CRUISE"].param_count + 1, "and the hash"
    assert {values[name].param_type for name in taken.params} <= {mav.MAV_PARAM_TYPE_REAL32, mav.MAV_PARAM_TYPE_INT32}


def test_a_file_of_something_else_is_refused() -> None:
    with pytest.raises(ConfigError, match="no parameter that a simulated"):
        param_set(parse("Q_ENABLE,1\n", "plane.param"), "plane.param")


# -- QGroundControl's own requests: a vehicle without one of these names shows "parameters are missing" on its pages.


PX4_PAGES = """
    SYS_AUTOSTART SYS_HITL SYS_HAS_MAG SYS_VEHICLE_RESP CAL_MAG0_ID CAL_MAG1_ID CAL_MAG2_ID CAL_MAG0_ROT
    CAL_MAG1_ROT CAL_MAG2_ROT CAL_GYRO0_ID CAL_ACC0_ID SENS_BOARD_ROT SENS_DPRES_OFF COM_RC_IN_MODE RC_MAP_ROLL
    RC_MAP_PITCH RC_MAP_YAW RC_MAP_THROTTLE RC_MAP_FLAPS RC_MAP_AUX1 RC_MAP_AUX2 RC_MAP_FLTMODE RC_MAP_RETURN_SW
    RC_MAP_KILL_SW RC_MAP_OFFB_SW RC_MAP_MODE_SW COM_FLTMODE1 COM_FLTMODE6 SDLOG_MODE GF_ACTION GF_MAX_HOR_DIST
    GF_MAX_VER_DIST RTL_LAND_DELAY RTL_RETURN_ALT RTL_DESCEND_ALT COM_LOW_BAT_ACT NAV_RCL_ACT NAV_DLL_ACT
    COM_DISARM_LAND CP_DIST COM_RC_LOSS_T COM_DL_LOSS_T BAT_LOW_THR BAT_CRIT_THR BAT_EMERGEN_THR MPC_LAND_SPEED
    BAT1_SOURCE BAT1_N_CELLS BAT1_V_CHARGED BAT1_V_EMPTY MPC_XY_VEL_ALL MPC_Z_VEL_ALL NAV_ACC_RAD RTL_PLD_MD RC1_MIN
    RC18_TRIM
"""
"""Left out, because PX4 1.16.1 has none of that name: COM_OBS_AVOID, BAT1_V_LOAD_DROP, BAT1_V_DIV, BAT1_A_PER_V."""

COPTER_PAGES = """
    FRAME_CLASS FRAME_TYPE ARMING_CHECK FS_GCS_ENABLE FS_GCS_TIMEOUT FS_OPTIONS FS_THR_ENABLE FS_THR_VALUE
    FENCE_ACTION FENCE_ALT_MAX FENCE_ENABLE FENCE_MARGIN FENCE_RADIUS FENCE_TYPE LAND_SPEED RTL_ALT RTL_LOIT_TIME
    RTL_ALT_FINAL BATT_MONITOR BATT2_MONITOR BATT_CAPACITY BATT_ARM_VOLT BATT_AMP_PERVLT BATT_AMP_OFFSET
    BATT_VOLT_MULT BATT_FS_LOW_ACT BATT_FS_CRT_ACT BATT_LOW_MAH BATT_CRT_MAH BATT_LOW_VOLT BATT_CRT_VOLT
    COMPASS_DEV_ID COMPASS_DEV_ID2 COMPASS_DEV_ID3 COMPASS_PRIO1_ID COMPASS_PRIO2_ID COMPASS_PRIO3_ID COMPASS_ORIENT
    COMPASS_USE COMPASS_USE2 COMPASS_USE3 COMPASS_EXTERNAL COMPASS_EXTERN2 COMPASS_OFS_X COMPASS_OFS2_Y
    COMPASS_OFS3_Z COMPASS_DEC INS_ACC_ID INS_ACC2_ID BARO1_DEVID BARO2_DEVID BARO3_DEVID AUTOTUNE_AXES FLTMODE1
    FLTMODE6 FLTMODE_CH RC7_OPTION RC12_OPTION
"""
"""Left out, because ArduCopter 4.6.3 has none of that name: FS_BATT_*, THR_MID, RATE_*, CH7_OPT, COMPASS_PRIMARY."""


@each(("params", "pages"), [(px4_params(1), PX4_PAGES), (copter_params(1), COPTER_PAGES)])
def test_what_qgroundcontrol_asks_for_by_name_is_there(params: list[Param], pages: str) -> None:
    names = {p.name for p in params}
    assert not set(pages.split()) - names


@each("params", [px4_params(1), copter_params(1)])
def test_no_parameter_is_there_twice_and_its_type_holds_its_value(params: list[Param]) -> None:
    names = [p.name for p in params]
    assert len(names) == len(set(names)) and all(0 < len(name) <= 16 for name in names)
    for p in params:
        low, high = INTEGER_RANGE.get(p.type, (-1e30, 1e30))
        assert low <= p.value <= high
