"""Legs of a multirotor's orders as the courses of what goes only where its nose points.

legs of the mission and of orders         a plane flies                            a rover drives
---------------------------------------   --------------------------------------   -----------------------------
GoTo, and more                            past the place (`Turning.reached_m`)     through it
GoTo, as the last                         a circle about it, for good              to a stop there
GoTo and Wait(0), as the last             past it, and the next item               through it
GoTo and Wait                             a circle, for so long from the circle    a stop there, for so long
GoTo with a climb's speed (a take-off)    a climb-out ahead                        nothing
Land                                      a glide to the place                     nothing
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from skygcs.sim.body import Body
from skygcs.sim.legs import ClimbOut, Course, Glide, GoTo, Land, Leg, Plan, Stay, Wait


@dataclass(frozen=True, slots=True)
class Turning:
    """Acceptance radius of a place, and radius of circles (positive clockwise; 0: the vehicle stops instead)."""

    reached_m: float
    circle_m: float = 0.0


class CoursePlan(Plan):
    """The legs still to go. ``body`` is what goes them; ``turning`` is read whenever legs are made."""

    def __init__(self, body: Callable[[], Body], turning: Callable[[], Turning]) -> None:
        super().__init__()
        self._body = body
        self._turning = turning

    def fly(self, *legs: Leg) -> None:
        """Forget what was planned and go these, as courses."""
        turning, body = self._turning(), self._body()
        wing = turning.circle_m != 0.0
        found: list[Leg] = []
        stood: GoTo | None = None
        for i, leg in enumerate(legs):
            following = legs[i + 1] if i + 1 < len(legs) else None
            match leg:
                case GoTo(climb_mps=climb_mps) if climb_mps is not None:
                    stood = leg
                    found += [ClimbOut(body.yaw_rad, leg.up_m)] * wing
                case GoTo() if wing and isinstance(following, Land):
                    continue
                case GoTo() if stood is not None and (leg.east_m, leg.north_m) == (stood.east_m, stood.north_m):
                    continue  # a take-off without a place of its own ends where it has led to
                case GoTo():
                    found += self._to(leg, following, turning)
                case Wait() if isinstance(legs[i - 1], GoTo):
                    continue
                case Land():
                    found += [Glide(leg.east_m, leg.north_m)] * wing
                case _:
                    found.append(leg)
        super().fly(*found)

    @staticmethod
    def _to(leg: GoTo, following: Leg | None, turning: Turning) -> list[Leg]:
        stays = following is None or (isinstance(following, Wait) and following.seconds > 0)
        course = Course(
            leg.east_m,
            leg.north_m,
            leg.up_m,
            turning.reached_m,
            turning.circle_m if stays else 0.0,
            stops=stays and not turning.circle_m,
        )
        if isinstance(following, Wait) and following.seconds > 0:
            return [Stay(course, following.seconds)]
        return [course]
