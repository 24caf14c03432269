"""Which poses may be sent: the rows of the filter's table."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.mocap.lost_body import MOST_M
from skygcs.ext.mocap.pose import Pose, about_up
from skygcs.ext.mocap.pose_filter import FilterLimits, PoseFilter, Verdict

LIMITS = FilterLimits(max_jump_m=0.3, max_jump_rad=0.5, max_age_s=0.2)
DT = 0.01


class Cameras:
    """Frames at 100 Hz of a body whose noise makes each pose another one."""

    def __init__(self) -> None:
        self.filter = PoseFilter(LIMITS)
        self.now = 0.0
        self.count = 0

    def see(self, x: float = 1.0, *, yaw: float = 0.0, armed: bool = False) -> Verdict:
        self.now += DT
        self.count += 1
        noise = 1e-4 * math.sin(self.count)
        return self.filter.judge(Pose(self.now, (x + noise, 2.0, 1.0), about_up(yaw)), self.now, armed=armed)

    def miss(self, seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            self.now += DT
            assert self.filter.judge(None, self.now) == "occluded"


def tracking() -> Cameras:
    cameras = Cameras()
    verdicts = [cameras.see() for _ in range(20)]
    assert verdicts[:10] == ["searching"] * 10 and set(verdicts[12:]) == {"accepted"}
    assert cameras.filter.reset_counter == 0  # the first time is no reset
    return cameras


def test_a_steady_body_is_accepted_after_a_tenth_of_a_second() -> None:
    assert tracking().filter.tracking


@pytest.fixture
def cameras() -> Cameras:
    return tracking()


def test_what_is_not_seen_is_not_sent_and_a_short_gap_is_no_reset(cameras: Cameras) -> None:
    cameras.miss(0.1)
    assert cameras.see(1.2) == "accepted"
    assert cameras.filter.reset_counter == 0


def test_a_repeated_pose_is_not_sent_and_does_not_keep_the_body_alive(cameras: Cameras) -> None:
    last = cameras.filter.accepted
    assert last is not None
    for _ in range(30):
        cameras.now += DT
        assert cameras.filter.judge(Pose(cameras.now, last.pos_m, last.q), cameras.now) == "repeated"
    assert not cameras.filter.tracking
    assert cameras.see() == "searching"


def test_a_jump_is_not_sent_and_the_body_goes_on_from_where_it_was(cameras: Cameras) -> None:
    assert cameras.see(2.0) == "jump"
    assert cameras.see(1.0, yaw=2.0) == "jump"
    assert cameras.see(1.0) == "accepted"


def test_motion_is_no_jump(cameras: Cameras) -> None:
    assert {cameras.see(1.0 + 0.04 * n, yaw=0.05 * n) for n in range(100)} == {"accepted"}  # 4 m/s, 5 rad/s


def test_a_body_that_is_found_again_counts_as_reset_once_it_is_steady(cameras: Cameras) -> None:
    cameras.miss(0.5)
    verdicts = [cameras.see(1.1) for _ in range(15)]
    assert verdicts[:10] == ["searching"] * 10 and verdicts[-1] == "accepted"
    assert cameras.filter.reset_counter == 1
    cameras.filter.reset_counter = 255
    cameras.miss(0.5)
    for _ in range(15):
        cameras.see()
    assert cameras.filter.reset_counter == 0


def test_an_unsteady_body_is_not_found(cameras: Cameras) -> None:
    cameras.miss(0.5)
    assert {cameras.see(1.0 + n % 2) for n in range(200)} == {"searching"}


def test_another_body_far_away_is_not_taken_while_the_vehicle_is_armed(cameras: Cameras) -> None:
    far = 1.0 + LIMITS.max_jump_m + MOST_M + 0.5
    verdicts = [cameras.see(far, armed=True) for _ in range(1000)]
    assert "accepted" not in verdicts and verdicts[-1] == "out of reach"
    assert cameras.see(far, armed=False) == "accepted"


def test_one_that_could_not_be_it_at_first_is_not_it_later_either(cameras: Cameras) -> None:
    """2.4 m beside after 0.3 s: a vehicle may have drifted as far a second later, but this body stood there before."""
    cameras.miss(0.3)
    verdicts = [cameras.see(3.4, armed=True) for _ in range(500)]
    assert "accepted" not in verdicts
    cameras.miss(2.0)  # and hidden for a while it is the same one
    assert "accepted" not in [cameras.see(3.4, armed=True) for _ in range(500)]
    assert [cameras.see(1.2, armed=True) for _ in range(15)][-1] == "accepted", "the vehicle itself is found"


def test_poses_that_come_late_or_backwards_are_old(cameras: Cameras) -> None:
    assert cameras.filter.judge(Pose(cameras.now, (1, 2, 1), about_up(0)), cameras.now) == "old"
    assert cameras.filter.judge(Pose(cameras.now + DT, (1, 2, 1), about_up(0)), cameras.now + 1.0) == "old"
    assert not cameras.filter.tracking


@given(
    st.lists(
        st.tuples(
            st.floats(0.0, 0.5),
            st.one_of(st.none(), st.tuples(*(st.floats(allow_nan=True, allow_infinity=True),) * 7)),
            st.booleans(),
        ),
        max_size=60,
    )
)
def test_whatever_comes_what_is_accepted_is_finite_new_and_near(frames: list) -> None:
    judged = PoseFilter(LIMITS)
    now, last = 0.0, None
    for wait, numbers, armed in frames:
        now += wait
        pose = None if numbers is None else Pose(now, numbers[:3], numbers[3:])
        if judged.judge(pose, now, armed=armed) == "accepted":
            assert pose is not None and pose.finite()
            assert last is None or not pose.same_place(last)
            last = pose
