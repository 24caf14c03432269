"""What shows that a vehicle on the ground and disarmed has not landed: its firmware's texts, its lean, its fall."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import Frame
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.flight_evidence import FALL_S, LandingWatch
from skygcs.core.vehicle.vehicle import Vehicle
from support.table import each
from support.vehicles import ARDUPILOT, HOME, Voice, flight_dialect

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
        self.home_m = 0.0
        self.vehicle_type = vehicle_type

    def beat(self, now: float, *, armed: bool) -> None:
        beat = mav.MAVLink_heartbeat_message(self.vehicle_type, ARDUPILOT, 0x80 * armed + 1, 3, 4, 3)
        self.vehicle.on_frame(self.voice.say(beat), now)

    def at(self, now: float, height_m: float, *, sink_mps: float = 0.0, roll_deg: float | None = None) -> None:
        """Its position, above where home was first, and its attitude, if one is given; then it is looked at."""
        velocity = (0, 0, round(100 * sink_mps))
        position = self.voice.position(
            alt_amsl_m=HOME[2] + height_m,
            rel_m=height_m - self.home_m,
            velocity=velocity,
            boot_ms=60_000 + int(1e3 * now),
        )
        self.vehicle.on_frame(position, now)
        if roll_deg is not None:
            self.vehicle.on_frame(attitude(self.voice, roll_deg), now)
        self.watch.look(self.vehicle, now)

    def on_ground(self, now: float, landed_state: int = 1) -> None:
        self.vehicle.on_frame(self.voice.say(mav.MAVLink_extended_sys_state_message(0, landed_state)), now)

    def lie(self, height_m: float, *, roll_deg: float = 2.0, until: float = 17.0) -> None:
        """It lies there disarmed, from 10.5 s on, with a heartbeat, a position and an attitude each half second."""
        for half in range(21, round(2 * until) + 1):
            self.beat(half / 2, armed=False)
            self.at(half / 2, height_m, roll_deg=roll_deg)

    def landed(self, now: float = 17.0) -> bool | None:
        return self.watch.verdict(self.vehicle, now).landed

    def why(self, now: float = 17.0) -> str:
        return self.watch.verdict(self.vehicle, now).why

    def come_down(self, sink_mps: float, *, ground_m: float = 0.0, disarmed_at_m: float | None = None) -> None:
        """``ground_m``: its height above home; ``disarmed_at_m``: it is switched off there, and falls."""
        for half in range(21):
            now = half / 2
            height_m = max(ground_m, 10.0 - sink_mps * now)
            if disarmed_at_m is not None and now >= 9.5:
                height_m = ground_m
            elif disarmed_at_m is not None:
                height_m = disarmed_at_m
            if half % 2 == 0:
                self.beat(now, armed=half < 20)
            self.at(now, height_m)


@each("home_moves", [True, False])
@each("ground_m", [0.0, 6.0, -8.0])
def test_a_landing_on_any_ground_is_one(ground_m: float, home_moves: bool) -> None:
    landing = Landing()
    landing.come_down(2.5, ground_m=ground_m)
    landing.home_m = ground_m if home_moves else 0.0
    landing.on_ground(10.5)
    landing.lie(ground_m, until=10.0 + FALL_S - 0.5)
    assert landing.landed(14.9) is None, "what shows a crash may still come"
    landing.lie(ground_m)
    assert (landing.landed(), landing.why()) == (True, "")


@each("home_moves", [True, False])
@each("ground_m", [0.0, -8.0])
def test_a_vehicle_switched_off_in_the_air_has_fallen(ground_m: float, home_moves: bool) -> None:
    """A home that moves to where it lies makes no landing of it."""
    landing = Landing()
    landing.come_down(0.0, disarmed_at_m=8.0 + ground_m, ground_m=ground_m)
    landing.home_m = ground_m if home_moves else 0.0
    landing.on_ground(10.5)
    landing.lie(ground_m)
    assert landing.landed() is False and landing.why() == "it was 8 m higher when it was last seen armed"


def test_a_fall_is_seen_though_the_heartbeats_around_it_are_lost() -> None:
    """From 12 m, and nothing but positions from 9 s until 13.5 s: they moved the window past the fall."""
    landing = Landing()
    for half in range(27):
        now = half / 2
        if now <= 9.0 and half % 2 == 0:
            landing.beat(now, armed=True)
        landing.at(now, 12.0 if now < 9.5 else max(0.0, 12.0 - 4.9 * (now - 9.5) ** 2))
    landing.lie(0.0, until=20.0)
    assert landing.landed(20.0) is False and "12 m higher" in landing.why(20.0)


@each("shown", ["positions", "speeds"])
def test_a_vehicle_killed_while_it_stays_armed_has_fallen_without_any_text(shown: str) -> None:
    """PX4 disarms COM_KILL_DISARM (5 s) after the kill: it lies on the ground armed by then."""
    landing = Landing()
    for half in range(21):
        now = half / 2
        if half % 2 == 0:
            landing.beat(now, armed=half < 20)
        height_m = 10.0 if now < 5 else max(0.0, 10.0 - 4.9 * (now - 5) ** 2)
        if shown == "positions":
            landing.at(now, height_m)
        elif height_m in (10.0, 0.0) or now == 6.0:  # a single one shows it on its way, low above the ground
            landing.at(now, min(height_m, 10.0) if now != 6.0 else 2.0, sink_mps=9.8 if now == 6.0 else 0.0)
    landing.lie(0.0)
    assert landing.landed() is False and "came to the ground at" in landing.why()


@each("interval_s", [0.5, 2.0])
def test_a_fast_descent_that_ends_with_a_slow_landing_is_none(interval_s: float) -> None:
    landing = Landing()
    height_m, now = 40.0, -20.0
    while now <= 9.5:
        landing.beat(now, armed=True)
        landing.at(now, height_m, sink_mps=0.0)
        height_m = max(0.0, height_m - interval_s * (5.0 if height_m > 10.0 else 0.7))
        now += interval_s
    landing.beat(10.0, armed=False)
    landing.at(10.0, height_m)
    landing.lie(height_m)
    assert (landing.landed(), landing.why()) == (True, "")


@each("missing", ["position", "attitude"])
def test_silence_is_no_evidence_of_a_landing(missing: str) -> None:
    landing = Landing()
    landing.come_down(2.5)
    for half in range(21, 120):
        now = half / 2
        landing.beat(now, armed=False)
        if missing == "position":
            landing.vehicle.on_frame(attitude(landing.voice, 2.0), now)
            landing.watch.look(landing.vehicle, now)
        else:
            landing.at(now, 0.0)
    assert landing.landed(60.0) is None and missing in landing.why(60.0)


def test_a_forged_heartbeat_of_a_hovering_vehicle_is_no_landing() -> None:
    landing = Landing()
    landing.come_down(0.0)
    landing.lie(10.0)
    assert landing.landed() is None and "10 m above its home" in landing.why()
    landing.on_ground(17.0, 2)
    assert landing.landed() is None and "in the air" in landing.why()


@each(
    "words",
    [
        "Crash: Disarming: AngErr=40>30, Accel=1.2<3.0",  # ArduCopter/crash_check.cpp
        "Crash detected",  # ArduPlane/is_flying.cpp
        "Hard landing detected",
        "Parachute: Released",
        "Disarmed by failure detector\t",  # PX4, Commander.cpp
        "Disarmed by kill-switch\t",
        "Kill engaged\t",
    ],
)
def test_the_words_of_a_firmware_count_from_the_start_on(words: str) -> None:
    landing = Landing()
    landing.vehicle.on_frame(text(landing.voice, words), -1.0)
    landing.come_down(2.5)
    landing.lie(0.0)
    assert landing.landed(), "that was an earlier flight"
    landing.vehicle.on_frame(text(landing.voice, words), 17.1)
    landing.lie(0.0, until=17.5)
    assert landing.landed() is False and landing.why() == f"its autopilot reports {words.strip()!r}"


@each("words", ["Disarmed by landing\t", "Disarming motors", "SIM Hit ground at 0.4 m/s"])
def test_the_words_of_a_landing_do_not(words: str) -> None:
    landing = Landing()
    landing.come_down(2.5)
    landing.vehicle.on_frame(text(landing.voice, words), 10.6)
    landing.lie(0.0)
    assert landing.landed()


@each(("roll_deg", "pitch_deg", "lies"), [(88, 0, True), (0, 180, True), (-30, 50, True), (25, 20, False)])
def test_a_vehicle_on_its_side_has_crashed(roll_deg: float, pitch_deg: float, lies: bool) -> None:
    landing = Landing()
    landing.come_down(2.5)
    landing.lie(0.0)
    landing.vehicle.on_frame(attitude(landing.voice, roll_deg, pitch_deg), 17.2)
    landing.watch.look(landing.vehicle, 17.2)
    assert landing.landed() is not lies and landing.why().startswith("it lies on its side") is lies


def test_a_lean_before_the_disarming_says_nothing_and_a_tail_sitter_may_stand_so() -> None:
    landing = Landing()
    landing.vehicle.on_frame(attitude(landing.voice, 80.0), 5.0)
    landing.come_down(2.5)
    landing.lie(0.0)
    assert landing.landed()
    tail_sitter = Landing(vehicle_type=20)
    tail_sitter.come_down(2.5)
    tail_sitter.lie(0.0, roll_deg=0.0)
    tail_sitter.vehicle.on_frame(attitude(tail_sitter.voice, 0.0, 90.0), 17.2)
    tail_sitter.watch.look(tail_sitter.vehicle, 17.2)
    assert tail_sitter.landed()
