"""The poses of one vehicle: which of the frames' poses are sent to it, and when. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from skygcs.ext.mocap.lost_body import OwnEstimate
from skygcs.ext.mocap.pose import Pose, Vector
from skygcs.ext.mocap.pose_filter import VERDICTS, FilterLimits, PoseFilter, no_others
from skygcs.ext.mocap.pose_messages import LEAST_HZ
from skygcs.ext.mocap.pose_statistics import PoseStatistics

SLACK = 0.25
"""Part of a period by which a pose may be early: of frames at 100 Hz every third is sent at 30 Hz."""


class PoseStream:
    """`offer` each frame; what it returns is to be sent. ``why`` says why nothing is sent although the body is seen."""

    def __init__(self, body: str, limits: FilterLimits) -> None:
        self.body = body
        self.filter = PoseFilter(limits)
        self.statistics = PoseStatistics()
        self.why = ""
        self.rate_hz = 0.0
        """The rate at which it is sent, by the file and its link."""
        self._next_at = float("-inf")

    def offer(
        self,
        pose: Pose | None,
        now: float,
        *,
        armed: bool,
        own: OwnEstimate | None = None,
        others: Callable[[], Iterable[Vector]] = no_others,
    ) -> Pose | None:
        """One frame of the capture system, with None if the body is not in it. An accepted pose, or None. Arguments: as
        `PoseFilter.judge`."""
        if self.filter.judge(pose, now, armed=armed, own=own, others=others) != "accepted" or pose is None:
            return None
        self.statistics.arrived(pose.at, now)
        return pose

    def due(self, pose: Pose, rate_hz: float) -> bool:
        """True if this pose is to be sent, at this rate; its turn is then taken."""
        self.rate_hz = rate_hz
        if rate_hz <= 0.0 or pose.at < self._next_at - SLACK / rate_hz:
            return False
        period_s = 1.0 / rate_hz
        self._next_at = (self._next_at if pose.at - self._next_at < period_s else pose.at) + period_s
        return True

    def lost(self, now: float) -> bool:
        """True once, when the body is lost after it was tracked."""
        return self.filter.lost(now) and self.statistics.gone()

    def fresh(self, now: float) -> bool:
        """True if poses come and are sent."""
        return not self.filter.lost(now) and not self.why

    def problem(self, now: float) -> str | None:
        """Why its vehicle cannot fly by these poses now; None if it can."""
        age_s = self.statistics.age_s(now)
        if age_s is None:
            return f"no pose of rigid body {self.body} has come"
        if self.filter.lost(now):
            last = max(VERDICTS[1:], key=lambda verdict: self.filter.counts[verdict])
            return f"the last good pose of rigid body {self.body} is {age_s:.1f} s old (most others: {last})"
        if self.why:
            return self.why
        if self.rate_hz < LEAST_HZ:
            return f"its link carries {self.rate_hz:.1f} poses a second; an estimator wants {LEAST_HZ:g}"
        return None

    def status(self, now: float) -> dict[str, Any]:
        """JSON-able; the section "mocap" of a vehicle's state."""
        self.filter.lost(now)
        return {
            "body": self.body,
            "tracking": self.filter.tracking,
            "problem": self.problem(now),
            **self.statistics.status(now),
            "limit_hz": round(self.rate_hz, 1),
            "reset_counter": self.filter.reset_counter,
            "rejected": {verdict.replace(" ", "_"): self.filter.counts[verdict] for verdict in VERDICTS[1:]},
        }
