"""What is reported of a list after Ctrl-C. The whole of it, with processes: tests/system/test_mission_interrupt.py."""

from __future__ import annotations

from typing import Any

from skygcs.cli.missions import held_line
from skygcs.core.mission.item import MissionItem, MissionType
from skygcs.core.mission.plan import MissionPlan
from skygcs.core.mission.qgc import write_qgc
from support.table import each


def waypoints(count: int, first_m: float = 10.0) -> tuple[MissionItem, ...]:
    return tuple(
        MissionItem.from_params(16, 3, (0.0, 0.0, 0.0, 0.0, 43.78 + n / 1e4, -79.46, first_m + n), True)
        for n in range(count)
    )


NEW, OLD = waypoints(4), waypoints(6, 50.0)
CAMERA = MissionItem(530, 2)


def line(held: tuple[MissionItem, ...], state: str, sent: tuple[MissionItem, ...] = NEW, **more: Any) -> str:
    plan = MissionPlan(mission=held)
    last = {"state": state, "message": "cancelled; whatever"}
    answer = {"items": len(held), "last": last, "plan": write_qgc(plan), "why": "", **more}
    return held_line(answer, MissionPlan(mission=sent), MissionType.MISSION, "/x/new.plan", "ardupilot")


@each(
    ("said", "expected"),
    [
        (line(NEW, "unknown"), "holds the whole mission of new.plan (4 mission items)"),
        (line(OLD, "unchanged"), "holds 6 mission items, not those of new.plan: as before"),
        (line((NEW[0], *OLD[1:]), "unchanged"), "holds 6 mission items, not those of new.plan: as before"),
        (line(OLD, "partial"), "holds 6 mission items, not those of new.plan; check it before you fly"),
        (line((*NEW[:2], *OLD[2:]), "partial"), "holds 6 mission items: the first 2 are of new.plan, the other 4"),
        (line(NEW[:1], "partial"), "holds 1 mission item: the first is of new.plan, 3 are missing; do not fly"),
        (line((), "unknown"), "holds no mission"),
        (line(NEW, "partial", (CAMERA, *NEW)), "holds the whole mission of new.plan"),  # as this firmware takes it
        (line((), "partial", items=None, why="no answer"), "cancelled; whatever; reading what it holds failed: no"),
        (line(NEW, "partial", plan=None), "holds 4 mission items"),
    ],
)
def test_what_is_held_is_said_against_what_was_sent(said: str, expected: str) -> None:
    assert said.startswith(expected)
