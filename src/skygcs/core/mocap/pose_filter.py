"""Which poses of one rigid body may be sent to its vehicle. Pure.

    state       a pose                                                     verdict        then
    ---------   --------------------------------------------------------   ------------   ---------------------------
    any         is missing, or not finite                                  occluded
    any         is not newer than the one before                           old
    any         is bit for bit the one before                              repeated
    searching   is plausible after the one before, STEADY_COUNT times in   searching      tracking with the last of
                a row over STEADY_S                                                       them; reset, if it is not the
                                                                                          first time
    searching   is not plausible after the one before                      searching      the count begins anew
    searching   is steady, but not within reach of the last accepted one   out of reach
                while the vehicle is armed
    tracking    is plausible after the last accepted one                   accepted
    tracking    is not                                                     jump
    tracking    none was accepted for max_age_s                                           searching

Plausible: the body moved by at most max_jump_m plus SPEED_MPS times the time between the two, and turned by at most
max_jump_rad plus TURN_RADPS times that time.

A body that comes back elsewhere is most likely another one, whose markers were taken for it. While the vehicle is armed
nothing is sent then, and its autopilot's own failsafe acts.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Literal

from skygcs.core.mocap.pose import Pose, angle_between_rad

Verdict = Literal["accepted", "occluded", "old", "repeated", "searching", "out of reach", "jump"]

VERDICTS: tuple[Verdict, ...] = ("accepted", "occluded", "old", "repeated", "searching", "out of reach", "jump")

STEADY_COUNT = 5
STEADY_S = 0.1
"""A body that is found again counts after so many plausible poses over this time: markers that are taken for another
body's for a frame or two are not sent. At 100 Hz these are ten poses, at 30 Hz five."""

SPEED_MPS = 5.0
TURN_RADPS = 10.0
"""Of a vehicle in a capture volume; the faster, the more of a jump passes."""

DRIFT_MPS = 2.0
DRIFT_MAX_S = 3.0
"""How fast, and for how long, a vehicle without poses may have moved from where it was seen last. PX4's failsafe acts
5 s after the last pose (EKF2_NOAID_TOUT); ArduCopter 4.6.3's acted after 8 s in SITL, and it had drifted by 3 m when it
was on the ground, 13 s later."""


@dataclass(frozen=True, slots=True)
class FilterLimits:
    """``max_jump_m`` and ``max_jump_rad`` on top of motion; ``max_age_s``: without a pose for so long it is lost."""

    max_jump_m: float = 0.3
    max_jump_rad: float = 0.5
    max_age_s: float = 0.2


class PoseFilter:
    """Call `judge` for every frame of the capture system, with None if the body is not in it. Poses are in ENU."""

    def __init__(self, limits: FilterLimits) -> None:
        self.limits = limits
        self.tracking = False
        self.accepted: Pose | None = None
        """The last pose that was accepted."""
        self.reset_counter = 0
        """Increased, modulo 256, each time the body was lost and found again."""
        self.counts: Counter[Verdict] = Counter()
        self._newest: Pose | None = None
        self._run_began = -math.inf
        self._run = 0

    def judge(self, pose: Pose | None, now: float, *, armed: bool = False) -> Verdict:
        """Whether this pose may be sent: "accepted". ``armed``: whether its vehicle is."""
        verdict = self._judge(pose, now, armed)
        self.counts[verdict] += 1
        return verdict

    def lost(self, now: float) -> bool:
        """True if no pose was accepted for max_age_s; tracking then has ended."""
        accepted = self.accepted
        if self.tracking and (accepted is None or now - accepted.at > self.limits.max_age_s):
            self.tracking = False
            self._run = 0
        return not self.tracking

    def _judge(self, pose: Pose | None, now: float, armed: bool) -> Verdict:
        if pose is None or not pose.finite():
            self.lost(now)
            return "occluded"
        before, accepted = self._newest, self.accepted
        if before is not None and pose.at <= before.at:
            return "old"
        if now - pose.at > self.limits.max_age_s:
            self.lost(now)
            return "old"
        if before is not None and pose.same_place(before):
            self.lost(now)
            return "repeated"
        self._newest = pose
        if self.lost(pose.at):
            return self._search(pose, before, armed)
        assert accepted is not None
        if not self._plausible(accepted, pose):
            return "jump"
        self.accepted = pose
        return "accepted"

    def _search(self, pose: Pose, before: Pose | None, armed: bool) -> Verdict:
        together = before is not None and pose.at - before.at <= self.limits.max_age_s
        if self._run == 0 or before is None or not together or not self._plausible(before, pose):
            self._run, self._run_began = 1, pose.at
            return "searching"
        self._run += 1
        if self._run < STEADY_COUNT or pose.at - self._run_began < STEADY_S:
            return "searching"
        last = self.accepted
        if last is not None:
            reach_m = self.limits.max_jump_m + DRIFT_MPS * min(pose.at - last.at, DRIFT_MAX_S)
            if armed and math.dist(last.pos_m, pose.pos_m) > reach_m:
                return "out of reach"
            self.reset_counter = (self.reset_counter + 1) % 256
        self.tracking = True
        self.accepted = pose
        return "accepted"

    def _plausible(self, before: Pose, pose: Pose) -> bool:
        apart_s = pose.at - before.at
        return (
            math.dist(before.pos_m, pose.pos_m) <= self.limits.max_jump_m + SPEED_MPS * apart_s
            and angle_between_rad(before.q, pose.q) <= self.limits.max_jump_rad + TURN_RADPS * apart_s
        )
