"""Vehicles made of frames, for the monitor: where each is, how it moves and in what mode it says it is."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.mavlink.frame import Frame, encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.monitor.monitor import HoldRequest, Monitor
from skygcs.core.monitor.tracks import Member
from skygcs.core.separation import Footprint
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.runtime.fleet import Fleet
from support.vehicles import flight_dialect

ORIGIN = Origin(43.7806, -79.4653, 180.0)
GUIDED, LOITER, RTL, LAND = 4, 5, 6, 9
"""Of ArduCopter."""

STANDBY, ACTIVE, CRITICAL = 3, 4, 5
ON_GROUND, IN_AIR = 1, 2


class WatchedVehicle:
    """An ArduCopter that says what the test wants."""

    def __init__(self, sysid: int, name: str | None = None, **footprint: float) -> None:
        self.dialect = flight_dialect()
        self.vehicle = Vehicle(sysid, 1, self.dialect, name=name or f"v{sysid}")
        self.footprint = Footprint(**footprint)
        self.priority = 0
        self.destination: tuple[float, float, float] | None = None
        self.trajectory: list[tuple[float, float, float]] = []
        self._parser = FrameParser(self.dialect)
        self._frame = EnuFrame(ORIGIN)
        self._seq = 0

    @property
    def member(self) -> Member:
        return Member(self.vehicle, self.footprint, self.priority, self.destination, self.trajectory)

    def geodetic_of(self, *place_m: float) -> tuple[float, float, float]:
        """lat_deg, lon_deg, alt_amsl_m of a place east, north, up of ORIGIN."""
        return self._frame.to_geodetic(*place_m)

    def heartbeat(
        self, now: float, *, armed: bool = True, mode: int = GUIDED, status: int = ACTIVE, kind: int = 2
    ) -> None:
        base_mode = 1 | (0x80 if armed else 0)
        values = {"type": kind, "autopilot": 3, "base_mode": base_mode, "custom_mode": mode, "system_status": status}
        self.send("HEARTBEAT", now, **values, mavlink_version=3)
        landed = IN_AIR if armed and status != STANDBY else ON_GROUND
        self.send("EXTENDED_SYS_STATE", now, vtol_state=0, landed_state=landed)

    def position(self, now: float, at_m: Sequence[float], vel_mps: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """East, north, up about ORIGIN."""
        lat_deg, lon_deg, alt_m = self._frame.to_geodetic(*at_m)
        self.geodetic(now, lat_deg, lon_deg, alt_m, vel_mps, at_m[2])

    def geodetic(
        self, now: float, lat_deg: float, lon_deg: float, alt_m: float, vel_mps: Sequence[float], rel_m: float = 10.0
    ) -> None:
        self.send(
            "GLOBAL_POSITION_INT",
            now,
            time_boot_ms=int(now * 1000),
            lat=round(lat_deg * 1e7),
            lon=round(lon_deg * 1e7),
            alt=round(alt_m * 1000),
            relative_alt=round(rel_m * 1000),
            vx=round(vel_mps[1] * 100),
            vy=round(vel_mps[0] * 100),
            vz=round(-vel_mps[2] * 100),
            hdg=0,
        )

    def send(self, name: str, now: float, **values: Any) -> None:
        self._seq += 1
        info = self.dialect.by_name[name]
        raw = encode(info, values, sysid=self.vehicle.sysid, compid=1, seq=self._seq & 0xFF)
        for frame in self._parser.feed_datagram(raw):
            self.hear(frame, now)

    def hear(self, frame: Frame, now: float) -> None:
        self.vehicle.on_frame(frame, now)


class VehicleOfFleet(WatchedVehicle):
    """Its frames go to the fleet."""

    def __init__(self, sysid: int, fleet: Fleet) -> None:
        super().__init__(sysid)
        self._fleet = fleet

    def hear(self, frame: Frame, now: float) -> None:
        self._fleet.on_frame(frame.sysid << 8 | frame.compid, frame, "air", now)


STEP_S = 0.25
Where = Callable[[float], tuple[Sequence[float], Sequence[float]]]
"""Position and velocity by time; a vehicle that is silent gives none."""


class Watched:
    """A monitor and its fleet, in steps of `STEP_S`."""

    def __init__(self, *fleet: WatchedVehicle, acting: bool = False) -> None:
        self.fleet = list(fleet)
        self.monitor = Monitor(acting=acting)
        self.now = 1000.0
        self.begun = self.now
        self.events: list[tuple[float, Event]] = []
        self.holds: list[tuple[float, HoldRequest]] = []
        self.modes: dict[int, int] = {}
        self.armed: dict[int, bool] = {}
        self.status: dict[int, int] = {}

    def run(self, seconds: float, *motions: Where | None) -> None:
        """Each vehicle moves so; None: it is silent."""
        for _ in range(round(seconds / STEP_S)):
            for vehicle, motion in itertools.zip_longest(self.fleet, motions):
                if motion is not None:
                    sysid = vehicle.vehicle.sysid
                    armed = self.armed.get(sysid, True)
                    status = self.status.get(sysid, ACTIVE if armed else STANDBY)
                    vehicle.heartbeat(self.now, armed=armed, mode=self.modes.get(sysid, GUIDED), status=status)
                    vehicle.position(self.now, *motion(self.now - self.begun))
                vehicle.vehicle.tick(self.now)
            self.look()
            self.now += STEP_S

    def look(self) -> None:
        for _ in self.monitor.evaluate([v.member for v in self.fleet], self.now):
            pass
        self.events += [(self.now - self.begun, event) for event in self.monitor.events]
        self.holds += [(self.now - self.begun, hold) for hold in self.monitor.holds]
        self.monitor.events, self.monitor.holds = [], []

    def levels(self) -> list[str]:
        return [event.data["level"] for _, event in self.events if "level" in event.data]

    def first(self, level: str) -> float:
        return next(at for at, event in self.events if event.data.get("level") == level)


def standing(*place: float) -> Where:
    return lambda at: (place, (0.0, 0.0, 0.0))


def flying(place: Sequence[float], velocity: Sequence[float]) -> Where:
    return lambda at: ([p + v * at for p, v in zip(place, velocity, strict=True)], velocity)
