"""Several simulated vehicles together: on one link, or all on the same radio."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import cos, radians, sin

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.sim.ardupilot import CopterVehicle
from skygcs.sim.conditions import CALM, Conditions
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.param_set import ParamSet
from skygcs.sim.plane import PlaneVehicle
from skygcs.sim.px4 import Px4Vehicle
from skygcs.sim.px4_plane import Px4PlaneVehicle
from skygcs.sim.rng import Rng
from skygcs.sim.rover import RoverVehicle
from skygcs.sim.vehicle import SimVehicle

SPACING_M = 5.0
"""Between neighbours on the ground: two F450s need 3 m."""

ROW = 5


class SimFleet:
    """Vehicles that hear the same frames and answer on the same channel."""

    def __init__(self, vehicles: list[SimVehicle]) -> None:
        self.vehicles = vehicles

    def on_frame(self, frame: Frame, now: float) -> None:
        for vehicle in self.vehicles:
            vehicle.on_frame(frame, now)

    def skip_to(self, at: float) -> None:
        """See `SimVehicle.skip_to`."""
        for vehicle in self.vehicles:
            vehicle.skip_to(at)

    def step(self, now: float) -> list[bytes]:
        """The frames of all of them until ``now``, vehicle by vehicle."""
        return [raw for vehicle in self.vehicles for raw in vehicle.step(now)]


KINDS: Mapping[str, type[SimVehicle]] = {
    "px4": Px4Vehicle,
    "ardupilot": CopterVehicle,
    "px4_plane": Px4PlaneVehicle,
    "ardupilot_plane": PlaneVehicle,
    "rover": RoverVehicle,
}
"""By the names that fleet files and the command line use, in the order of their system ids."""


def make_vehicles(  # noqa: PLR0913 - each is a key of the fleet file or an option of `skygcs sim`
    dialect: Dialect,
    *,
    first_sysid: int,
    home: LocalFrame,
    px4: int = 0,
    ardupilot: int = 0,
    px4_plane: int = 0,
    ardupilot_plane: int = 0,
    rover: int = 0,
    heading_deg: float = 0.0,
    seed: int = 1,
    now: float = 0.0,
    unix_us: int = 0,
    conditions: Conditions = CALM,
    params: Iterable[ParamSet] = (),
) -> list[SimVehicle]:
    """Vehicles of `KINDS`, in that order, sysids from ``first_sysid`` on, in rows of five SPACING_M apart about
    ``home``. ``params``: each for the vehicles of its firmware, a later one over an earlier.

    Raises ValueError if the last sysid would be above 255.
    """
    # the ids must fit
    counts = {"px4": px4, "ardupilot": ardupilot, "px4_plane": px4_plane}
    counts |= {"ardupilot_plane": ardupilot_plane, "rover": rover}
    kinds = [KINDS[name] for name in KINDS for _ in range(counts[name])]
    if first_sysid < 1 or first_sysid + len(kinds) - 1 > 255:
        raise ValueError(f"{len(kinds)} vehicles from system id {first_sysid} on do not fit in 1..255")
    vehicles: list[SimVehicle] = []
    params = tuple(params)
    for i, kind in enumerate(kinds):
        # place in the rows, turned with the heading
        right, back = SPACING_M * (i % ROW), SPACING_M * (i // ROW)
        turn = radians(heading_deg)
        east, north = right * cos(turn) - back * sin(turn), -right * sin(turn) - back * cos(turn)
        lat, lon = home.to_geodetic(east, north)
        # make the vehicle, with its parameters
        vehicle = kind(
            dialect,
            first_sysid + i,
            LocalFrame(lat, lon, home.alt_amsl_m),
            rng=Rng(seed * 1000 + i),
            now=now,
            unix_us=unix_us,
            heading_deg=heading_deg,
            conditions=conditions,
        )
        family = "px4" if issubclass(kind, Px4Vehicle) else "ardupilot"
        vehicle.begin_with(s.params for s in params if s.family == family)
        vehicles.append(vehicle)
    return vehicles
