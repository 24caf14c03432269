"""How ArduCopter flies a mission (4.5, mode_auto.cpp): AUTO to the end and beyond, where it loiters."""

from __future__ import annotations

from typing import Any, Protocol

from skygcs.sim import protocol as m
from skygcs.sim.behaviours import COPTER
from skygcs.sim.command_message import Command
from skygcs.sim.mission_run import MissionRun, MissionVehicle


class CopterOrders(Protocol):
    """Orders that a mission has an ArduCopter do."""

    speed_mps: float

    @property
    def auto_mode(self) -> int: ...

    def fly_home(self) -> None: ...

    def switch_off(self) -> None: ...

    def try_mode(self, number: int, now: float) -> bool: ...


class CopterRun(MissionRun):
    first_seq = 1
    reports_reached_items = True

    def __init__(self, copter: CopterOrders) -> None:
        super().__init__()
        self._copter = copter

    def why_not_auto(self, v: MissionVehicle) -> str:
        """Why AUTO is not entered with the motors on; "" if it is."""
        if not v.lists.mission:
            return "no mission"
        first = v.lists.mission[self.seq if self.state != m.MISSION_STATE_COMPLETE else 0]
        if v.landed and first.command != m.MAV_CMD_NAV_TAKEOFF:
            v.tx.say(m.MAV_SEVERITY_CRITICAL, "Auto: Missing Takeoff Cmd")
            return "init failed"
        return ""

    def start(self, now: float) -> int:
        """MAV_CMD_MISSION_START: AUTO, which a disarmed vehicle always enters."""
        return m.MAV_RESULT_ACCEPTED if self._copter.try_mode(self._copter.auto_mode, now) else m.MAV_RESULT_FAILED

    def on_set_current_command(self, v: MissionVehicle, c: Command, now: float) -> int:
        """MAV_CMD_DO_SET_MISSION_CURRENT."""
        if not 0 <= c.p1 <= 0xFFFF or not self.set_current(v, int(c.p1), now):
            return COPTER.answers.simulated.mission_current_beyond
        v.send_soon("MISSION_CURRENT")
        return m.MAV_RESULT_ACCEPTED

    def facts(self, v: MissionVehicle) -> dict[str, Any]:
        mission = v.lists.mission
        seq = self.seq_on_wire if mission and self.state != m.MISSION_STATE_NOT_STARTED else 0
        return {"seq": seq, "total": len(mission), "mission_state": self.state, "mission_mode": self.mode_of(v)}

    def mode_of(self, v: MissionVehicle) -> int:
        """MISSION_CURRENT.mission_mode: 1 in AUTO, else 2."""
        return 1 if v.mode == self._copter.auto_mode else 2

    def on_set_current(self, v: MissionVehicle, seq_on_wire: int, now: float) -> None:
        if self.set_current(v, seq_on_wire, now):
            v.tx.send("MISSION_CURRENT", {**self.facts(v), "seq": self.seq_on_wire})

    def return_home(self, v: MissionVehicle, now: float) -> None:
        self._copter.fly_home()

    def finish(self, v: MissionVehicle, now: float) -> None:
        if v.landed:
            self._copter.switch_off()
        else:
            v.hold_here()

    def land_mps(self, v: MissionVehicle) -> float:
        return v.params["LAND_SPEED"] / 100

    def takeoff_mps(self, v: MissionVehicle) -> float | None:
        return None

    def change_speed(self, v: MissionVehicle, speed_mps: float) -> None:
        self._copter.speed_mps = speed_mps
