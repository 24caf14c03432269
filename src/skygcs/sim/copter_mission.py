"""How ArduCopter flies a mission (4.5, mode_auto.cpp): AUTO to the end and beyond, where it loiters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from skygcs.sim import protocol as m
from skygcs.sim.behaviours import CopterMode
from skygcs.sim.command_message import Command
from skygcs.sim.mission_run import MissionRun

if TYPE_CHECKING:
    from skygcs.sim.ardupilot import CopterVehicle
    from skygcs.sim.vehicle import SimVehicle


class CopterRun(MissionRun):
    first_seq = 1
    reports_reached_items = True

    def facts(self, v: SimVehicle) -> dict[str, Any]:
        mission = v.lists.mission
        seq = self.seq_on_wire if mission and self.state != m.MISSION_STATE_NOT_STARTED else 0
        return {"seq": seq, "total": len(mission), "mission_state": self.state, "mission_mode": self.mode_of(v)}

    @staticmethod
    def mode_of(v: SimVehicle) -> int:
        """MISSION_CURRENT.mission_mode: 1 in AUTO, else 2."""
        return 1 if v.mode == CopterMode.AUTO else 2

    def on_set_current(self, v: SimVehicle, seq_on_wire: int, now: float) -> None:
        if self.set_current(v, seq_on_wire, now):
            v.tx.send("MISSION_CURRENT", {**self.facts(v), "seq": self.seq_on_wire})

    def return_home(self, v: SimVehicle, now: float) -> None:
        _copter(v).fly_home()

    def finish(self, v: SimVehicle, now: float) -> None:
        if v.landed:
            _copter(v).switch_off()
        else:
            v.hold_here()

    def land_mps(self, v: SimVehicle) -> float:
        return v.params["LAND_SPEED"] / 100

    def takeoff_mps(self, v: SimVehicle) -> float | None:
        return None

    def change_speed(self, v: SimVehicle, speed_mps: float) -> None:
        _copter(v).speed_mps = speed_mps


def _copter(v: SimVehicle) -> CopterVehicle:
    from skygcs.sim.ardupilot import CopterVehicle

    assert isinstance(v, CopterVehicle)
    return v


def why_not_auto(v: CopterVehicle) -> str:
    """Why AUTO is not entered with the motors on; "" if it is."""
    if not v.lists.mission:
        return "no mission"
    first = v.lists.mission[v.run.seq if v.run.state != m.MISSION_STATE_COMPLETE else 0]
    if v.landed and first.command != m.MAV_CMD_NAV_TAKEOFF:
        v.tx.say(m.MAV_SEVERITY_CRITICAL, "Auto: Missing Takeoff Cmd")
        return "init failed"
    return ""


def start(v: CopterVehicle, now: float) -> int:
    """MAV_CMD_MISSION_START: AUTO, which a disarmed vehicle always enters."""
    if v.try_mode(CopterMode.AUTO, now):
        return m.MAV_RESULT_ACCEPTED
    return m.MAV_RESULT_FAILED


def set_current(v: CopterVehicle, c: Command, now: float) -> int:
    """MAV_CMD_DO_SET_MISSION_CURRENT."""
    if not 0 <= c.p1 <= 0xFFFF or not v.run.set_current(v, int(c.p1), now):
        return v.firmware.answers.simulated.mission_current_beyond
    v.send_soon("MISSION_CURRENT")
    return m.MAV_RESULT_ACCEPTED
