"""How closely a vehicle follows a target that moves: SET_POSITION_TARGET_* sent straight to it, simulated or real.

python -m support.followed_targets simulated|FIRMWARE [WAY...]      the table of docs/developers/control-figures.md
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from math import cos, hypot, pi, sin
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.sim.quad import SIH, Quad
from support.behaviour_flights import HEIGHT_M, PX4_OFFBOARD, Figures, Findings, end, get_ready, rules, take_off
from support.behaviour_rig import FirmwareRig, Rig, SimRig
from support.sim_pilot import FIELD

RADIUS_M, SPEED_MPS = 5.0, 2.0
PERIOD_S = 2 * pi * RADIUS_M / SPEED_MPS
LIMIT_S = 300.0
"""Most time by the station's clock for two circles, which the vehicle's clock times."""
EVERY_S = 0.2
"""Between two targets: 5 Hz, as `position` control sends them."""

POSITION, VELOCITY, ACCELERATION = 0b111, 0b111 << 3, 0b111 << 6
NOTHING = 0b0000_1101_1111_1111
"""Every bit of the type mask; a group that is sent takes its own out."""

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Way:
    """One way to send the circle."""

    groups: int
    lead_s: float = 0.0
    """The target is where the reference will be so much later."""
    as_global: bool = False
    """SET_POSITION_TARGET_GLOBAL_INT."""


WAYS: dict[str, Way] = {
    "position": Way(POSITION),
    "position, velocity": Way(POSITION | VELOCITY),
    "position, velocity, led by 0.1 s": Way(POSITION | VELOCITY, 0.1),
    "position, velocity, led by 0.25 s, global": Way(POSITION | VELOCITY, 0.25, as_global=True),
    "position, velocity, acceleration": Way(POSITION | VELOCITY | ACCELERATION),
    "position, velocity, acceleration, led by 0.1 s": Way(POSITION | VELOCITY | ACCELERATION, 0.1),
    "velocity": Way(VELOCITY),
    "velocity, acceleration": Way(VELOCITY | ACCELERATION),
}


def circle(t_s: float) -> tuple[Vector, Vector, Vector]:
    """Position, velocity and acceleration, east north up, from the place of the take-off, first north."""
    w = SPEED_MPS / RADIUS_M
    a = w * t_s
    return (
        (RADIUS_M * (1 - cos(a)), RADIUS_M * sin(a), HEIGHT_M),
        (SPEED_MPS * sin(a), SPEED_MPS * cos(a), 0.0),
        (SPEED_MPS * w * cos(a), -SPEED_MPS * w * sin(a), 0.0),
    )


def message(rig: Rig, way: Way, pos: Vector, vel: Vector, acc: Vector, yaw: float = 0.0) -> Any:
    """The target as the way sends it, the nose held at ``yaw``."""
    mask = NOTHING & ~way.groups & ~mav.POSITION_TARGET_TYPEMASK_YAW_IGNORE
    (e, n, u), (ve, vn, vu), (ae, an, au) = (pos[0] + rig.base[0], pos[1] + rig.base[1], pos[2]), vel, acc
    rest = (vn, ve, -vu, an, ae, -au, yaw, 0.0)
    if not way.as_global:
        return mav.MAVLink_set_position_target_local_ned_message(0, rig.sysid, 1, 1, mask, n, e, -u, *rest)
    lat, lon = FIELD.to_geodetic(e, n)
    where = (round(lat * 1e7), round(lon * 1e7), u)
    return mav.MAVLink_set_position_target_global_int_message(0, rig.sysid, 1, 6, mask, *where, *rest)


def be_airborne(rig: Rig) -> None:
    """Near its height: the height that a real PX4 believes wanders by half a metre and more."""
    rig.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_HOME_POSITION)
    rig.run(0.5)
    try:
        take_off(rig)
    except AssertionError:
        if rig.here.up_m < 0.8 * HEIGHT_M:
            raise


def follow(rig: Rig, way: Way, *, settle_s: float = PERIOD_S, laps: float = 1.0) -> list[float]:
    """Horizontal distances (m) from the reference over the last laps, by the vehicle's own position and clock."""
    be_airborne(rig)
    begin, sent_at = rig.time(), -1e9

    def target(t: float) -> Any:
        nonlocal sent_at
        if t - sent_at < EVERY_S - 1e-3:
            return None
        sent_at = t
        return message(rig, way, *circle(t + way.lead_s - begin))

    rig.stream = target
    rig.run(0.5)
    if rig.px4:
        assert rig.set_mode(PX4_OFFBOARD) == 0
    start = len(rig.track)
    rig.wait(lambda: rig.time() - begin >= settle_s + laps * PERIOD_S, LIMIT_S, "it has flown the circles")
    errors = []
    for sample in rig.track[start:]:
        if (t_s := sample.t_s - begin) > settle_s:
            (east, north, _), _, _ = circle(t_s)
            errors.append(hypot(sample.east_m - east, sample.north_m - north))
    end(rig)
    return errors


def rms(errors: list[float]) -> float:
    return (sum(error * error for error in errors) / len(errors)) ** 0.5


CIRCLES = ("position", "position, velocity", "position, velocity, acceleration")


def circles(rig: Rig) -> Figures:
    """RMS of the distance from the circle."""
    return {name: round(rms(follow(rig, WAYS[name])), 2) for name in CIRCLES}


def check_circles(rig: Rig, f: Figures, found: Findings) -> None:
    fact = rules(rig).circle_rms_m
    for name, wanted in (fact.simulated if isinstance(rig, SimRig) else fact.value).items():
        if abs(f[name] - wanted) > 0.25 * wanted + 0.1:
            found.append(f"circle, {name}: {f[name]} m, the table says {wanted:g}")


def table(rig: Rig, names: list[str], say: Callable[[str], None] = print) -> None:
    get_ready(rig)
    for name in names:
        way = WAYS[name]
        say(f"| {rig.firmware} | {name} | {rms(follow(rig, way)):.2f} |")


def simulated(firmware: str) -> SimRig:
    """A simulated vehicle with the body that the firmware's own simulator has, as far as it matters here."""
    rig = SimRig(firmware)
    if firmware == "px4" and isinstance(rig.vehicle.motion, Quad):
        rig.vehicle.motion.airframe = SIH
    return rig


if __name__ == "__main__":
    if sys.argv[1] == "simulated":
        for kind in ("ardupilot", "px4"):
            table(simulated(kind), sys.argv[2:] or list(WAYS))
    else:
        with TemporaryDirectory() as folder:
            real = FirmwareRig(sys.argv[1], Path(folder))
            try:
                table(real, sys.argv[2:] or list(WAYS), lambda line: print(line, flush=True))
            finally:
                real.close()
