"""What a vehicle does on a mission once no ground station is heard. Pure.

    PX4 1.16 (failsafe.cpp)              ArduCopter 4.6 (events.cpp, failsafe_gcs_on_event)       its mission
    ----------------------------------   ------------------------------------------------------   ---------------------
    NAV_DLL_ACT 0                        FS_GCS_ENABLE 0                                          is flown to the end
    COM_DLL_EXCEPT with bit 0            FS_OPTIONS with bit 1                                    is flown to the end
    anything else                        anything else                                            is broken off

At the end it holds. A PX4 that hears no transmitter either, and is allowed not to (COM_RCL_EXCEPT with bit 0, or
COM_RC_IN_MODE 4), returns there if NAV_DLL_ACT is 0.
"""

from __future__ import annotations

from typing import NamedTuple

from skygcs.core.vehicle.offboard_entry import ask_parameter
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.vehicle import Vehicle

PARAMETERS = {
    "px4": ("NAV_DLL_ACT", "COM_DLL_EXCEPT"),
    "ardupilot": ("FS_GCS_ENABLE", "FS_OPTIONS"),
}
"""By firmware: what it does without a ground station at all, and where it takes no notice of that."""

MISSION_BIT = {"px4": 1, "ardupilot": 2}
"""Value in the second of them: not on a mission."""


class MissionLoss(NamedTuple):
    """``goes_on``: to the end of its mission; None: not known. ``param``, ``value``: what makes it go on."""

    goes_on: bool | None
    text: str
    param: str = ""
    value: float = 0.0


def ask_mission_loss(vehicle: Vehicle, now: float) -> Plan:
    """Read the parameters that are not known."""
    wanted = [name for name in PARAMETERS.get(vehicle.family, ()) if vehicle.param(name) is None]
    return Plan(
        "parameters", tuple(ask_parameter(name, after=now, optional=True) for name in wanted), "parameters read"
    )


def mission_loss(vehicle: Vehicle) -> MissionLoss:
    """Judge by the parameters that were read."""
    if vehicle.family not in PARAMETERS:
        return MissionLoss(None, "what its firmware does without a ground station is not known")
    action_name, except_name = PARAMETERS[vehicle.family]
    action, exceptions = vehicle.param(action_name), vehicle.param(except_name)
    if action == 0:
        back = ", or returns from there if it hears no transmitter either" if vehicle.family == "px4" else ""
        return MissionLoss(True, f"it flies its mission to the end and holds there{back} ({action_name} 0)")
    bit = MISSION_BIT[vehicle.family]
    if exceptions is not None and int(exceptions) & bit:
        return MissionLoss(True, f"it flies its mission to the end and holds there ({except_name} {exceptions:g})")
    if action is None or exceptions is None:
        unknown = action_name if action is None else except_name
        return MissionLoss(None, f"its {unknown} is not known, which decides what it does without a ground station")
    return MissionLoss(
        False,
        f"without a ground station it breaks its mission off ({action_name} {action:g}, {except_name} {exceptions:g})",
        except_name,
        float(int(exceptions) | bit),
    )
