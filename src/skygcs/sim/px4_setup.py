"""PX4's modes by number, its parameters and default rates, as far as a simulated one has them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from skygcs.sim import protocol as m
from skygcs.sim.param_table import Param


def px4_mode(main: int, sub: int = 0) -> int:
    """custom_mode of a main and a sub mode."""
    return main << 16 | sub << 24


class Px4Mode(IntEnum):
    """HEARTBEAT.custom_mode (px4_custom_mode.h)."""

    MANUAL = px4_mode(1)
    ALTCTL = px4_mode(2)
    POSCTL = px4_mode(3)
    ORBIT = px4_mode(3, 1)
    READY = px4_mode(4, 1)
    TAKEOFF = px4_mode(4, 2)
    LOITER = px4_mode(4, 3)
    MISSION = px4_mode(4, 4)
    RTL = px4_mode(4, 5)
    LAND = px4_mode(4, 6)
    FOLLOW_TARGET = px4_mode(4, 8)
    PRECLAND = px4_mode(4, 9)
    ACRO = px4_mode(5)
    OFFBOARD = px4_mode(6)
    STABILIZED = px4_mode(7)
    RATTITUDE = px4_mode(8)


MANUAL_MODES = frozenset(
    {Px4Mode.MANUAL, Px4Mode.ALTCTL, Px4Mode.POSCTL, Px4Mode.ACRO, Px4Mode.STABILIZED, Px4Mode.RATTITUDE}
)
NO_ARMING_MODES = frozenset({Px4Mode.RTL, Px4Mode.LAND, Px4Mode.PRECLAND, Px4Mode.ORBIT, Px4Mode.FOLLOW_TARGET})

_AUTO_MAIN, _POSCTL_MAIN = 4, 3


def wanted_mode(base_mode: int, main: int, sub: int) -> int | None:
    """The custom_mode that MAV_CMD_DO_SET_MODE's numbers name, None if they name none (Commander.cpp, 1.16).

    Without MAV_MODE_FLAG_CUSTOM_MODE_ENABLED the base mode counts: DroneKit's PX4 guide enters MISSION so.
    """
    if base_mode & m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        if main == _AUTO_MAIN and sub == 0:
            return Px4Mode.MISSION
        if main in (_AUTO_MAIN, _POSCTL_MAIN):
            return px4_mode(main, sub)
        mode = px4_mode(main)  # others have no sub modes
        return mode if mode in Px4Mode._value2member_map_ else None
    if base_mode & m.MAV_MODE_FLAG_AUTO_ENABLED:
        return Px4Mode.MISSION
    if not base_mode & m.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED:
        return None
    if base_mode & m.MAV_MODE_FLAG_GUIDED_ENABLED:
        return Px4Mode.POSCTL
    return Px4Mode.STABILIZED if base_mode & m.MAV_MODE_FLAG_STABILIZE_ENABLED else Px4Mode.MANUAL


_F, _I = m.MAV_PARAM_TYPE_REAL32, m.MAV_PARAM_TYPE_INT32
_PARAMS: tuple[tuple[str, float, int], ...] = (
    ("BAT1_CAPACITY", 5200.0, _F),
    ("BAT1_N_CELLS", 4, _I),
    ("BAT_CRIT_THR", 0.07, _F),
    ("BAT_EMERGEN_THR", 0.05, _F),
    ("BAT_LOW_THR", 0.15, _F),
    ("COM_ARM_WO_GPS", 1, _I),
    ("COM_DISARM_LAND", 2.0, _F),
    ("COM_DISARM_PRFLT", 10.0, _F),
    ("COM_DL_LOSS_T", 10, _I),
    ("COM_LOW_BAT_ACT", 0, _I),
    ("COM_OBL_RC_ACT", 0, _I),
    ("COM_OF_LOSS_T", 1.0, _F),
    ("COM_RC_IN_MODE", 1, _I),
    ("COM_RCL_EXCEPT", 4, _I),
    ("GF_ACTION", 2, _I),
    ("GF_MAX_HOR_DIST", 0.0, _F),
    ("GF_MAX_VER_DIST", 0.0, _F),
    ("MAV_0_MODE", 0, _I),
    ("MAV_0_RATE", 1200, _I),
    ("MAV_COMP_ID", 1, _I),
    ("MAV_TYPE", 2, _I),
    ("MIS_TAKEOFF_ALT", 2.5, _F),
    ("MPC_ACC_HOR", 3.0, _F),
    ("MPC_LAND_SPEED", 0.7, _F),
    ("MPC_THR_HOVER", 0.45, _F),
    ("MPC_TKO_SPEED", 1.5, _F),
    ("MPC_XY_CRUISE", 5.0, _F),
    ("MPC_XY_VEL_MAX", 12.0, _F),
    ("MPC_YAWRAUTO_MAX", 60.0, _F),
    ("MPC_Z_V_AUTO_DN", 1.5, _F),
    ("MPC_Z_V_AUTO_UP", 3.0, _F),
    ("NAV_DLL_ACT", 0, _I),
    ("NAV_RCL_ACT", 2, _I),
    ("RTL_DESCEND_ALT", 10.0, _F),
    ("RTL_LAND_DELAY", 0.0, _F),
    ("RTL_RETURN_ALT", 30.0, _F),
    ("SDLOG_MODE", 0, _I),
    ("SYS_AUTOSTART", 4001, _I),
)
"""RTL heights are the lab's, not PX4's 60 and 30 m: the report warns of a vehicle that "would rush toward space"."""

PX4_RATES_HZ: Mapping[str, float] = {
    "HEARTBEAT": 1,
    "SYS_STATUS": 1,
    "GPS_RAW_INT": 1,
    "ATTITUDE": 4,
    "GLOBAL_POSITION_INT": 2,
    "LOCAL_POSITION_NED": 1,
    "VFR_HUD": 1,
    "ALTITUDE": 0.5,
    "BATTERY_STATUS": 0.5,
    "EXTENDED_SYS_STATE": 1,
    "ESTIMATOR_STATUS": 0.5,
    "HOME_POSITION": 0.2,
    "MISSION_CURRENT": 0.2,
    "SYSTEM_TIME": 0.5,
}
"""What MAV_0_RATE 1200 leaves of the Normal profile: some 650 B/s."""


def px4_params(sysid: int) -> list[Param]:
    return [Param(*p) for p in _PARAMS] + [Param("MAV_SYS_ID", sysid, _I)]
