"""The law flies both simulated autopilots through their messages alone: telemetry down, attitudes up."""

from __future__ import annotations

from math import dist

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.control import ControlConfig, Estimate, Memory, Reference, step
from skygcs.sim.ardupilot import CopterVehicle
from skygcs.sim.conditions import Conditions, conditions_of
from skygcs.sim.px4 import Px4Vehicle
from skygcs.sim.rng import Rng
from support.examples import thinned
from support.sim_pilot import FIELD, Pilot, sim_dialect
from support.table import each

DT = 0.02
LOCAL_POSITION_NED = 32
TARGET = (3.0, 2.0, 12.0)
STILL = conditions_of()
WINDY = conditions_of(wind_mps=5.0, wind_from_deg=300.0)
IDEAL_AIR = conditions_of(airframe="ideal")


def hovering(kind: type[Px4Vehicle] | type[CopterVehicle], conditions: Conditions) -> Pilot:
    pilot = Pilot(kind(sim_dialect(), 1, FIELD, rng=Rng(1), conditions=conditions))
    pilot.get_ready()
    if kind is CopterVehicle:
        pilot.vehicles[0].params.set("GUID_OPTIONS", 8)
    pilot.take_off(10.0)
    assert pilot.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, LOCAL_POSITION_NED, DT * 1e6) == 0
    pilot.run(0.1, DT)
    pilot.forget()
    return pilot


def fly(pilot: Pilot, seconds: float) -> list[tuple[float, float, float]]:
    """Under the law, from what was told to what is sent; OFFBOARD on a PX4 as soon as its stream has lasted."""
    config, memory = ControlConfig(), Memory()
    track = []
    offboard = isinstance(pilot.vehicles[0], Px4Vehicle)
    for i in range(round(seconds / DT)):
        pilot.run(DT, DT)
        ned = pilot.heard[-1]
        while ned.get_type() != "LOCAL_POSITION_NED":
            pilot.heard.pop()
            ned = pilot.heard[-1]
        pilot.heard[:-1] = []
        estimate = Estimate((ned.y, ned.x, -ned.z), (ned.vy, ned.vx, -ned.vz))
        follows = not offboard or i > 60
        output, memory = step(config, memory, estimate, Reference(TARGET, 0.5), DT, following=follows)
        assert output is not None
        q, thrust = list(output.attitude_ned_frd), output.collective_thrust
        pilot.send(mav.MAVLink_set_attitude_target_message(0, 1, 1, 7, q, 0.0, 0.0, 0.0, thrust))
        pilot.heard.append(ned)
        if offboard and i == 60:
            assert pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, 6, 0) == 0
            pilot.heard.append(ned)
        track.append(pilot.vehicles[0].motion.pos_enu_m)
    return track


@each(
    ("kind", "conditions"),
    thinned([(kind, air) for air in (WINDY, STILL, IDEAL_AIR) for kind in (Px4Vehicle, CopterVehicle)], 2),
)
def test_the_law_brings_it_to_the_reference(
    kind: type[Px4Vehicle] | type[CopterVehicle], conditions: Conditions
) -> None:
    pilot = hovering(kind, conditions)
    track = fly(pilot, 40.0)
    assert max(dist(p, TARGET) for p in track[-250:]) < 0.1, "steady"
    assert max(p[0] for p in track) < TARGET[0] * 1.35
    assert pilot.vehicles[0].motion.yaw_rad == pytest.approx(1.5708 - 0.5, abs=0.01)
