"""How PX4 flies a mission (1.16, navigator): AUTO.MISSION, then a hold; a return is the mode of its own."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

from skygcs.core.mission.item import MissionType
from skygcs.sim import protocol as m
from skygcs.sim.behaviours import Px4Mode
from skygcs.sim.command_message import Command
from skygcs.sim.mission_run import MissionRun

if TYPE_CHECKING:
    from skygcs.sim.px4 import Px4Vehicle
    from skygcs.sim.vehicle import SimVehicle

NO_MISSION_TOTAL = 65535
"""MISSION_CURRENT.total without a mission."""


class Px4Run(MissionRun):
    """It does not tell MISSION_CURRENT.mission_state; behind the message are the ids of its lists (`ids`).

    MissionBase::on_active reports every item: MAVSDK waits for that of its last one, a change of speed.
    """

    reports_each = True

    def facts(self, v: SimVehicle) -> dict[str, Any]:
        return {"seq": self.seq, "total": len(v.lists.mission) or NO_MISSION_TOTAL}

    def on_set_current(self, v: SimVehicle, seq_on_wire: int, now: float) -> None:
        if self.set_current(v, seq_on_wire, now):
            v.send_soon("MISSION_CURRENT")
        else:
            v.tx.say(m.MAV_SEVERITY_CRITICAL, "WPM: WP CURR CMD: Not in list\t")

    def return_home(self, v: SimVehicle, now: float) -> None:
        _px4(v).enter(Px4Mode.RTL, now)

    def finish(self, v: SimVehicle, now: float) -> None:
        _px4(v).say_event(m.MAV_SEVERITY_INFO, "Mission finished, loitering")
        _px4(v).intend(Px4Mode.LOITER)
        _px4(v).enter(Px4Mode.LOITER, now)

    def land_mps(self, v: SimVehicle) -> float:
        return v.params["MPC_LAND_SPEED"]

    def takeoff_mps(self, v: SimVehicle) -> float | None:
        return v.params["MPC_TKO_SPEED"]

    def change_speed(self, v: SimVehicle, speed_mps: float) -> None:
        _px4(v).cruise_mps = speed_mps


def _px4(v: SimVehicle) -> Px4Vehicle:
    from skygcs.sim.px4 import Px4Vehicle

    assert isinstance(v, Px4Vehicle)
    return v


def ids(v: Px4Vehicle) -> bytes:
    """What PX4 adds to MISSION_CURRENT: mission_id, fence_id, rally_points_id."""
    return b"".join(v.lists.opaque_id(kind).to_bytes(4, "little") for kind in MissionType)


def start(v: Px4Vehicle, c: Command, now: float) -> int:
    """MAV_CMD_MISSION_START: the mode, motors on, and the item unless it is -1."""
    if not v.lists.mission:
        v.say_event(m.MAV_SEVERITY_CRITICAL, "Mission start denied! No valid mission")
        return m.MAV_RESULT_DENIED
    if not (isfinite(c.p1) and -1 <= c.p1 < len(v.lists.mission)):
        return m.MAV_RESULT_DENIED
    if c.p1 >= 0:
        v.run.set_current(v, int(c.p1), now)
    if not v.try_mode(Px4Mode.MISSION, now) or not v.try_arm(now):
        return m.MAV_RESULT_TEMPORARILY_REJECTED
    return m.MAV_RESULT_ACCEPTED
