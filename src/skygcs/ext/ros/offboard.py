"""OFFBOARD and GUIDED as MAVROS' users engage them, by skygcs' own control. Pure.

    state        event                                             next, and what is to be done
    ---------    -----------------------------------------------   ------------------------------------------------
    idle         set_mode OFFBOARD, setpoints come                 wished
    idle         set_mode OFFBOARD, none came for SETPOINT_S       idle; refused, as PX4 does
    wished       setpoints stop for SETPOINT_S                     idle: a node that stops, stops
    idle,        a PX4's offboard_control_mode comes               as if a setpoint did: PX4's own example sends its
    wished                                                         first setpoint once OFFBOARD is shown
    wished       armed on the ground, a setpoint CLIMB_M above     wished; take off to its height, once
    wished       in the air, not under control                     engaging: control.set in the setpoints' mode
    engaging     control is engaged                                flying
    engaging     it is refused                                     wished, again after AGAIN_S; idle after ATTEMPTS
    flying       setpoints of another mode                         flying: control.set in that mode
    flying       control has ended: a person, the guard, an order  idle: a new set_mode is needed
    idle         set_mode GUIDED of an ArduPilot                   wished, without end; it takes off by cmd/takeoff
    any          set_mode to another mode, disarmed                idle

While it is wished or flown, the topic state shows OFFBOARD: nodes wait for it before they arm. On the ground the
autopilot is in its own mode meanwhile, because skygcs flies no vehicle by setpoints off the ground.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from skygcs.core.ros.setpoints import ControlMode, Demand

SETPOINT_S = 0.5
"""PX4's offboard proof asks for more than 2 setpoints a second; the validity of one here."""

CLIMB_M = 0.5
"""A setpoint that is no higher above where the vehicle stands is no take-off."""

SEEN_S = 2.0
"""A vehicle's state is sent five times a second: control that was engaged is in it by then."""

AGAIN_S = 2.0
ATTEMPTS = 5

OFFBOARD_MODES = frozenset({"OFFBOARD", "GUIDED"})
"""Modes that are flown by skygcs' control."""

UNDER_CONTROL = frozenset({"engaging", "flying"})


@dataclass(frozen=True, slots=True)
class TakeOff:
    """Take off to a height above the ground."""

    height_m: float | None


@dataclass(frozen=True, slots=True)
class Engage:
    """control.set in this mode."""

    mode: ControlMode


class Offboard:
    """OFFBOARD of one vehicle. `on_demand` with each setpoint, `next_step` a few times a second and after a state."""

    def __init__(self) -> None:
        self.state: Literal["idle", "wished", "engaging", "flying"] = "idle"
        self.shown_mode = ""
        """Mode that the topic state shows in place of the autopilot's; "": the autopilot's own."""
        self._demand: Demand | None = None
        self._demand_at = -math.inf
        self._proof_at = -math.inf
        """When a node last showed that it lives, beside its setpoints."""
        self._took_off = False
        self._attempts = 0
        self._again_at = -math.inf
        self._engaged_mode: ControlMode | None = None
        self._was_armed = False
        self._engaged_at = -math.inf
        self._patient = False
        """GUIDED: it waits for setpoints."""

    def on_demand(self, demand: Demand, now: float) -> None:
        """Take in a setpoint."""
        self._demand, self._demand_at = demand, now

    def on_proof(self, now: float) -> None:
        """Take in an offboard_control_mode."""
        self._proof_at = now

    def wish_guided(self) -> None:
        """set_mode to GUIDED of an ArduPilot, which has it itself: it needs no setpoints, and takes off by an order."""
        self.end()
        self.state, self._attempts, self._again_at, self._was_armed, self._patient = "wished", 0, -math.inf, False, True

    def wish(self, mode: str, now: float) -> str | None:
        """set_mode to OFFBOARD. Why it is refused; None: it is not."""
        if now - max(self._demand_at, self._proof_at) > SETPOINT_S:
            return f"no setpoint came in the last {SETPOINT_S} s: stream them before {mode}"
        if self.state == "idle":
            self.state, self._took_off, self._attempts, self._again_at = "wished", False, 0, -math.inf
            self._was_armed = False
        self._patient = False
        self.shown_mode = mode
        return None

    def end(self) -> None:
        """Another mode, or another order."""
        self.state, self.shown_mode = "idle", ""

    def next_step(self, vehicle: Mapping[str, Any], now: float) -> TakeOff | Engage | None:
        """Return what is to be done now, by the vehicle's state as the daemon sends it; answer `Engage` by
        `on_engaged`."""
        demand = self._demand
        if self.state == "idle":
            return None
        controlled = (vehicle.get("control") or {}).get("state") in UNDER_CONTROL
        armed = bool(vehicle.get("armed"))
        if self._was_armed and not armed:
            self.end()
            return None
        self._was_armed = armed
        if self.state == "flying" and demand is not None:
            if not controlled and now - self._engaged_at > SEEN_S:
                self.end()
            elif demand.mode != self._engaged_mode and now >= self._again_at:
                return self._engage(demand.mode, now)
            return None
        if self.state == "engaging":
            return None
        if demand is None or now - self._demand_at > SETPOINT_S:
            if not self._patient and now - self._proof_at > SETPOINT_S:
                self.end()
            return None
        if not armed:
            return None
        if vehicle.get("landed") in ("on_ground", "undefined"):
            return None if self._patient else self._take_off(demand, vehicle)
        return self._engage(demand.mode, now) if now >= self._again_at else None

    def on_engaged(self, mode: ControlMode, ok: bool, now: float) -> bool:
        """How `Engage` ended. False: it is given up."""
        if self.state != "engaging":
            return True
        if ok:
            self.state, self._engaged_mode, self._attempts, self._engaged_at = "flying", mode, 0, now
            return True
        self._attempts += 1
        self._again_at = now + AGAIN_S
        self.state = "wished"
        if self._attempts >= ATTEMPTS:
            self.end()
            return False
        return True

    def _engage(self, mode: ControlMode, now: float) -> Engage:
        self.state = "engaging"
        self._again_at = now + AGAIN_S
        return Engage(mode)

    def _take_off(self, demand: Demand, vehicle: Mapping[str, Any]) -> TakeOff | None:
        if self._took_off:
            return None
        if demand.mode == "velocity":
            up = demand.params["vel_enu_mps"][2]
            if up is None or up <= 0:
                return None
            self._took_off = True
            return TakeOff(None)
        local = vehicle.get("local")
        if demand.climbs_m is None or local is None:
            return None
        height_m = demand.climbs_m - local["pos_enu_m"][2]
        if height_m < CLIMB_M:
            return None
        self._took_off = True
        return TakeOff(height_m)
