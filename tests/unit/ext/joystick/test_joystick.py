"""A joystick: its sticks, its session and its commands."""

from __future__ import annotations

import asyncio
import math
import os
import shutil
import struct
import subprocess
from collections.abc import AsyncIterator, Iterable
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.cli.connection import Exit
from skygcs.errors import RpcError
from skygcs.ext.joystick.commands import JSIOCGNAME_128, JoystickFlight
from skygcs.ext.joystick.device_events import AXIS, BUTTON, INITIAL, EventReader, JoystickEvent
from skygcs.ext.joystick.stick_mapping import (
    AxisChoice,
    StickAxes,
    StickDemand,
    StickLimits,
    approach,
    demand,
    off_centre,
    shaped,
    turned,
)
from skygcs.ext.joystick.stick_session import (
    GAP_S,
    START_S,
    Effect,
    Engage,
    Finish,
    Send,
    SessionReport,
    SessionState,
    StickSession,
    Stop,
)
from skygcs.rpc import error_codes
from support.hosts import until
from support.table import each

# -- The table of the state machine around the dead-man button, row by row, and what must never happen in any order.


BUTTON_NUMBER = 5
PRESS = JoystickEvent(BUTTON, BUTTON_NUMBER, 1.0)
RELEASE = JoystickEvent(BUTTON, BUTTON_NUMBER, 0.0)
CENTRED = [JoystickEvent(AXIS, number, 0.0) for number in (0, 1, 3, 4)]
FORWARD = JoystickEvent(AXIS, 4, -1.0)
CENTRE = JoystickEvent(AXIS, 4, 0.0)


class Rig:
    """A session and a clock of its own."""

    def __init__(self) -> None:
        self.now = 100.0
        self.session = StickSession(StickAxes(), StickLimits(), BUTTON_NUMBER, self.now)

    def events(self, *events: JoystickEvent) -> list[Effect]:
        return self.session.on_events(events, self.now)

    def tick(self, dt_s: float = 0.05) -> list[Effect]:
        self.now += dt_s
        return self.session.tick(self.now)

    def ready(self) -> Rig:
        self.events(*CENTRED, RELEASE)
        assert self.session.state is SessionState.READY
        return self

    def engaging(self) -> Rig:
        assert self.ready().events(PRESS) == [Engage()]
        return self

    def flying(self) -> Rig:
        self.engaging().session.on_engaged(True, "", self.now)
        assert self.session.state is SessionState.FLYING
        return self


def kinds(effects: Iterable[Effect]) -> list[type]:
    return [type(effect) for effect in effects]


def test_all_that_is_needed_must_be_there_centred_and_released() -> None:
    rig = Rig()
    assert rig.events(*CENTRED) == [], "the button is still missing"
    assert kinds(rig.events(RELEASE)) == [SessionReport]
    assert rig.session.state is SessionState.READY


@each(
    ("events", "word"),
    [([*CENTRED, PRESS], "button 5 is pressed"), ([*CENTRED[:-1], FORWARD, RELEASE], "axis 4 (forward) at -100%")],
)
def test_a_stuck_button_or_stick_is_refused_at_the_start(events: list[JoystickEvent], word: str) -> None:
    (end,) = Rig().events(*events)
    assert isinstance(end, Finish) and not end.ok and word in end.text


def test_an_axis_that_does_not_exist_is_named() -> None:
    rig = Rig()
    rig.events(*CENTRED[:-1], RELEASE)
    assert rig.tick(START_S - 0.1) == []
    (end,) = rig.tick(0.2)
    assert isinstance(end, Finish) and not end.ok and "axis 4 (forward)" in end.text


def test_a_press_with_a_stick_off_its_centre_does_not_count() -> None:
    rig = Rig().ready()
    assert kinds(rig.events(FORWARD, PRESS)) == [SessionReport]
    assert rig.events(CENTRE) == [], "centring it under the same press is not enough"
    assert rig.events(RELEASE, PRESS) == [Engage()]


def test_it_flies_while_the_button_is_held_and_a_stick_held_still_goes_on() -> None:
    rig = Rig().flying()
    rig.events(FORWARD)
    sent = [rig.tick()[0] for _ in range(40)]  # no event comes in these 2 s
    assert all(isinstance(effect, Send) for effect in sent)
    assert isinstance(sent[0], Send) and sent[0].demand.vel_mps == pytest.approx((0.1, 0, 0)), "from 0 on"
    assert isinstance(sent[-1], Send) and sent[-1].demand.vel_mps == pytest.approx((2.0, 0, 0))
    assert rig.events(RELEASE) == [Stop(True)]
    assert rig.tick() == []


def test_engaging_fails_and_wants_a_new_press() -> None:
    rig = Rig().engaging()
    (report,) = rig.session.on_engaged(False, "not airborne", rig.now)
    assert isinstance(report, SessionReport) and "not airborne" in report.text
    assert rig.tick() == [] and rig.events(RELEASE) == []
    assert rig.events(PRESS) == [Engage()]


def test_a_release_while_engaging_stops_and_a_late_answer_does_not_fly() -> None:
    rig = Rig().engaging()
    assert rig.events(RELEASE) == [Stop(False)]
    assert rig.session.on_engaged(True, "", rig.now) == [] and rig.tick() == []
    assert kinds(rig.session.on_stopped(True, "holds")) == [SessionReport]
    assert rig.session.state is SessionState.READY


def test_a_press_while_it_stops_has_to_be_made_again() -> None:
    rig = Rig().flying()
    rig.events(RELEASE, PRESS)
    rig.session.on_stopped(True, "holds")
    assert rig.session.state is SessionState.READY and rig.tick() == []
    assert rig.events(RELEASE, PRESS) == [Engage()]


def test_release_and_press_in_one_read_are_two_events() -> None:
    assert Rig().flying().events(RELEASE, PRESS) == [Stop(True)]
    assert Rig().ready().events(PRESS, RELEASE) == [Engage(), Stop(False)]


@each("unplugged", [True, False])
def test_unplugging_and_exiting_stop_it_and_then_end(unplugged: bool) -> None:
    rig = Rig().flying()
    session = rig.session
    assert (session.on_device_lost("ENODEV") if unplugged else session.on_exit_asked("stopped")) == [Stop(True)]
    assert session.on_exit_asked("stopped") == [], "once"
    (end,) = session.on_stopped(True, "holds")
    assert isinstance(end, Finish) and end.ok is not unplugged and "holds" in end.text
    assert session.on_exit_asked("stopped") == [] and session.on_device_lost("x") == []


@each("state", ["starting", "ready"])
def test_what_is_not_flown_is_left_alone_at_the_end(state: str) -> None:
    rig = Rig() if state == "starting" else Rig().ready()
    assert kinds(rig.session.on_device_lost("ENODEV")) == [Finish]


def test_a_failed_hold_is_not_a_good_end() -> None:
    rig = Rig().flying()
    rig.session.on_exit_asked("stopped")
    (end,) = rig.session.on_stopped(False, "HOLD FAILED")
    assert isinstance(end, Finish) and not end.ok


def test_whoever_took_it_is_not_fought() -> None:
    rig = Rig().flying()
    assert kinds(rig.session.on_taken_away("stopped by another client")) == [Finish], "no Stop: no hold is ordered"
    assert rig.tick() == [] and rig.events(RELEASE, PRESS, RELEASE) == []


def test_after_a_standstill_of_the_program_the_same_press_does_not_fly_on() -> None:
    rig = Rig().flying()
    rig.events(FORWARD)
    rig.tick()
    assert kinds(rig.tick(GAP_S + 0.1)) == [SessionReport, Stop]
    rig.session.on_stopped(True, "holds")
    assert rig.tick() == [] and rig.events(CENTRE) == []


def test_after_a_refusal_the_sticks_begin_at_zero() -> None:
    rig = Rig().flying()
    rig.events(FORWARD)
    for _ in range(20):
        rig.tick()
    rig.session.on_refused_setpoint()
    (sent,) = rig.tick()
    assert isinstance(sent, Send) and sent.demand.vel_mps[0] == pytest.approx(0.1)


ACTIONS = st.sampled_from(
    [
        *("press", "release", "forward", "centre", "tick", "gap"),
        *("engaged", "not engaged", "stopped", "taken", "lost", "exit"),
    ]
)


@given(st.lists(ACTIONS, max_size=60))
def test_in_no_order_is_anything_sent_without_the_button(actions: list[str]) -> None:
    rig = Rig().ready()
    held = False
    session = rig.session
    for action in actions:
        ended = session.state is SessionState.ENDED
        match action:
            case "press" | "release":
                held = action == "press"
                effects = rig.events(PRESS if held else RELEASE)
            case "forward" | "centre":
                effects = rig.events(FORWARD if action == "forward" else CENTRE)
            case "tick" | "gap":
                effects = rig.tick(0.05 if action == "tick" else GAP_S + 1)
            case "engaged" | "not engaged":
                effects = session.on_engaged(action == "engaged", "", rig.now)
            case "stopped":
                effects = session.on_stopped(True, "")
            case "taken":
                effects = session.on_taken_away("")
            case "lost":
                effects = session.on_device_lost("")
            case _:
                effects = session.on_exit_asked("")
        assert not ended or effects == [], "nothing comes after the end"
        assert held or not {Send, Engage} & set(kinds(effects)), "flown without the button"
        assert held or session.state not in (SessionState.FLYING, SessionState.ENGAGING)


# -- The device's events, and what the sticks ask for.


AXES = StickAxes()
LIMITS = StickLimits()


def raw(value: int, kind: int, number: int) -> bytes:
    return struct.pack("<IhBB", 12345, value, kind, number)


def test_events_are_read_however_the_bytes_come() -> None:
    data = raw(-32768, 0x82, 4) + raw(1, 0x81, 5) + raw(16384, 2, 0) + raw(0, 1, 5) + raw(1, 7, 0)
    wanted = [(AXIS, 4, -1.0), (BUTTON, 5, 1.0), (AXIS, 0, 16384 / 32767), (BUTTON, 5, 0.0)]
    for size in (1, 3, 8, len(data)):
        reader = EventReader()
        parts = [data[i : i + size] for i in range(0, len(data), size)]
        events = [event for part in parts for event in reader.feed(part)]
        assert events == [JoystickEvent(*w) for w in wanted]
        assert reader.unknown == 1


@given(st.lists(st.binary(max_size=100), max_size=20))
def test_no_bytes_break_the_reader(parts: list[bytes]) -> None:
    reader = EventReader()
    events = [event for part in parts for event in reader.feed(part)]
    assert len(events) + reader.unknown == sum(map(len, parts)) // 8
    assert all(-1.0 <= event.value <= 1.0 for event in events)


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler called cc")
def test_the_request_for_the_name_is_the_kernels(tmp_path: Path) -> None:
    source = tmp_path / "name.c"
    source.write_text(
        "#include <linux/joystick.h>\n#include <stdio.h>\n"
        'int main(void) { printf("%lu %zu", (unsigned long)JSIOCGNAME(128), sizeof(struct js_event)); }\n'
    )
    subprocess.run(["cc", str(source), "-o", str(tmp_path / "name")], check=True)
    printed = subprocess.run([str(tmp_path / "name")], capture_output=True, text=True, check=True).stdout
    assert printed.split() == [str(JSIOCGNAME_128), "8"]


def test_each_stick_goes_where_it_is_pushed() -> None:
    assert demand(AXES, LIMITS, {4: -1.0}).vel_mps == pytest.approx((2.0, 0.0, 0.0))
    assert demand(AXES, LIMITS, {3: 1.0}).vel_mps == pytest.approx((0.0, -2.0, 0.0)), "right is not left"
    assert demand(AXES, LIMITS, {1: -1.0}).vel_mps == pytest.approx((0.0, 0.0, 1.0))
    assert demand(AXES, LIMITS, {0: 1.0}).yaw_rate_dps == pytest.approx(-45.0), "to the right is clockwise"
    assert demand(StickAxes(forward=AxisChoice(7)), LIMITS, {7: 1.0}).vel_mps[0] == pytest.approx(2.0)


@given(st.dictionaries(st.integers(0, 8), st.floats(-1, 1)))
def test_nothing_exceeds_the_limits(values: dict[int, float]) -> None:
    asked = demand(AXES, LIMITS, values)
    assert math.hypot(*asked.vel_mps[:2]) <= LIMITS.speed_mps + 1e-9, "a corner is no faster than an edge"
    assert abs(asked.vel_mps[2]) <= LIMITS.climb_mps + 1e-9
    assert abs(asked.yaw_rate_dps) <= LIMITS.yaw_rate_dps + 1e-9


@given(st.floats(-1, 1), st.floats(0, 0.5), st.floats(0, 1))
def test_the_curve_is_odd_and_begins_at_the_dead_zone(x: float, dead_zone: float, expo: float) -> None:
    limits = StickLimits(dead_zone=dead_zone, expo=expo)
    assert shaped(x, limits) == -shaped(-x, limits)
    assert (shaped(x, limits) == 0.0) or abs(x) > dead_zone
    assert shaped(1.0, limits) == pytest.approx(1.0)


def test_a_bent_curve_is_finer_in_the_middle() -> None:
    assert shaped(0.5, StickLimits(expo=0.8)) < shaped(0.5, StickLimits(expo=0.0))


def test_a_deflection_takes_effect_at_the_acceleration() -> None:
    full = StickDemand((2.0, 0.0, 0.0), 10.0)
    assert approach((0.0, 0.0, 0.0), full, LIMITS, 0.05) == StickDemand((0.1, 0.0, 0.0), 10.0)
    assert approach((1.95, 0.0, 0.0), full, LIMITS, 0.05) == full


def test_forward_is_where_the_nose_is() -> None:
    assert turned((1.0, 0.0, 0.5), math.pi / 2) == pytest.approx((0.0, 1.0, 0.5))
    assert turned((0.0, 1.0, 0.0), math.pi / 2) == pytest.approx((-1.0, 0.0, 0.0))


def test_sticks_off_their_centre_are_named() -> None:
    expected = ["axis 1 (up) at -100%", "axis 4 (forward) at 20%"]
    assert off_centre(AXES, {0: 0.1, 1: -1.0, 3: 0.0, 4: 0.2, 9: 1.0}) == expected


# -- The dead-man button is released before the daemon has answered: hold is ordered, or nothing.


class SlowDaemon:
    """Answers control.set once the device is gone, with ``ok``; meanwhile the vehicle's control is in ``state``."""

    def __init__(self, ok: bool, state: str) -> None:
        self.ok, self.state = ok, state
        self.address = "here"
        self.orders: list[str] = []
        self.asked = asyncio.Event()
        self.looked = 0

    async def call(self, method: str, **params: Any) -> Any:
        if method == "control.status":
            self.looked += 1
            if self.state == "refused":
                raise RpcError(error_codes.LIMIT_EXCEEDED, "too many requests")
            return [{"state": self.state, "mode": None, "successor": None, "reasons": []}]
        assert method == "control.set"
        self.asked.set()
        await until(lambda: self.looked == 3, 60.0)
        return {
            "outcomes": {"alpha": {"ok": self.ok, "message": "accepted" if self.ok else "refused: a plan flies it"}}
        }

    async def hold(self, name: str) -> Any:
        self.orders.append("hold")
        return {name: {"ok": True, "message": "accepted"}}

    async def telemetry(self, name: str, **_: Any) -> AsyncIterator[Any]:
        await asyncio.Event().wait()
        yield


def event(kind: int, number: int, value: int = 0) -> bytes:
    return struct.pack("=IhBB", 0, value, kind, number)


RELEASED = [
    (False, "off", []),  # refused: another one may fly it, by a plan or back home
    (False, "flying", []),  # by the setpoints of another client
    (True, "off", ["hold"]),
    (False, "engaging", ["hold"]),  # setpoints have begun: not waited for
    (False, "refused", ["hold"]),  # its state is not known
]


@each("ok, state, ordered", RELEASED)
async def test_a_release_before_the_answer_stops_only_what_was_taken(ok: bool, state: str, ordered: list[str]) -> None:
    """A short press held every vehicle whose engagement was refused, also one on its way home."""
    daemon = SlowDaemon(ok, state)
    flight = JoystickFlight(cast(Any, daemon), "alpha", engage=True, fleet_frame=True)
    near, far = os.pipe()
    os.set_blocking(near, False)
    at_rest = [event(AXIS | INITIAL, number) for number in range(6)] + [event(BUTTON | INITIAL, 5)]
    os.write(far, b"".join(at_rest))
    flying = asyncio.create_task(flight.fly(near, StickAxes(), StickLimits(), 5))
    await asyncio.sleep(0)
    await until(lambda: flight._session.state is SessionState.READY, 60.0)
    os.write(far, event(BUTTON, 5, 1))
    await daemon.asked.wait()
    os.close(far)  # unplugged: the same as a release, and the end
    assert await flying == Exit.FAILED
    assert daemon.orders == ordered
    assert ("not taken under control" in flight.end) is not bool(ordered)
    os.close(near)
