"""The flight of one formation: what each member is sent to, and why it stops.

    state      the references                                            goes on to
    --------   -------------------------------------------------------   ---------------------------------------------
    flying     towards their places about the leader                     stopping: asked for, a member left or is off
                                                                         its reference, the leader is not seen
    stopping   brake                                                     stopped: all stand
    stopped    stand; nothing is sent                                    - (another flight is begun)

A member that leaves is from then on an obstacle for the others, which stop: who flies on without it is a person's
choice. Members that are stopped stay under control and hold.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple

from skygcs.ext.formation.evasion import Evasion
from skygcs.ext.formation.leader import Leader, standing
from skygcs.ext.formation.separation_filter import LONGEST_STEP_S, Moving, Obstacle, SeparationFilter, Vector, moved

OFF_S = 1.0
"""A member that is so long farther from its reference than its part of the distance allows stops the formation: a gust
is over by then."""

AT_PLACE_M = 1.0
"""A member this near to its place counts as there."""


class FormationState(StrEnum):
    FLYING = "flying"
    STOPPING = "stopping"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class WantedFlight:
    """A formation that somebody asked for. ``heading_rad`` None: along the x axis."""

    targets: str | list[str]
    shape: str
    spacing_m: float
    heading_rad: float | None
    leader: str | None
    at_enu_m: Vector | None


class Reference(NamedTuple):
    """The point that a member is sent to now."""

    pos_enu_m: Vector
    vel_enu_mps: Vector
    acc_enu_mps2: Vector


@dataclass(slots=True)
class FormationFlight:
    """`step` once per period. Its filter's members are the members of the formation.

    ``tube_m``: of each member, how far it may be from its reference: what its distances count on.
    """

    leader: Leader
    filter: SeparationFilter
    tube_m: Mapping[str, float]
    led_by: str | None = None
    """The vehicle that leads; None: the leader is virtual."""
    state: FormationState = FormationState.FLYING
    reason: str = ""
    """Why it stops."""
    left: dict[str, str] = field(default_factory=dict)
    """Members that left, and why."""
    evasion: Evasion = field(default_factory=Evasion)
    _guided: dict[str, Moving] = field(default_factory=dict)
    """Places that a program gave instead of those about the leader ..."""
    _guided_until: float = -math.inf
    """... and until when."""
    least_m: tuple[float, str, str] | None = None
    """The least distance that two members were seen at, in the metric of the downwash ratio."""
    off_place_m: dict[str, float] = field(default_factory=dict)
    """Distance of each member, as measured, from its place; without members that are not seen."""
    _wanted: dict[str, Moving] = field(default_factory=dict)
    """Where each member was to be in the last step."""
    _off_since: dict[str, float] = field(default_factory=dict)

    @property
    def members(self) -> list[str]:
        """The names of those that are still members."""
        return [name for name in self.filter.members if name not in self.left]

    def stop(self, reason: str) -> None:
        """Brake all. Idempotent."""
        if self.state is FormationState.FLYING:
            self.state, self.reason = FormationState.STOPPING, reason

    def guide(self, places: Mapping[str, Moving], until: float) -> None:
        """Fly to a program's own places until then; a member without one stays. After it all stay where they are."""
        stay = {name: Moving(member.moving.pos_enu_m) for name, member in self.filter.members.items()}
        self._guided, self._guided_until = {**stay, **places}, until

    @property
    def guided(self) -> bool:
        """True while a program's places are in force."""
        return bool(self._guided)

    def follow_leader(self) -> None:
        """End a program's places: all stay about the leader, which stands in their middle. Idempotent."""
        if self._guided:
            self._guided = {}
            here = {name: member.moving.pos_enu_m for name, member in self.filter.members.items()}
            self.leader = standing(here, self.leader.yaw_rad, self.filter.bounds)

    def _places(self, leader: Moving | None, dt_s: float, now: float) -> dict[str, Moving]:
        """Where each member is to be now: by the program, or about the leader, which is advanced."""
        if self._guided and now >= self._guided_until:
            self.follow_leader()
        if self._guided:
            self._guided = {name: moved(moving, dt_s) for name, moving in self._guided.items()}
            return self._guided
        if self.led_by is None:
            self.leader.step(dt_s, now)
        elif leader is not None:
            self.leader.follow(leader, dt_s)
        else:
            self.stop(f"{self.led_by}, which leads, is not seen")
        return self.leader.places()

    def leave(self, name: str, why: str) -> None:
        """A member is not flown by this formation any more: the others stop. Idempotent."""
        if name not in self.left:
            self.left[name] = why
            self.stop(f"{name} left: {why}")

    def step(
        self,
        seen: Mapping[str, Moving],
        leader: Moving | None,
        obstacles: Sequence[Obstacle],
        dt_s: float,
        now: float,
    ) -> dict[str, Reference]:
        """Advance by ``dt_s``, and return what each member is sent to.

        ``seen``: members as they are measured now, carried on for their age. ``leader``: the vehicle that leads, the
        same way; None: it is virtual, or not seen.
        """
        if self.state is FormationState.STOPPED:
            return {}
        dt_s = min(dt_s, LONGEST_STEP_S)  # after a pause of the loop leader and places do not run ahead of all
        self._judge(seen, now)
        self._wanted = places = self._places(leader, dt_s, now)
        self.off_place_m = {
            name: math.dist(there.pos_enu_m, places[name].pos_enu_m) for name, there in seen.items() if name in places
        }
        asked: dict[str, list[Vector]] = {}
        if self.state is FormationState.FLYING:
            asked = self.evasion.asked(self.filter, places, obstacles, now)
        self.filter.step(asked, obstacles, dt_s)
        members = self.filter.members
        if self.state is FormationState.STOPPING and not any(any(m.moving.vel_enu_mps) for m in members.values()):
            self.state = FormationState.STOPPED
        return {name: Reference(*members[name].moving, members[name].acc_enu_mps2) for name in self.members}

    def _judge(self, seen: Mapping[str, Moving], now: float) -> None:
        """Stop where a member is off its reference; keep the least distance of any two."""
        for name in self.members:
            there = seen.get(name)
            off_m = (
                math.inf if there is None else math.dist(there.pos_enu_m, self.filter.members[name].moving.pos_enu_m)
            )
            if off_m <= self.tube_m[name]:
                self._off_since.pop(name, None)
            elif now - self._off_since.setdefault(name, now) >= OFF_S:
                what = "its position is old" if there is None else f"{off_m:.1f} m from its reference"
                self.stop(f"{name} is off: {what}; {self.tube_m[name]:.1f} m are counted on")
        names = sorted(name for name in seen if name in self.filter.members)
        for i, a in enumerate(names):
            for b in names[i + 1 :]:
                away_m = math.dist(self.filter.metric(seen[a].pos_enu_m), self.filter.metric(seen[b].pos_enu_m))
                if self.least_m is None or away_m < self.least_m[0]:
                    self.least_m = away_m, a, b

    def status(self, now: float) -> dict[str, Any]:
        """The flight as formation.status shows it."""
        places = self._wanted or self.leader.places()
        off = list(self.off_place_m.values())
        there = len(off) == len(self.filter.members) and all(metres <= AT_PLACE_M for metres in off)
        return {
            "state": self.state.value,
            "reason": self.reason,
            "settled": self.state is FormationState.FLYING and there and self.leader.rests and not self.guided,
            "leader": "program" if self.guided else self.led_by or "virtual",
            "middle_enu_m": [round(value, 2) for value in self.leader.moving.pos_enu_m],
            "vel_enu_mps": [round(value, 2) for value in self.leader.moving.vel_enu_mps],
            "heading_rad": self.leader.yaw_rad,
            "scale": round(self.leader.scale, 3),
            "rms_m": round(math.sqrt(sum(m * m for m in off) / len(off)), 2) if off else None,
            "least_m": None if self.least_m is None else round(self.least_m[0], 2),
            "least_pair": None if self.least_m is None else list(self.least_m[1:]),
            "members": [self._member(name, places[name].pos_enu_m, now) for name in self.filter.members],
        }

    def _member(self, name: str, place: Vector, now: float) -> dict[str, Any]:
        member, off_m = self.filter.members[name], self.off_place_m.get(name)
        progress = self.evasion.progress.get(name)
        return {
            "vehicle": name,
            "place_enu_m": [round(value, 2) for value in place],
            "off_place_m": None if off_m is None else round(off_m, 2),
            "at_place": off_m is not None and off_m <= AT_PLACE_M,
            "hindered": progress is not None and progress.hindered(now),
            "radius_m": round(member.radius_m, 2),
            "left": self.left.get(name),
        }
