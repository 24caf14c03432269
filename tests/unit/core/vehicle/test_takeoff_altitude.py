"""How high the ground is that a vehicle took off from, as far as anybody saw it stand there."""

from __future__ import annotations

from typing import Any

import pytest

from skygcs.core.geo import Origin
from skygcs.core.vehicle.decoder import Decoder
from skygcs.core.vehicle.snapshot import take_snapshot
from skygcs.core.vehicle.vehicle import Vehicle
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


def test_it_is_where_it_stood_when_it_armed() -> None:
    seen = Watched()
    seen.hear()
    assert (seen.position["takeoff_alt_amsl_m"], seen.position["alt_takeoff_m"]) == (None, None)
    seen.hear(1, armed=True, up_m=0.2, climb_mps=1.0)
    seen.hear(5, armed=True, landed=IN_AIR, up_m=12.0)
    assert seen.position["takeoff_alt_amsl_m"] == HOME[2]
    assert seen.position["alt_takeoff_m"] == pytest.approx(12.0)


def test_an_autopilot_that_tells_no_landed_state_is_seen_to_stand_while_it_is_disarmed() -> None:
    seen = Watched()
    seen.hear(landed=None)
    seen.hear(5, armed=True, landed=None, up_m=12.0)
    assert seen.position["takeoff_alt_amsl_m"] == HOME[2]


def test_met_in_the_air_nobody_knows() -> None:
    seen = Watched()
    seen.hear(20, armed=True, landed=IN_AIR, up_m=12.0)
    assert (seen.position["takeoff_alt_amsl_m"], seen.position["alt_takeoff_m"]) == (None, None)


def test_met_armed_on_the_ground_it_is_where_it_stands() -> None:
    seen = Watched(ARDUPILOT)
    seen.hear(3, armed=True)
    seen.hear(3, armed=True, landed=IN_AIR, up_m=12.0)
    assert seen.position["takeoff_alt_amsl_m"] == HOME[2]


def test_met_in_a_climb_that_the_landed_state_does_not_tell_yet_it_does_not_stand() -> None:
    seen = Watched()
    seen.hear(1, armed=True, up_m=3.0, climb_mps=1.5)
    seen.hear(3, armed=True, landed=IN_AIR, up_m=12.0)
    assert seen.position["takeoff_alt_amsl_m"] is None


def test_a_landing_elsewhere_without_disarming_is_the_next_take_off() -> None:
    seen = Watched()
    seen.hear()
    seen.hear(3, armed=True, landed=IN_AIR, up_m=12.0)
    seen.hear(3, armed=True, up_m=5.0)
    seen.hear(3, armed=True, landed=IN_AIR, up_m=12.0)
    assert seen.position["alt_takeoff_m"] == pytest.approx(7.0)


def test_after_the_landing_it_is_kept_until_it_arms_again() -> None:
    seen = Watched()
    seen.hear()
    seen.hear(3, armed=True, landed=IN_AIR, up_m=12.0)
    seen.hear(3, up_m=5.0)
    assert seen.position["alt_takeoff_m"] == pytest.approx(5.0)
    seen.hear(3, armed=True, up_m=5.0)
    assert seen.position["alt_takeoff_m"] == pytest.approx(0.0)


def test_without_a_position_there_is_none_until_one_comes() -> None:
    seen = Watched()
    seen.hear(position=False)
    seen.hear(2, armed=True, position=False)
    assert seen.vehicle.takeoff.alt_amsl_m is None
    seen.hear(2, armed=True)
    assert seen.vehicle.takeoff.alt_amsl_m == HOME[2]


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
