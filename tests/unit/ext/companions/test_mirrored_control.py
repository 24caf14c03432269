"""The companion's control as the ground shows it."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from skygcs.config.control import ControlSettings
from skygcs.core.control.guard import ControlMode
from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.trajectory import Piece, Trajectory, TrajectoryClock
from skygcs.core.vehicle.offboard_controller import OffboardConfig, OffboardState
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory, TrajectoryFlight
from skygcs.ext.companions.mirrored_control import REPORTS_SILENT_S, MirroredControl
from support.table import each

ORIGIN = Origin(43.7806, -79.4653, 180.0)
CONFIG = OffboardConfig(ControlSettings().law(), ControlSettings().guard())


def report(made_s: float, newest: int, state: str = "flying", **more: Any) -> dict[str, Any]:
    control = {"state": state, "mode": "attitude", "control_mode": "attitude" if state == "flying" else None}
    reasons = more.pop("reasons", [])
    control |= {"reasons": reasons, "ticks": 7, "late": 1, "skipped": 0, "lateness_p99_s": 0.001}
    return {"session": "s1", "now_s": made_s, "newest": newest, "control": control, **more}


def flying() -> MirroredControl:
    mirror = MirroredControl(CONFIG)
    assert mirror.take(report(10.0, 1), 1.0) == ()
    assert mirror.state is OffboardState.FLYING and mirror.wanted is ControlMode.ATTITUDE
    return mirror


def flight() -> TrajectoryFlight:
    clock = TrajectoryClock(5.0, 0.5)
    clock.start(0.0, 0.0)
    loaded = LoadedTrajectory(Trajectory([Piece(5.0, (0.0, 1.0), (0.0,), (10.0,))]), "line")
    return TrajectoryFlight(loaded, clock, ORIGIN, EnuFrame(ORIGIN))


def test_a_report_that_does_not_know_the_release_does_not_bring_control_back() -> None:
    mirror = flying()
    mirror.release(2, "hold was ordered")
    assert mirror.state is OffboardState.OFF and mirror.reasons == ("hold was ordered",)
    assert mirror.take(report(10.5, 1), 1.5) == ()
    assert mirror.state is OffboardState.OFF
    assert mirror.unconfirmed, "the companion may still send"
    mirror.take(report(11.0, 2, "off"), 2.0)
    assert not mirror.unconfirmed
    mirror.take(report(12.0, 3), 3.0)
    assert mirror.state is OffboardState.FLYING, "a later engagement does"


def test_an_older_report_does_not_count() -> None:
    mirror = flying()
    mirror.take(report(12.0, 2, "held", reasons=["fence"]), 3.0)
    assert mirror.take(report(11.0, 2), 3.1) == ()
    assert mirror.state is OffboardState.HELD and mirror.reasons == ("fence",)


def test_what_ends_by_itself_is_reported_once() -> None:
    mirror = flying()
    texts = mirror.take(report(11.0, 1, "off", reasons=["the vehicle is in RTL"]), 2.0)
    assert texts == ("control ended: the vehicle is in RTL",)
    assert mirror.take(report(12.0, 1, "off"), 3.0) == ()


def test_a_restart_of_the_companion_ends_control() -> None:
    mirror = flying()
    texts = mirror.take({**report(0.5, 0, "off"), "session": "s2"}, 2.0)
    assert any("restarted" in text for text in texts)
    assert mirror.state is OffboardState.OFF and mirror.session == "s2"


def test_silence_keeps_the_state_until_the_autopilot_shows_another_mode() -> None:
    mirror = flying()
    assert mirror.watch(1.0 + REPORTS_SILENT_S, follows=True, mode="OFFBOARD") == ()
    mirror.watch(1.1 + REPORTS_SILENT_S, follows=True, mode="OFFBOARD")
    assert mirror.state is OffboardState.FLYING and "not answered" in mirror.reasons[0]
    (text,) = mirror.watch(2.0 + REPORTS_SILENT_S, follows=False, mode="AUTO.RTL")
    assert "AUTO.RTL" in text and mirror.state is OffboardState.OFF


def test_a_flight_lasts_while_the_reports_have_it() -> None:
    mirror, own = flying(), flight()
    mirror.follow(own, EnuFrame(ORIGIN), 5)
    mirror.take(report(11.0, 1), 2.0)
    assert mirror.flight is own, "a report from before the start"
    mirror.take(report(12.0, 5, flight=5), 3.0)
    assert mirror.flight is own
    mirror.take(report(13.0, 5, flight=None), 4.0)
    assert mirror.flight is None


def test_a_flight_ends_with_its_clock_and_with_silence() -> None:
    mirror, own = flying(), flight()
    mirror.follow(own, EnuFrame(ORIGIN), 5)
    mirror.end_flight(4.0)
    assert mirror.flight is own
    mirror.end_flight(30.0)
    assert mirror.flight is None
    mirror.follow(flight(), EnuFrame(ORIGIN), 6)
    assert mirror.watch(1.5 + REPORTS_SILENT_S, follows=True, mode="OFFBOARD")
    assert mirror.flight is None


ANY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
    max_leaves=8,
)
KEYS = ("session", "now_s", "newest", "control", "flight", "gains", "guard_falls", "tracking", "origin")


@given(
    st.lists(
        st.fixed_dictionaries({}, optional=dict.fromkeys(KEYS, ANY)) | st.builds(report, st.floats(), st.integers()),
        max_size=6,
    )
)
def test_no_report_breaks_the_mirror(reports: list[dict[str, Any]]) -> None:
    mirror = MirroredControl(CONFIG)
    for k, one in enumerate(reports):
        texts = mirror.take(one, float(k))
        assert all(isinstance(text, str) for text in texts)
        assert isinstance(mirror.state, OffboardState) and mirror.period_s > 0.0
        assert mirror.clock.ticks >= 0
    mirror.watch(100.0, follows=False, mode="LAND")


@each("mode", list(ControlMode))
def test_the_period_is_that_of_the_mode(mode: ControlMode) -> None:
    mirror = MirroredControl(CONFIG)
    mirror.wanted = mode
    hz = {ControlMode.POSITION: CONFIG.position_hz, ControlMode.VELOCITY: CONFIG.velocity_hz}
    assert mirror.period_s == 1.0 / hz.get(mode, CONFIG.attitude_hz)
