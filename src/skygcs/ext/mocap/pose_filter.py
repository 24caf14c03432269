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
    searching   is steady, but when it was seen first it could not be      out of reach
                the same body (`lost_body`), and the vehicle is armed
    searching   begins anew where such a body was seen last                out of reach
    tracking    is plausible after the last accepted one                   accepted
    tracking    is not                                                     jump
    tracking    none was accepted for max_age_s                                           searching

Plausible: the body moved by at most max_jump_m plus SPEED_MPS times the time between the two, and turned by at most
max_jump_rad plus TURN_RADPS times that time.

A body that comes back elsewhere is most likely another one, whose markers were taken for it. While the vehicle is armed
nothing is sent then, and its autopilot's own failsafe acts. It is judged when it is seen first: one that stands still
where the vehicle could not be then is not taken for it later, when the vehicle could have come there.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from skygcs.ext.mocap.lost_body import SPEED_MPS, LostBody, OwnEstimate
from skygcs.ext.mocap.pose import Pose, Vector, angle_between_rad

Verdict = Literal["accepted", "occluded", "old", "repeated", "searching", "out of reach", "jump"]

VERDICTS: tuple[Verdict, ...] = ("accepted", "occluded", "old", "repeated", "searching", "out of reach", "jump")

STEADY_COUNT = 5
STEADY_S = 0.1
"""A body that is found again counts after so many plausible poses over this time: markers that are taken for another
body's for a frame or two are not sent. At 100 Hz these are ten poses, at 30 Hz five."""

TURN_RADPS = 10.0
"""Largest turn rate of a vehicle in a capture volume, used with `SPEED_MPS`; the larger, the more of a jump passes."""


def no_others() -> Iterable[Vector]:
    """Places of no other bodies."""
    return ()


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
        self._run_is_it = True
        """True if the body of this run could be the vehicle's when it was seen first."""
        self._other: Pose | None = None
        """The last pose of a run that could not."""
        self._lost = LostBody()

    def judge(
        self,
        pose: Pose | None,
        now: float,
        *,
        armed: bool = False,
        own: OwnEstimate | None = None,
        others: Callable[[], Iterable[Vector]] = no_others,
    ) -> Verdict:
        """Judge whether this pose may be sent: "accepted". ``armed``: whether its vehicle is; ``own``: its own estimate
        of its position; ``others``: the places of the other bodies, asked for only when one is found again."""
        verdict = self._judge(pose, now, armed, own, others)
        self.counts[verdict] += 1
        return verdict

    def lost(self, now: float) -> bool:
        """True if no pose was accepted for max_age_s; tracking then has ended."""
        accepted = self.accepted
        if self.tracking and (accepted is None or now - accepted.at > self.limits.max_age_s):
            self.tracking = False
            self._run = 0
        return not self.tracking

    def _judge(
        self,
        pose: Pose | None,
        now: float,
        armed: bool,
        own: OwnEstimate | None,
        others: Callable[[], Iterable[Vector]],
    ) -> Verdict:
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
            return self._search(pose, before, armed, own, others)
        assert accepted is not None
        if not self._plausible(accepted, pose):
            return "jump"
        self.accepted = pose
        self._lost.seen(pose, own)
        return "accepted"

    def _search(
        self,
        pose: Pose,
        before: Pose | None,
        armed: bool,
        own: OwnEstimate | None,
        others: Callable[[], Iterable[Vector]],
    ) -> Verdict:
        together = before is not None and pose.at - before.at <= self.limits.max_age_s
        if self._run == 0 or before is None or not together or not self._plausible(before, pose):
            self._run, self._run_began = 1, pose.at
            self._run_is_it = self._may_be(pose, own, others)
            return "searching"
        self._run += 1
        if not self._run_is_it:
            self._other = pose
        if self._run < STEADY_COUNT or pose.at - self._run_began < STEADY_S:
            return "searching"
        if armed and not self._run_is_it:
            return "out of reach"
        if self.accepted is not None:
            self.reset_counter = (self.reset_counter + 1) % 256
        self.tracking = True
        self.accepted, self._other = pose, None
        self._lost.seen(pose, own, again=True)
        return "accepted"

    def _may_be(self, pose: Pose, own: OwnEstimate | None, others: Callable[[], Iterable[Vector]]) -> bool:
        """True if a body that is found again can be the one that was lost."""
        other, margin_m = self._other, self.limits.max_jump_m
        if other is not None and math.dist(other.pos_m, pose.pos_m) <= margin_m:
            return False
        return self._lost.may_be(pose, own, others(), margin_m)

    def _plausible(self, before: Pose, pose: Pose) -> bool:
        apart_s = pose.at - before.at
        return (
            math.dist(before.pos_m, pose.pos_m) <= self.limits.max_jump_m + SPEED_MPS * apart_s
            and angle_between_rad(before.q, pose.q) <= self.limits.max_jump_rad + TURN_RADPS * apart_s
        )
