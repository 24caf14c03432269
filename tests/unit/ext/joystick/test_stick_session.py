"""The table of the state machine around the dead-man button, row by row, and what must never happen in any order."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.joystick.device_events import AXIS, BUTTON, JoystickEvent
from skygcs.ext.joystick.stick_mapping import StickAxes, StickLimits
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
from support.table import each

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
        "press",
        "release",
        "forward",
        "centre",
        "tick",
        "gap",
        "engaged",
        "not engaged",
        "stopped",
        "taken",
        "lost",
        "exit",
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
