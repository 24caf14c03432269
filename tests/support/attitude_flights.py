"""SET_ATTITUDE_TARGET in every combination of what it ignores, flown on the simulator and on real firmware alike.

python -m support.attitude_flights simulated|FIRMWARE      the figures of both, or of a real firmware
"""

from __future__ import annotations

import sys
from math import cos, nan, sin
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.sim.quad import Quad
from support.behaviour_flights import PX4_OFFBOARD, Figures, Findings, end, get_ready, rules
from support.behaviour_rig import FirmwareRig, Rig, SimRig
from support.followed_targets import be_airborne, simulated

RATES_IGNORED, THRUST_IGNORED, ATTITUDE_IGNORED = 0b111, 64, 128
LEAN_RAD = -0.1
"""Nose down, slowly forward."""

KIND_S = 0.7
"""From one kind of setpoint to another within OFFBOARD: PX4 publishes which controllers run with its status, twice a
second unless that changes (Commander.cpp: run, updateControlMode). Until then the attitude before is flown on, level:
rates of half a second rolled 0, 0.04 or 0.12 by chance."""


def quaternion(pitch_rad: float, size: float = 1.0) -> list[float]:
    return [size * cos(pitch_rad / 2), 0.0, size * sin(pitch_rad / 2), 0.0]


def hover_thrust(rig: Rig) -> float:
    """An ArduCopter takes half for no climb, and the PX4 that its own simulator flies hovers at about half."""
    if rig.px4 and isinstance(rig, SimRig) and isinstance(rig.vehicle.motion, Quad):
        body = rig.vehicle.motion
        return body.airframe.hover_thrust * (body.airframe.nominal_v / body.supply_v) ** 2
    return 0.5


def send(
    rig: Rig,
    seconds: float,
    mask: int,
    *,
    pitch: float = 0.0,
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
    thrust: float | None = None,
    size: float = 1.0,
) -> Any:
    """This target at 20 Hz for so long, at hover; the ATTITUDE heard last."""
    thrust = hover_thrust(rig) if thrust is None else thrust
    message = mav.MAVLink_set_attitude_target_message(0, rig.sysid, 1, mask, quaternion(pitch, size), *rates, thrust)
    rig.stream = lambda t: message
    rig.run(seconds)
    return rig.heard["ATTITUDE"]


def begin(rig: Rig) -> None:
    """In the air, flown level by attitudes."""
    rig.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, mav.MAVLINK_MSG_ID_ATTITUDE, 5e4)
    be_airborne(rig)
    send(rig, 0.5, RATES_IGNORED)
    if rig.px4:
        assert rig.set_mode(PX4_OFFBOARD) == 0
        rig.wait(lambda: rig.mode == PX4_OFFBOARD, 5, "it is in OFFBOARD")
    send(rig, 0.5, RATES_IGNORED)


def word(rig: Rig, seconds: float, mask: int, **fields: Any) -> str:
    """What it does with an attitude that leans: flies it, passes it over, or falls without thrust."""
    send(rig, KIND_S, RATES_IGNORED)
    up = rig.here.up_m
    pitch = send(rig, seconds, mask, pitch=LEAN_RAD, **fields).pitch
    sank = up - rig.here.up_m
    if sank > 1.0:
        send(rig, 2.0, RATES_IGNORED, thrust=0.7)
        return "without thrust"
    if pitch > 0.04:
        return "stops"
    return "flown" if abs(pitch - LEAN_RAD) < 0.04 else "passed over" if abs(pitch) < 0.04 else f"pitch {pitch:.2f}"


def attitude_targets(rig: Rig) -> Figures:
    begin(rig)
    figures: Figures = {}
    send(rig, KIND_S, ATTITUDE_IGNORED)
    send(rig, 0.5, ATTITUDE_IGNORED, rates=(0.3, 0.0, 0.0))
    figures["rates alone, roll of .15"] = round(send(rig, 0.5, ATTITUDE_IGNORED).roll, 2)
    figures["attitude and rates"] = word(rig, 0.8, 0)
    figures["attitude and one rate of three"] = word(rig, 0.8, 0b011)
    figures["thrust ignored"] = word(rig, 0.7, RATES_IGNORED | THRUST_IGNORED)
    figures["quaternion of length 1.01"] = word(rig, 0.8, RATES_IGNORED, size=1.01)
    before = send(rig, 0.8, RATES_IGNORED, pitch=LEAN_RAD).pitch
    after = send(rig, 0.7, ATTITUDE_IGNORED | RATES_IGNORED).pitch
    figures["nothing but thrust"] = "as it leans" if abs(after - before) < 0.03 else f"pitch {after:.2f}"
    rig.run(0.8)
    figures["nothing but thrust, mode changed"] = rig.px4 and rig.mode != PX4_OFFBOARD
    end(rig)
    return figures


def check_attitude_targets(rig: Rig, f: Figures, found: Findings) -> None:
    found.share("rates alone, roll", f["rates alone, roll of .15"], 0.15, 1.6)  # in steps, and no attitude to return to
    found.same("nothing but thrust", f["nothing but thrust"], "as it leans")
    found.same("mode changed", f["nothing but thrust, mode changed"], rig.px4)
    for what, wanted in rules(rig).attitude_targets.value.items():
        found.same(what, f[what], wanted)


def not_a_number(rig: Rig) -> Figures:
    """By itself: a real PX4 falls, and ArduCopter's own simulator ends with a floating point exception."""
    begin(rig)
    send(rig, 0.5, RATES_IGNORED)
    up = rig.here.up_m
    heard = send(rig, 1.5, RATES_IGNORED, pitch=nan)
    figures: Figures = {
        "NaN: roll, pitch": (round(heard.roll, 2), round(heard.pitch, 2)),
        "sank m": round(up - rig.here.up_m, 1),
        "mode changed": rig.px4 and rig.mode != PX4_OFFBOARD,
    }
    end(rig)
    begin(rig)
    up = rig.here.up_m
    send(rig, 0.7, RATES_IGNORED, thrust=nan)
    figures["NaN thrust: sank m"] = round(up - rig.here.up_m, 1)
    end(rig)
    return figures


def report(rig: Rig) -> None:
    get_ready(rig)
    for flight in (attitude_targets, not_a_number):
        for name, value in flight(rig).items():
            print(f"{rig.firmware}: {name}: {value}", flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "simulated":
        for kind in ("ardupilot", "px4"):
            report(simulated(kind))
    else:
        with TemporaryDirectory() as folder:
            real = FirmwareRig(sys.argv[1], Path(folder))
            try:
                report(real)
            finally:
                real.close()
