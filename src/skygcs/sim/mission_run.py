"""A mission as it is flown: which item is current, what comes next, and each item as legs of `plan`.

Simple items are flown: take-off, waypoints (with their hold time), loitering for a time or for good, delays, return,
landing, changes of speed and jumps. Others that move the vehicle are flown as waypoints (turns are not circled), others
that do something are passed over. The vehicle stops at each waypoint.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Protocol

from skygcs.core.mission.item import MissionItem
from skygcs.sim import protocol as m
from skygcs.sim.legs import GoTo, Land, Leg, Plan, Wait
from skygcs.sim.mission_lists import MissionLists
from skygcs.sim.param_table import Params
from skygcs.sim.position_targets import Located, up_of
from skygcs.sim.transmitter import Transmitter

FLOWN_CONDITIONS = frozenset({m.MAV_CMD_CONDITION_DELAY})

MAX_PASSED = 1000
"""Items looked at for the next one to fly: jumps that lead to each other and to nothing else end the mission."""


class MissionVehicle(Located, Protocol):
    """Parts of a vehicle that its mission flies."""

    mode: int
    params: Params
    tx: Transmitter
    plan: Plan
    lists: MissionLists
    landed: bool
    taking_off: bool

    def send_soon(self, name: str) -> None: ...

    def hold_here(self) -> None: ...


class MissionRun(ABC):
    """Mission of one vehicle; ``seq`` counts its items as `MissionLists.mission` does, from 0.

    ``first_seq`` is the number of item 0 on the wire: 1 behind an ArduPilot's home.
    """

    first_seq = 0
    reports_reached_items = False
    """True if items that do not move it are reported as reached, too; of several reached at once only the last is
    reported."""

    reports_each = False
    """True if items that do not move it are reported as reached, each in turn (PX4)."""

    def __init__(self) -> None:
        self.seq = 0
        self.state = m.MISSION_STATE_NO_MISSION
        self.reached = 0
        self._jumps: dict[int, int] = {}
        self._stays = False
        self._flies = False
        self._lands = False

    @property
    def seq_on_wire(self) -> int:
        return self.seq + self.first_seq

    # -- what differs between the firmwares

    @abstractmethod
    def facts(self, v: MissionVehicle) -> dict[str, Any]:
        """Fields of MISSION_CURRENT."""

    @abstractmethod
    def on_set_current(self, v: MissionVehicle, seq_on_wire: int, now: float) -> None:
        """MISSION_SET_CURRENT."""

    @abstractmethod
    def return_home(self, v: MissionVehicle, now: float) -> None:
        """Carry out the item that returns to launch."""

    @abstractmethod
    def finish(self, v: MissionVehicle, now: float) -> None:
        """End the mission: there is no item left."""

    @abstractmethod
    def land_mps(self, v: MissionVehicle) -> float: ...

    @abstractmethod
    def change_speed(self, v: MissionVehicle, speed_mps: float) -> None: ...

    @abstractmethod
    def takeoff_mps(self, v: MissionVehicle) -> float | None: ...

    # -- life

    def changed(self, v: MissionVehicle) -> None:
        """Another mission is on board, or none."""
        self._jumps.clear()
        self.reached = 0
        if self.seq >= len(v.lists.mission):
            self.seq = 0
        self.state = m.MISSION_STATE_NOT_STARTED if v.lists.mission else m.MISSION_STATE_NO_MISSION

    def begin(self, v: MissionVehicle, now: float) -> None:
        """Fly on with the current item; a finished mission from its beginning."""
        if self.state == m.MISSION_STATE_COMPLETE:
            self.seq = 0
            self._jumps.clear()
        self.state = m.MISSION_STATE_ACTIVE
        self._go(v, self.seq, now)

    def leave(self) -> None:
        """Another mode flies the vehicle now."""
        self._flies = False
        if self.state == m.MISSION_STATE_ACTIVE:
            self.state = m.MISSION_STATE_PAUSED

    def set_current(self, v: MissionVehicle, seq_on_wire: int, now: float) -> bool:
        """True if there is such an item; a vehicle that flies its mission goes there."""
        seq = seq_on_wire - self.first_seq
        if not 0 <= seq < len(v.lists.mission):
            return False
        if self.state == m.MISSION_STATE_COMPLETE:
            self.state = m.MISSION_STATE_ACTIVE if self._flies else m.MISSION_STATE_NOT_STARTED
        self.seq = seq
        self._jumps.clear()
        if self._flies:
            self._go(v, seq, now)
        return True

    def step(self, v: MissionVehicle, now: float) -> None:
        """Go on when the current item is done. To be called while the mission flies the vehicle, and it is armed."""
        if not self._flies or not v.plan.arrived or self._stays or self.state != m.MISSION_STATE_ACTIVE:
            return
        v.taking_off = False
        self.reached = self.seq
        if self.reports_each:
            self._report_reached(v)
            self._go(v, self.seq + 1, now)
            return
        self._go(v, self.seq + 1, now)
        self._report_reached(v)

    def _report_reached(self, v: MissionVehicle) -> None:
        v.tx.send("MISSION_ITEM_REACHED", {"seq": self.reached + self.first_seq})

    @property
    def landing(self) -> bool:
        """True while an item is flown that ends on the ground."""
        return self._flies and self._lands

    def _go(self, v: MissionVehicle, seq: int, now: float) -> None:
        """Find the next item that flies, from this one on, and fly it."""
        items = v.lists.mission
        self._flies = True
        self._stays = self._lands = False
        for _ in range(MAX_PASSED):
            if seq >= len(items):
                break
            item = items[seq]
            if item.moves or item.command in FLOWN_CONDITIONS:
                self.seq = seq
                v.send_soon("MISSION_CURRENT")
                self._fly(v, item, now)
                return
            seq = self._done(v, items, seq)
        self.state = m.MISSION_STATE_COMPLETE
        self.finish(v, now)

    def _done(self, v: MissionVehicle, items: Sequence[MissionItem], seq: int) -> int:
        """Do what this item says; the next one."""
        item = items[seq]
        p1, p2, _, _ = (value or 0.0 for value in item.params)
        if item.command == m.MAV_CMD_DO_JUMP:
            done = self._jumps.get(seq, 0)
            if p2 < 0 or done < p2:
                self._jumps[seq] = done + 1
                return max(0, int(p1) - self.first_seq)
            return seq + 1
        if item.command == m.MAV_CMD_DO_CHANGE_SPEED and p2 > 0:
            self.change_speed(v, p2)
        if self.reports_reached_items or self.reports_each:
            self.reached = seq
        if self.reports_each:
            self._report_reached(v)
        return seq + 1

    def _fly(self, v: MissionVehicle, item: MissionItem, now: float) -> None:
        # where the item lies; what has no height is flown at the present one
        here = v.estimated
        place = item.position
        east, north = (here.east_m, here.north_m) if place is None else v.where.to_local(*place)
        up = None if item.z is None else up_of(v, item.frame, item.z)
        if up is None or (item.frame == m.MAV_FRAME_MISSION):
            up = here.up_m
        hold_s = max(0.0, item.params[0] or 0.0)
        # on the ground it rises first, whatever the item is
        rise: list[Leg] = []
        if v.landed and item.command != m.MAV_CMD_NAV_LAND:
            v.taking_off = True
            rise.append(GoTo(here.east_m, here.north_m, up, climb_mps=self.takeoff_mps(v)))
        match item.command:
            case m.MAV_CMD_NAV_TAKEOFF if not v.landed:
                v.plan.fly(GoTo(here.east_m, here.north_m, max(up, here.up_m)), GoTo(east, north, max(up, here.up_m)))
            case m.MAV_CMD_NAV_RETURN_TO_LAUNCH:
                self._lands = True
                self.return_home(v, now)
            case m.MAV_CMD_NAV_LAND:
                self._lands = True
                v.plan.fly(GoTo(east, north, here.up_m), Land(east, north, self.land_mps(v)))
            case m.MAV_CMD_NAV_DELAY | m.MAV_CMD_CONDITION_DELAY:
                v.plan.fly(Wait(hold_s))
            case m.MAV_CMD_NAV_WAYPOINT | m.MAV_CMD_NAV_LOITER_TIME:
                v.plan.fly(*rise, GoTo(east, north, up), Wait(hold_s))
            case command:
                self._stays = command == m.MAV_CMD_NAV_LOITER_UNLIM
                v.plan.fly(*rise, GoTo(east, north, up))
