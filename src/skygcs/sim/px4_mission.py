"""How PX4 flies a mission (1.16, navigator): AUTO.MISSION, then a hold; a return is the mode of its own."""

from __future__ import annotations

from math import isfinite
from typing import Any, Protocol

from skygcs.core.mission.item import MissionType
from skygcs.sim import protocol as m
from skygcs.sim.command_message import Command
from skygcs.sim.firmware_modes import Px4Mode
from skygcs.sim.mission_lists import MissionLists
from skygcs.sim.mission_run import MissionRun, MissionVehicle

NO_MISSION_TOTAL = 65535
"""MISSION_CURRENT.total without a mission."""


class Px4Orders(Protocol):
    """Orders that a mission has a PX4 do."""

    cruise_mps: float

    def enter(self, mode: int, now: float) -> None: ...

    def intend(self, mode: int) -> None: ...

    def say_event(self, severity: int, text: str) -> None: ...

    def try_mode(self, mode: int, now: float) -> bool: ...

    def try_arm(self, now: float) -> bool: ...


class Px4Run(MissionRun):
    """PX4 does not report MISSION_CURRENT.mission_state; the message ends with the ids of its lists (`ids`).

    MissionBase::on_active reports every item: MAVSDK waits for that of its last one, a change of speed.
    """

    reports_each = True

    def __init__(self, px4: Px4Orders) -> None:
        super().__init__()
        self._px4 = px4

    def start(self, v: MissionVehicle, c: Command, now: float) -> int:
        """MAV_CMD_MISSION_START: the mode, motors on, and the item unless it is -1."""
        if not v.lists.mission:
            self._px4.say_event(m.MAV_SEVERITY_CRITICAL, "Mission start denied! No valid mission")
            return m.MAV_RESULT_DENIED
        if not (isfinite(c.p1) and -1 <= c.p1 < len(v.lists.mission)):
            return m.MAV_RESULT_DENIED
        if c.p1 >= 0:
            self.set_current(v, int(c.p1), now)
        if not self._px4.try_mode(Px4Mode.MISSION, now) or not self._px4.try_arm(now):
            return m.MAV_RESULT_TEMPORARILY_REJECTED
        return m.MAV_RESULT_ACCEPTED

    def facts(self, v: MissionVehicle) -> dict[str, Any]:
        return {"seq": self.seq, "total": len(v.lists.mission) or NO_MISSION_TOTAL}

    def on_set_current(self, v: MissionVehicle, seq_on_wire: int, now: float) -> None:
        if self.set_current(v, seq_on_wire, now):
            v.send_soon("MISSION_CURRENT")
        else:
            v.tx.say(m.MAV_SEVERITY_CRITICAL, "WPM: WP CURR CMD: Not in list\t")

    def return_home(self, v: MissionVehicle, now: float) -> None:
        self._px4.enter(Px4Mode.RTL, now)

    def finish(self, v: MissionVehicle, now: float) -> None:
        self._px4.say_event(m.MAV_SEVERITY_INFO, "Mission finished, loitering")
        self._px4.intend(Px4Mode.LOITER)
        self._px4.enter(Px4Mode.LOITER, now)

    def land_mps(self, v: MissionVehicle) -> float:
        return v.params["MPC_LAND_SPEED"]

    def takeoff_mps(self, v: MissionVehicle) -> float | None:
        return v.params["MPC_TKO_SPEED"]

    def change_speed(self, v: MissionVehicle, speed_mps: float) -> None:
        self._px4.cruise_mps = speed_mps


def ids(lists: MissionLists) -> bytes:
    """Return what PX4 adds to MISSION_CURRENT: mission_id, fence_id, rally_points_id."""
    return b"".join(lists.opaque_id(kind).to_bytes(4, "little") for kind in MissionType)
