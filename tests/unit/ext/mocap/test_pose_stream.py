"""The poses of one vehicle: rates, statistics, and what is wrong with them."""

from __future__ import annotations

import math

import pytest

from skygcs.ext.mocap.pose import Pose, about_up
from skygcs.ext.mocap.pose_filter import FilterLimits
from skygcs.ext.mocap.pose_stream import PoseStream
from support.table import each


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
