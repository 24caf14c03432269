"""Parameters that decide how an autopilot takes setpoints and orders, from the PARAM_VALUEs that anybody requested."""

from __future__ import annotations

import math
import struct

from skygcs.core.mavlink.vehicle_class import declared_params

WATCHED = declared_params() | frozenset(
    {
        "ATC_ANGLE_BOOST",
        "COM_DLL_EXCEPT",
        "COM_OBL_RC_ACT",
        "COM_OF_LOSS_T",
        "COM_RC_IN_MODE",
        "FENCE_ACTION",
        "FENCE_ALT_MAX",
        "FENCE_ENABLE",
        "FENCE_RADIUS",
        "FENCE_TYPE",
        "FS_GCS_ENABLE",
        "FS_OPTIONS",
        "GF_ACTION",
        "GF_MAX_HOR_DIST",
        "GF_MAX_VER_DIST",
        "GUID_OPTIONS",
        "GUID_TIMEOUT",
        "MIS_RESTART",
        "MOT_THST_EXPO",
        "MOT_THST_HOVER",
        "MPC_THR_HOVER",
        "NAV_DLL_ACT",
        "THR_MDL_FAC",
    }
)
"""Those of setpoints, of the fence's cylinder, and what `vehicle_class` declares. Others are not kept: a vehicle has a
thousand parameters."""

INTEGER_FORMAT = {1: "B", 2: "b", 3: "H", 4: "h", 5: "I", 6: "i"}
"""struct codes of the integer types among MAV_PARAM_TYPE."""


class Parameters:
    """Values of `WATCHED` by name, each with the time of its report. A reboot drops them all."""

    __slots__ = ("_values",)

    def __init__(self) -> None:
        self._values: dict[str, tuple[float, float]] = {}

    def note(self, raw_name: bytes, wire_value: float, param_type: int, now: float, *, bytewise: bool) -> None:
        """Note a PARAM_VALUE. ``bytewise``: the float field holds an integer's bytes, as PX4 sends it
        (PARAM_ENCODE_BYTEWISE); else integers are cast to float, as ArduPilot does (PARAM_ENCODE_C_CAST)."""
        name = raw_name.rstrip(b"\0").decode("ascii", "replace")
        if name not in WATCHED:
            return
        code = INTEGER_FORMAT.get(param_type)
        value = wire_value
        if code is not None and bytewise:
            value = float(struct.unpack_from("<" + code, struct.pack("<f", wire_value))[0])
        if math.isfinite(value):
            self._values[name] = (value, now)

    def value(self, name: str) -> float | None:
        """The value; None if it was not reported since the vehicle started."""
        known = self._values.get(name)
        return None if known is None else known[0]

    def reported_at(self, name: str) -> float | None:
        known = self._values.get(name)
        return None if known is None else known[1]

    def forget(self) -> None:
        self._values.clear()
