"""Faults of a drill: begun and ended by name in one simulated vehicle, while it flies. Pure.

fault      while it lasts
--------   ------------------------------------------------------------------------------------------------------
deaf       nothing that is sent to the vehicle arrives; it goes on sending
link       nothing arrives in either direction
gps        its GPS has no fix
battery    its charge fell to a value, and goes on falling; at the end it has back what it had lost by the fault
wind       the wind blows with a value, from the west; only for vehicles with a body (dynamics = "rigid")
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from skygcs.sim.body import Vector
from skygcs.sim.conditions import wind_enu
from skygcs.sim.quad import Quad
from skygcs.sim.vehicle import SimVehicle

FaultName = Literal["deaf", "link", "gps", "battery", "wind"]

WIND_FROM_DEG = 270.0


@dataclass(frozen=True, slots=True)
class FaultKind:
    """``text``: how it is called before people. ``unit`` of its value, and the default; None: it has none."""

    text: str
    unit: str | None = None
    default: float | None = None
    least: float = 0.0
    most: float = 0.0


FAULTS: dict[FaultName, FaultKind] = {
    "deaf": FaultKind("deaf"),
    "link": FaultKind("link cut"),
    "gps": FaultKind("GPS lost"),
    "battery": FaultKind("battery low", "%", 8.0, 0.0, 100.0),
    "wind": FaultKind("wind", "m/s", 8.0, 0.0, 20.0),
}


class ActiveFault(NamedTuple):
    """``begun_at``: on the clock of the caller."""

    fault: FaultName
    value: float | None
    begun_at: float


class VehicleDrill:
    """The faults of one vehicle that a drill has begun."""

    def __init__(self, vehicle: SimVehicle) -> None:
        self.vehicle = vehicle
        self.active: dict[FaultName, ActiveFault] = {}
        self._lost_mah = 0.0
        """Charge that the fault of the battery took at its begin."""
        self._wind_before: Vector = (0.0, 0.0, 0.0)

    def begin(self, fault: FaultName, value: float | None, now: float) -> ActiveFault:
        """Begin a fault, or give one that lasts another value. Raises ValueError, in words for a person, for a value
        that it does not take, and for a vehicle that cannot have it."""
        kind = FAULTS[fault]
        if kind.default is None and value is not None:
            raise ValueError(f"{kind.text} has no value")
        if kind.default is not None:
            value = kind.default if value is None else value
            if not kind.least <= value <= kind.most:
                raise ValueError(f"{kind.text}: {kind.least:g} to {kind.most:g} {kind.unit}, not {value:g}")
        if fault == "wind" and not isinstance(self.vehicle.motion, Quad):
            raise ValueError('no wind moves it: its link has dynamics = "kinematic"')
        if fault in self.active:
            self.end(fault)
        self.active[fault] = begun = ActiveFault(fault, value, now)
        self._put(fault, value)
        return begun

    def end(self, fault: FaultName) -> bool:
        """End a fault; False: it was not begun."""
        if self.active.pop(fault, None) is None:
            return False
        self._take_back(fault)
        return True

    def _put(self, fault: FaultName, value: float | None) -> None:
        vehicle = self.vehicle
        if fault == "battery" and value is not None:
            before_mah = vehicle.battery.used_mah
            vehicle.battery.set_percent(value)
            self._lost_mah = vehicle.battery.used_mah - before_mah
        elif fault == "wind" and value is not None and isinstance(vehicle.motion, Quad):
            self._wind_before = vehicle.motion.wind.mean_enu_mps
            vehicle.motion.wind.mean_enu_mps = wind_enu(value, WIND_FROM_DEG)
        else:
            self._set_flags()

    def _take_back(self, fault: FaultName) -> None:
        vehicle = self.vehicle
        if fault == "battery":
            vehicle.battery.used_mah = max(0.0, vehicle.battery.used_mah - self._lost_mah)
        elif fault == "wind" and isinstance(vehicle.motion, Quad):
            vehicle.motion.wind.mean_enu_mps = self._wind_before
        else:
            self._set_flags()

    def _set_flags(self) -> None:
        """Two faults may want the same flag: each holds while one of them lasts."""
        faults = self.vehicle.faults
        faults.gps_lost = "gps" in self.active
        faults.mute = "link" in self.active
        faults.deaf = "deaf" in self.active or "link" in self.active
