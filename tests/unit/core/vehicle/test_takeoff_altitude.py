"""How high the ground is that a vehicle took off from, as far as anybody saw it stand there."""

from __future__ import annotations

from typing import Any

import pytest

from skygcs.core.geo import Origin
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.snapshot import take_snapshot
from skygcs.core.vehicle.vehicle import Vehicle
from support.table import each
from support.vehicles import ARDUPILOT, HOME, PX4, Voice, flight_dialect

DECODER = Decoder(flight_dialect())
ON_GROUND, IN_AIR = 1, 2


class Watched:
    """A vehicle that is heard once a second, with the ground at HOME's altitude plus ``hill_m``."""

    def __init__(self, autopilot: int = PX4) -> None:
        self.vehicle, self.voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
        self.autopilot = autopilot
        self.now = 0.0

    def hear(
        self,
        seconds: int = 3,
        *,
        armed: bool = False,
        landed: int | None = ON_GROUND,
        up_m: float = 0.0,
        climb_mps: float = 0.0,
        position: bool = True,
    ) -> None:
        for _ in range(seconds):
            self.now += 1.0
            frames = [self.voice.beat(self.autopilot, armed=armed, status=4 if armed else 3)]
            if landed is not None:
                frames.append(self.voice.landed(landed))
            if position:
                velocity = (0, 0, round(-100 * climb_mps))
                boot_ms = round(self.now * 1000) + 60_000
                amsl_m = HOME[2] + up_m
                frames.append(self.voice.position(alt_amsl_m=amsl_m, rel_m=9.0, velocity=velocity, boot_ms=boot_ms))
            for frame in frames:
                self.vehicle.on_frame(frame, self.now)
            self.vehicle.tick(self.now)

    @property
    def position(self) -> Any:
        return take_snapshot(self.vehicle, self.now)["position"]


Heard = dict[str, Any]
STANDS: Heard = {}
FLIES: Heard = {"armed": True, "landed": IN_AIR, "up_m": 12.0}
SILENT: Heard = {"landed": None}


@each(
    ("autopilot", "heard", "ground_m"),
    [
        # where it stood when it armed, though it climbs already
        (PX4, [STANDS, {"seconds": 1, "armed": True, "up_m": 0.2, "climb_mps": 1.0}, FLIES], 0.0),
        # without a landed state it stands while it is disarmed
        (PX4, [SILENT, {**FLIES, **SILENT}], 0.0),
        (PX4, [STANDS], None),
        (PX4, [FLIES], None),
        # met armed on the ground; in a climb that the landed state does not show yet
        (ARDUPILOT, [{"armed": True}, FLIES], 0.0),
        (PX4, [{"seconds": 1, "armed": True, "up_m": 3.0, "climb_mps": 1.5}, FLIES], None),
        # a landing elsewhere without disarming is the next take-off; after one it is kept until it arms again
        (PX4, [STANDS, FLIES, {"armed": True, "up_m": 5.0}, FLIES], 5.0),
        (PX4, [STANDS, FLIES, {"up_m": 5.0}], 0.0),
        (PX4, [STANDS, FLIES, {"up_m": 5.0}, {"armed": True, "up_m": 5.0}], 5.0),
        # no position: none until one comes
        (PX4, [{"position": False}, {"armed": True, "position": False}], None),
        (PX4, [{"position": False}, {"armed": True, "position": False}, {"armed": True}], 0.0),
    ],
)
def test_the_ground_is_where_it_was_seen_to_stand_when_it_armed(
    autopilot: int, heard: list[Heard], ground_m: float | None
) -> None:
    seen = Watched(autopilot)
    for what in heard:
        seen.hear(**what)
    assert seen.vehicle.takeoff.alt_amsl_m == (None if ground_m is None else pytest.approx(HOME[2] + ground_m))
    if (position := seen.position) is not None:
        up_m = heard[-1].get("up_m", 0.0)
        above_m = None if ground_m is None else pytest.approx(up_m - ground_m)
        assert position["takeoff_alt_amsl_m"] == seen.vehicle.takeoff.alt_amsl_m
        assert position["alt_takeoff_m"] == above_m


def test_armed_while_it_was_lost_is_not_where_it_was_last_seen() -> None:
    seen = Watched()
    seen.hear()
    seen.now += 60.0
    seen.vehicle.tick(seen.now)
    assert not seen.vehicle.connected
    seen.hear(3, armed=True, landed=IN_AIR, up_m=12.0)
    assert seen.position["takeoff_alt_amsl_m"] is None


def test_heartbeats_lost_at_take_off_do_not_make_the_climb_the_ground() -> None:
    seen = Watched()
    seen.hear()
    for up_m in (1.0, 3.0, 4.0):  # slower than the limit, and no heartbeat tells that it is armed
        seen.now += 1.0
        seen.vehicle.on_frame(seen.voice.position(alt_amsl_m=HOME[2] + up_m), seen.now)
        seen.vehicle.tick(seen.now)
    seen.hear(1, armed=True, landed=IN_AIR, up_m=5.0)
    assert seen.position["takeoff_alt_amsl_m"] == pytest.approx(HOME[2], abs=1.0)


def test_a_reboot_forgets_it() -> None:
    seen = Watched()
    seen.hear()
    seen.hear(3, armed=True, landed=IN_AIR, up_m=12.0)
    seen.vehicle.on_frame(seen.voice.system_time(500), seen.now + 5)
    assert seen.vehicle.takeoff.alt_amsl_m is None


def test_velocity_and_yaw_are_along_the_axes_of_the_world() -> None:
    seen = Watched()
    seen.vehicle.on_frame(seen.voice.position(velocity=(300, 100, -50), heading=9000), 1.0)
    assert (seen.position["vel_world_mps"], seen.position["yaw_world_deg"]) == (None, None)
    seen.vehicle.origin = Origin(*HOME, x_heading_deg=0.0)
    assert seen.position["vel_enu_mps"] == [1.0, 3.0, 0.5]
    assert seen.position["vel_world_mps"] == pytest.approx([3.0, -1.0, 0.5])
    assert seen.position["yaw_world_deg"] == pytest.approx(-90.0)
