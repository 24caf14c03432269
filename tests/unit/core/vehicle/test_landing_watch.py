"""What shows that a vehicle on the ground and disarmed has not landed: its firmware's texts, its lean, its fall."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import Frame
from skygcs.core.vehicle.decoder import Decoder
from skygcs.core.vehicle.flight_evidence import SETTLED_S, LandingWatch
from skygcs.core.vehicle.vehicle import Vehicle
from support.vehicles import ARDUPILOT, Voice, flight_dialect

DECODER = Decoder(flight_dialect())


def attitude(voice: Voice, roll_deg: float, pitch_deg: float = 0.0) -> Frame:
    roll_rad, pitch_rad = math.radians(roll_deg), math.radians(pitch_deg)
    return voice.say(mav.MAVLink_attitude_message(0, roll_rad, pitch_rad, 0.0, 0.0, 0.0, 0.0))


def text(voice: Voice, words: str) -> Frame:
    return voice.say(mav.MAVLink_statustext_message(0, words.encode()))


class Landing:
    """A copter that comes down from 10 m, disarms by the heartbeat at 10 s, and is looked at twice a second."""

    def __init__(self, *, vehicle_type: int = 2) -> None:
        self.vehicle, self.voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
        self.watch = LandingWatch(0.0)
        self.vehicle_type = vehicle_type

    def beat(self, now: float, *, armed: bool) -> None:
        beat = mav.MAVLink_heartbeat_message(self.vehicle_type, ARDUPILOT, 0x80 * armed + 1, 3, 4, 3)
        self.vehicle.on_frame(self.voice.say(beat), now)

    def come_down(self, sink_mps: float, *, ground_m: float = 0.0, disarmed_at_m: float | None = None) -> None:
        """``ground_m``: its height above home; ``disarmed_at_m``: it is switched off there, and falls."""
        for half in range(21):
            now = half / 2
            height_m = max(ground_m, 10.0 - sink_mps * now)
            if disarmed_at_m is not None and now >= 9.5:
                height_m = ground_m
            elif disarmed_at_m is not None:
                height_m = disarmed_at_m
            self.vehicle.on_frame(self.voice.position(rel_m=height_m), now)
            if half % 2 == 0:
                self.beat(now, armed=half < 20)
            self.watch.look(self.vehicle)
        self.vehicle.on_frame(self.voice.position(rel_m=ground_m), 10.5)
        self.vehicle.on_frame(attitude(self.voice, 2.0), 10.5)


@pytest.mark.parametrize("ground_m", [0.0, 6.0, -8.0])
def test_a_landing_on_any_ground_is_one(ground_m: float) -> None:
    landing = Landing()
    landing.come_down(2.5, ground_m=ground_m)
    assert landing.watch.why_not(landing.vehicle) is None
    armed_at = 9.0
    assert not landing.watch.settled(landing.vehicle, armed_at + SETTLED_S - 0.1)
    assert landing.watch.settled(landing.vehicle, armed_at + SETTLED_S)


def test_who_was_switched_off_in_the_air_has_fallen() -> None:
    landing = Landing()
    landing.come_down(0.0, disarmed_at_m=8.0)
    assert landing.watch.why_not(landing.vehicle) == "it was 8 m higher when it was last seen armed"


@pytest.mark.parametrize(
    "words",
    [
        "Crash: Disarming: AngErr=40>30, Accel=1.2<3.0",  # ArduCopter/crash_check.cpp
        "Crash detected",  # ArduPlane/is_flying.cpp
        "Hard landing detected",
        "Parachute: Released",
        "Disarmed by failure detector\t",  # PX4, Commander.cpp
        "Disarmed by kill-switch\t",
    ],
)
def test_the_words_of_a_firmware_count_from_the_start_on(words: str) -> None:
    landing = Landing()
    landing.vehicle.on_frame(text(landing.voice, words), -1.0)
    landing.come_down(2.5)
    assert landing.watch.why_not(landing.vehicle) is None, "that was an earlier flight"
    landing.vehicle.on_frame(text(landing.voice, words), 10.6)
    assert landing.watch.why_not(landing.vehicle) == f"its autopilot reports {words.strip()!r}"


@pytest.mark.parametrize("words", ["Disarmed by landing\t", "Disarming motors", "SIM Hit ground at 0.4 m/s"])
def test_the_words_of_a_landing_do_not(words: str) -> None:
    landing = Landing()
    landing.come_down(2.5)
    landing.vehicle.on_frame(text(landing.voice, words), 10.6)
    assert landing.watch.why_not(landing.vehicle) is None


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg", "lies"), [(88, 0, True), (0, 180, True), (-30, 50, True), (25, 20, False)]
)
def test_who_lies_on_its_side_has_crashed(roll_deg: float, pitch_deg: float, lies: bool) -> None:
    landing = Landing()
    landing.come_down(2.5)
    landing.vehicle.on_frame(attitude(landing.voice, roll_deg, pitch_deg), 10.6)
    why = landing.watch.why_not(landing.vehicle)
    assert why is not None and why.startswith("it lies on its side") if lies else why is None


def test_a_lean_before_the_disarming_says_nothing_and_a_tail_sitter_may_stand_so() -> None:
    landing = Landing()
    landing.vehicle.on_frame(attitude(landing.voice, 80.0), 5.0)
    landing.come_down(2.5)
    assert landing.watch.why_not(landing.vehicle) is None
    tail_sitter = Landing(vehicle_type=20)
    tail_sitter.come_down(2.5)
    tail_sitter.vehicle.on_frame(attitude(tail_sitter.voice, 0.0, 90.0), 10.6)
    assert tail_sitter.watch.why_not(tail_sitter.vehicle) is None
