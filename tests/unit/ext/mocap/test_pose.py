"""Frames of poses, against rotation matrices of numpy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.dialects import load_dialect
from skygcs.core.geo import Origin, euler_from_quaternion, quaternion_from_euler, rotated
from skygcs.core.mavlink.frame import encode_payload
from skygcs.ext.mocap.lost_body import MOST_M
from skygcs.ext.mocap.pose import CaptureFrame, Pose, Quaternion, about_up, angle_between_rad, ned_frd
from skygcs.ext.mocap.pose_filter import FilterLimits, PoseFilter, Verdict
from skygcs.ext.mocap.pose_messages import LEAST_HZ, WIRE_BYTES, PoseMessage, message_of, rate_that_fits
from skygcs.ext.mocap.pose_stream import PoseStream
from skygcs.ext.mocap.pose_way import PoseWay
from support.table import each

EAST = Origin(43.78, -79.46, 180.0)

angles = st.floats(-3.1, 3.1)
metres = st.floats(-50, 50)


def matrix(q: Quaternion) -> np.ndarray:
    return np.array([rotated(q, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]).T


def turn_z(rad: float) -> np.ndarray:
    return np.array([[math.cos(rad), -math.sin(rad), 0], [math.sin(rad), math.cos(rad), 0], [0, 0, 1]])


def turn_y(rad: float) -> np.ndarray:
    return np.array([[math.cos(rad), 0, math.sin(rad)], [0, 1, 0], [-math.sin(rad), 0, math.cos(rad)]])


def turn_x(rad: float) -> np.ndarray:
    return np.array([[1, 0, 0], [0, math.cos(rad), -math.sin(rad)], [0, math.sin(rad), math.cos(rad)]])


@given(angles, st.floats(-1.5, 1.5), angles)
def test_euler_angles_are_those_of_the_textbook(roll: float, pitch: float, yaw: float) -> None:
    q = quaternion_from_euler(roll, pitch, yaw)
    assert np.allclose(matrix(q), turn_z(yaw) @ turn_y(pitch) @ turn_x(roll), atol=1e-9)
    assert np.allclose(euler_from_quaternion(*q), (roll, pitch, yaw), atol=1e-6)


@given(angles, st.floats(-1.5, 1.5), angles, metres, metres, metres)
def test_ned_and_frd_are_the_axes_swapped_on_both_sides(
    roll: float, pitch: float, yaw: float, x: float, y: float, z: float
) -> None:
    enu = Pose(1.0, (x, y, z), quaternion_from_euler(roll, pitch, yaw))
    ned = ned_frd(enu)
    swap = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    assert np.allclose(ned.pos_m, swap @ np.array(enu.pos_m))
    assert np.allclose(matrix(ned.q), swap @ matrix(enu.q) @ np.diag([1, -1, -1]), atol=1e-9)


@each(("yaw_enu_deg", "heading_deg"), [(0, 90), (90, 0), (180, -90), (-90, 180)])
def test_a_level_vehicle_has_the_compass_heading_as_yaw(yaw_enu_deg: float, heading_deg: float) -> None:
    level = Pose(0.0, (0, 0, 0), quaternion_from_euler(0, 0, math.radians(yaw_enu_deg)))
    roll, pitch, yaw = euler_from_quaternion(*ned_frd(level).q)
    assert (roll, pitch) == (pytest.approx(0, abs=1e-9), pytest.approx(0, abs=1e-9))
    assert math.cos(yaw - math.radians(heading_deg)) == pytest.approx(1.0)


def test_nose_up_in_flu_is_nose_up_in_frd() -> None:
    nose_up = quaternion_from_euler(0.0, -0.2, 0.0)  # FLU: a positive turn about y (left) lowers the nose
    assert rotated(nose_up, (1.0, 0.0, 0.0))[2] > 0
    assert euler_from_quaternion(*ned_frd(Pose(0.0, (0, 0, 0), nose_up)).q)[1] == pytest.approx(0.2)


def test_y_up_is_turned_to_z_up_with_its_body() -> None:
    frame = CaptureFrame(up="y")
    half = math.radians(30) / 2
    seen = Pose(5.0, (1.0, 2.0, 3.0), (math.cos(half), 0.0, math.sin(half), 0.0))  # 30 degrees about up
    pose = frame.to_enu(seen, EAST)
    assert pose is not None
    assert pose.pos_m == pytest.approx((1.0, -3.0, 2.0))
    assert euler_from_quaternion(*pose.q) == pytest.approx((0.0, 0.0, math.radians(30)), abs=1e-9)


def test_rotation_and_offset_are_those_of_the_world_frame() -> None:
    north = Origin(43.78, -79.46, 180.0, 0.0)  # x of the world to the north
    pose = CaptureFrame(offset_m=(10.0, 0.0, 1.0)).to_enu(Pose(0.0, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0)), north)
    assert pose is not None
    assert pose.pos_m == pytest.approx((-2.0, 11.0, 4.0))
    _, _, heading = euler_from_quaternion(*ned_frd(pose).q)
    assert heading == pytest.approx(0.0, abs=1e-9)  # nose along x of the world
    turned = CaptureFrame(rotation_rad=math.pi / 2).to_enu(Pose(0.0, (1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), EAST)
    assert turned is not None
    assert turned.pos_m == pytest.approx((0.0, 1.0, 0.0))


@given(st.sampled_from(["z", "y"]), angles, metres, metres, angles, st.floats(-1.5, 1.5), angles, st.floats(-180, 180))
def test_there_and_back(
    up: str, rotation: float, x: float, y: float, roll: float, pitch: float, yaw: float, heading: float
) -> None:
    origin = Origin(43.78, -79.46, 180.0, heading)
    frame = CaptureFrame(up, rotation, (3.0, -4.0, 0.5))  # type: ignore[arg-type]
    pose = Pose(1.5, (x, y, 1.0), quaternion_from_euler(roll, pitch, yaw))
    back = frame.to_enu(frame.from_enu(pose, origin), origin)
    assert back is not None
    assert back.pos_m == pytest.approx(pose.pos_m, abs=1e-9)
    assert angle_between_rad(back.q, pose.q) == pytest.approx(0.0, abs=1e-6)


@each(
    "pose",
    [
        Pose(0.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),
        Pose(0.0, (math.nan, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),
        Pose(0.0, (1.0, 0.0, math.inf), (1.0, 0.0, 0.0, 0.0)),
        Pose(0.0, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        Pose(0.0, (1.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0)),
        Pose(math.nan, (1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),
    ],
)
def test_what_is_no_measurement_has_no_pose(pose: Pose) -> None:
    assert CaptureFrame(offset_m=(5.0, 0.0, 0.0)).to_enu(pose, EAST) is None


# -- Which poses may be sent: the rows of the filter's table.


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


# -- The messages of poses, packed, and read by pymavlink; the rate that fits a link.


POSE = Pose(100.5, (1.0, 2.0, 3.0), quaternion_from_euler(0.1, 0.0, math.radians(30)))  # ENU, FLU


def read(kind: PoseMessage, family: str, reset_counter: int = 3) -> tuple[mav.MAVLink_message, bytes]:
    name, values = message_of(kind, POSE, family, reset_counter, 0.02)
    info = load_dialect("ardupilotmega").by_name[name]
    raw = encode_payload(info, info.pack(values), sysid=255, compid=25, seq=0, version=2)
    (message,) = mav.MAVLink(None).parse_buffer(raw)
    return message, raw


@each("family", ["px4", "ardupilot"])
def test_vision_position_estimate_is_ned_with_the_time_of_capture(family: str) -> None:
    message, raw = read("vision_position_estimate", family)
    assert (message.x, message.y, message.z) == pytest.approx((2.0, 1.0, -3.0))
    assert (message.roll, message.pitch, message.yaw) == pytest.approx((0.1, 0.0, math.radians(60)), abs=1e-6)
    assert message.usec == 100_480_000
    assert message.reset_counter == 3
    assert math.isnan(message.covariance[0])
    assert len(raw) == WIRE_BYTES["vision_position_estimate"]


@each(("family", "frame"), [("px4", mav.MAV_FRAME_LOCAL_NED), ("ardupilot", mav.MAV_FRAME_LOCAL_FRD)])
def test_odometry_names_the_frame_that_its_firmware_takes(family: str, frame: int) -> None:
    message, raw = read("odometry", family)
    assert (message.frame_id, message.child_frame_id) == (frame, mav.MAV_FRAME_BODY_FRD)
    assert (message.x, message.y, message.z) == pytest.approx((2.0, 1.0, -3.0))
    assert all(map(math.isnan, (message.vx, message.vy, message.vz, message.pose_covariance[0])))
    # PX4 publishes MOCAP as vehicle_mocap_odometry, which its EKF2 does not read
    assert message.estimator_type == mav.MAV_ESTIMATOR_TYPE_VISION
    assert message.time_usec == 100_480_000
    assert len(raw) <= WIRE_BYTES["odometry"]


def test_the_longest_odometry_has_the_bytes_that_are_counted() -> None:
    info = load_dialect("ardupilotmega").by_name["ODOMETRY"]
    _, values = message_of("odometry", POSE, "px4", 3, 0.0)
    payload = info.pack({**values, "quality": 1})
    assert len(encode_payload(info, payload, sysid=1, compid=1, seq=0, version=2)) == WIRE_BYTES["odometry"]


@each(
    ("kind", "uplink", "fits"),
    [
        ("vision_position_estimate", None, 30.0),
        ("vision_position_estimate", 2880.0, 11.2),  # 57600 baud, half of it up, half of that
        ("odometry", 2880.0, 5.9),
        ("vision_position_estimate", 11520.0, 30.0),  # 230400 baud would carry 44
        ("vision_position_estimate", 0.0, 0.0),
    ],
)
def test_the_rate_is_what_half_of_the_uplink_carries(kind: PoseMessage, uplink: float | None, fits: float) -> None:
    assert rate_that_fits(kind, 30.0, uplink, signed=False) == pytest.approx(fits, abs=0.1)


def test_signatures_count() -> None:
    plain = rate_that_fits("vision_position_estimate", 100.0, 2880.0, signed=False)
    assert rate_that_fits("vision_position_estimate", 100.0, 2880.0, signed=True) == pytest.approx(plain * 129 / 142)
    assert plain > LEAST_HZ


# -- The poses of one vehicle: rates, statistics, and what is wrong with them.


class Run:
    """Frames at ``hz`` that arrive 20 ms after they were captured."""

    def __init__(self, hz: float, rate_hz: float) -> None:
        self.stream = PoseStream("quad", FilterLimits())
        self.period, self.rate_hz, self.now, self.count = 1.0 / hz, rate_hz, 10.0, 0

    def go(self, seconds: float, *, seen: bool = True) -> int:
        sent = 0
        for _ in range(round(seconds / self.period)):
            self.now += self.period
            self.count += 1
            at = self.now - 0.02
            pose = Pose(at, (1.0 + 1e-4 * math.sin(self.count), 0.0, 1.0), about_up(0.0)) if seen else None
            good = self.stream.offer(pose, self.now, armed=False)
            if good is not None and self.stream.due(good, self.rate_hz):
                self.stream.statistics.sent(self.now)
                sent += 1
        return sent


@each(("hz", "rate"), [(100, 30), (100, 50), (120, 30), (240, 11.2), (100, 100), (60, 50)])
def test_poses_are_sent_at_the_rate_that_is_wanted(hz: float, rate: float) -> None:
    run = Run(hz, rate)
    run.go(1.0)
    assert run.go(20.0) / 20.0 == pytest.approx(rate, rel=0.03)


def test_slow_cameras_give_every_frame_and_save_nothing_up() -> None:
    run = Run(20, 50)
    run.go(5.0)
    assert run.go(10.0) == 200
    run.period = 0.005
    assert run.go(1.0) <= 52


def test_no_rate_sends_nothing() -> None:
    assert Run(100, 0.0).go(2.0) == 0


def test_status_counts_latency_and_dropouts() -> None:
    run = Run(100, 30)
    run.go(5.0)
    assert not run.stream.lost(run.now)
    run.go(1.0, seen=False)
    assert run.stream.lost(run.now) and not run.stream.lost(run.now)  # once
    run.go(5.0)
    status = run.stream.status(run.now)
    assert status["tracking"] and status["problem"] is None
    assert status["latency_p50_s"] == pytest.approx(0.02)
    assert status["rate_hz"] == pytest.approx(98, abs=3)
    assert status["sent_hz"] == pytest.approx(29.5, abs=1.5)
    assert (status["dropouts"], status["reset_counter"]) == (1, 1)
    assert status["longest_dropout_s"] == pytest.approx(1.1, abs=0.05)
    assert status["rejected"]["occluded"] == 100


def test_a_problem_is_named() -> None:
    run = Run(100, 30)
    assert run.stream.problem(run.now) == "no pose of rigid body quad has come"
    run.go(2.0)
    assert run.stream.problem(run.now) is None
    run.stream.why = "it shares its link with bravo"
    assert run.stream.problem(run.now) == "it shares its link with bravo"
    run.stream.why, run.stream.rate_hz = "", 5.9
    assert "5.9 poses a second" in str(run.stream.problem(run.now))
    run.go(1.0, seen=False)
    assert "1.0 s old (most others: occluded)" in str(run.stream.problem(run.now))


# -- Which channel carries the poses: the rows of the table.


@each(
    ("before", "flies", "still_open", "ordinary", "after"),
    [
        (None, False, False, 1, 1),
        (None, True, False, 1, 1),
        (1, False, True, 2, 2),
        (1, False, True, None, None),
        (1, True, True, 2, 1),
        (1, True, True, None, 1),
        (1, True, False, 2, 2),
        (1, True, False, None, None),
    ],
)
def test_one_that_flies_keeps_its_channel(
    before: int | None, flies: bool, still_open: bool, ordinary: int | None, after: int | None
) -> None:
    way = PoseWay()
    way.choose(before, "", flies=False, still_open=False)
    why = "two vehicles have its system id" if ordinary is None else ""
    way.choose(ordinary, why, flies=flies, still_open=still_open)
    assert way.channel_id == after
    kept = after is not None and ordinary is None
    assert way.kept_despite == (why if kept else None)
    assert way.why_none == ("" if after is not None else why)
