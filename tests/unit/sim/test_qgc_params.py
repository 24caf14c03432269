"""QGroundControl's own requests: a vehicle without one of these names shows "parameters are missing" on its pages."""

from __future__ import annotations

from skygcs.sim.firmware_params import copter_params, px4_params
from skygcs.sim.param_table import INTEGER_RANGE, Param
from support.table import each

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
