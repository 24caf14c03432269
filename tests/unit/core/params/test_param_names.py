"""Roles of parameters: what must not change while a flight runs by it, and what may."""

from __future__ import annotations

from skygcs.core.params.names import EFFECTS, LOCKED, ParamRole, role_of
from skygcs.core.vehicle.fence_params import NAMES
from skygcs.core.vehicle.offboard_entry import COPTER_PARAMETERS, PX4_PARAMETERS
from support.table import each

R = ParamRole


@each(
    ("family", "role", "names"),
    [
        ("px4", R.IDENTITY, "MAV_SYS_ID MAV_COMP_ID MAV_TYPE"),
        ("px4", R.SETPOINT_LOSS, "COM_OF_LOSS_T COM_OBL_RC_ACT"),
        ("px4", R.FENCE, "GF_ACTION GF_MAX_HOR_DIST GF_MAX_VER_DIST"),
        ("px4", R.FAILSAFE, "NAV_DLL_ACT NAV_RCL_ACT COM_DL_LOSS_T COM_LOW_BAT_ACT BAT1_CAPACITY CBRK_SUPPLY_CHK"),
        ("px4", R.ESTIMATOR, "EKF2_HGT_REF EKF2_EV_CTRL CAL_MAG0_ID SENS_BOARD_ROT"),
        ("px4", R.AIRFRAME, "SYS_AUTOSTART CA_ROTOR_COUNT PWM_MAIN_FUNC1"),
        ("px4", R.RETURN, "RTL_RETURN_ALT"),
        ("px4", R.LINK, "MAV_0_RATE SER_TEL1_BAUD"),
        ("px4", R.TRANSMITTER, "RC1_MIN COM_FLTMODE1 COM_RC_IN_MODE"),
        ("px4", R.ARMING, "COM_DISARM_LAND COM_ARM_WO_GPS"),
        ("px4", R.TUNING, "MPC_XY_VEL_MAX MC_ROLL_P"),
        ("px4", R.HARMLESS, "SDLOG_MODE"),
        ("px4", R.UNKNOWN, "FRAME_CLASS LOG_BITMASK NEXT_YEARS_IDEA"),
        ("ardupilot", R.IDENTITY, "SYSID_THISMAV MAV_SYSID SYSID_MYGCS SYSID_ENFORCE MAV_OPTIONS"),
        ("ardupilot", R.SETPOINT_LOSS, "GUID_TIMEOUT GUID_OPTIONS"),
        ("ardupilot", R.FENCE, "FENCE_ENABLE FENCE_RADIUS AVOID_ENABLE"),
        ("ardupilot", R.FAILSAFE, "FS_GCS_ENABLE FS_OPTIONS BATT_FS_LOW_ACT"),
        ("ardupilot", R.ESTIMATOR, "EK3_SRC1_YAW COMPASS_USE INS_ACC_ID GPS_TYPE AHRS_EKF_TYPE"),
        ("ardupilot", R.AIRFRAME, "FRAME_CLASS FRAME_TYPE SERVO1_FUNCTION MOT_PWM_TYPE"),
        ("ardupilot", R.RETURN, "RTL_ALT RTL_ALT_M LAND_SPEED"),
        ("ardupilot", R.LINK, "SERIAL1_BAUD SR1_POSITION MAV1_POSITION"),
        ("ardupilot", R.TUNING, "ATC_RAT_RLL_P PSC_POSXY_P WPNAV_SPEED MOT_THST_HOVER ANGLE_MAX"),
        ("ardupilot", R.HARMLESS, "LOG_BITMASK NTF_LED_BRIGHT"),
        ("ardupilot", R.UNKNOWN, "MPC_XY_VEL_MAX NEXT_YEARS_IDEA"),
        ("generic", R.UNKNOWN, "SYSID_THISMAV LOG_BITMASK"),
    ],
)
def test_a_parameter_has_the_role_of_its_firmware(family: str, role: ParamRole, names: str) -> None:
    assert {name: role_of(family, name) for name in names.split()} == dict.fromkeys(names.split(), role)


def test_what_control_is_entered_with_is_locked() -> None:
    for family, asked in (("px4", PX4_PARAMETERS), ("ardupilot", COPTER_PARAMETERS)):
        tuned = {"MPC_THR_HOVER", "MOT_THST_HOVER", "ATC_ANGLE_BOOST"}
        assert all(role_of(family, name) in LOCKED for name, _ in asked if name not in tuned)
        assert all(role_of(family, name) is R.FENCE for name in NAMES[family])


def test_every_role_has_a_reason() -> None:
    assert EFFECTS.keys() == set(R)
