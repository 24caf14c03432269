"""Orders to vehicles that are no copters, through a whole fleet: what is sent, or why nothing is.

A quadplane that hovered got LOITER of a fixed wing from hold and stop, knew no landing, and with Q_MAV_TYPE = 2 was
taken for a copter, whose "BRAKE" is QSTABILIZE: motors at idle.
"""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import Frame
from skygcs.runtime.fleet_orders import Order
from skygcs.runtime.vehicle_actor import VehicleActor
from support.vehicles import ARDUPILOT, Ground, ScriptedVehicle

pytestmark = pytest.mark.looptime

MODE = 176
QHOVER, QLOITER, QLAND, QRTL = 18, 19, 20, 21
HOLD, LOITER_BOAT = 4, 5
PLANE, QUADROTOR, ROVER, BOAT = 1, 2, 10, 11

ORDERS: dict[str, tuple[Order, dict[str, Any]]] = {
    "hold": (VehicleActor.hold, {}),
    "stop": (VehicleActor.stop, {"action": "hold"}),
    "land": (VehicleActor.land, {}),
    "rtl": (VehicleActor.rtl, {}),
    "takeoff": (VehicleActor.takeoff, {"height_m": 5.0}),
}


class Typed(ScriptedVehicle):
    """An ArduPilot of this MAV_TYPE, in this mode, with this banner."""

    def __init__(self, ground: Ground, kind: int, mode: int, banner: str) -> None:
        self.kind = kind
        super().__init__(ground, 1, ARDUPILOT, mode)
        self.armed, self.flying, self.status = True, kind in (PLANE, QUADROTOR), 4
        self.tell(self.say(mav.MAVLink_statustext_message(6, banner.encode())), 0.5)

    def beat(self, autopilot: int, mode: int, *, armed: bool = False, status: int = 3) -> Frame:
        base_mode = 0x81 if armed else 0x01
        return self.say(mav.MAVLink_heartbeat_message(self.kind, autopilot, base_mode, mode, status, 3))


@pytest.mark.parametrize(
    ("kind", "banner", "mode", "wanted"),
    [
        (PLANE, "ArduPlane V4.6.3", QHOVER, {"hold": QLOITER, "stop": QLOITER, "land": QLAND, "rtl": QRTL}),
        (QUADROTOR, "ArduPlane V4.6.3", QLOITER, {"hold": QLOITER, "stop": QLOITER, "land": QLAND, "rtl": QRTL}),
        (ROVER, "ArduRover V4.6.3", 10, {"hold": HOLD, "stop": HOLD, "land": "does not land", "rtl": 11}),
        (BOAT, "ArduRover V4.6.3", 10, {"hold": LOITER_BOAT, "stop": HOLD, "land": "does not land", "rtl": 11}),
    ],
    ids=["hovering quadplane", "quadplane that shows a quadrotor", "rover", "boat"],
)
async def test_each_order_does_its_own_thing_or_says_why_not(
    kind: int, banner: str, mode: int, wanted: dict[str, int | str]
) -> None:
    for name, want in {**wanted, "takeoff": "refused"}.items():
        async with Ground() as ground:
            vehicle = Typed(ground, kind, mode, banner)
            await ground.met(vehicle)
            await asyncio.sleep(3)
            before = len(vehicle.got)
            order, arguments = ORDERS[name]
            (outcome,) = (await ground.fleet.orders.command_all("all", order, **arguments)).values()
            sent = [
                s
                for s in vehicle.got[before:]
                if s.name.startswith("COMMAND_") and s.command in (MODE, 20, 21, 22, 192)
            ]
            if isinstance(want, str):
                assert outcome.result == "refused" and want in outcome.message and sent == [], (name, outcome)
            elif sent and sent[0].command == MODE:
                assert sent[0].param2 == want, (name, outcome, sent)
            else:
                assert [s.command for s in sent[:1]] == [20] and name == "rtl", (name, outcome, sent)
