"""Which events are marked on the bar of a recording."""

from __future__ import annotations

from typing import Any

from skygcs.web.replay_marks import MAX_MARKS, marks_of


def event(kind: str, **data: Any) -> dict[str, Any]:
    return {"kind": kind, "vehicle": "v1", "sysid": 1, "text": kind, "data": data, "time_unix_s": 0.0}


def test_what_a_person_looks_for_is_marked_and_the_rest_is_not() -> None:
    events = [
        (1.0, event("vehicle_discovered")),
        (2.0, event("armed")),
        (3.0, event("statustext", level=6)),
        (4.0, event("statustext", level=3)),
        (5.0, event("failsafe", failsafe=True)),
        (6.0, event("command")),
        (7.0, event("statustext")),
    ]
    assert [(mark["at_s"], mark["event"]["kind"]) for mark in marks_of(events)] == [
        (2.0, "armed"),
        (4.0, "statustext"),
        (5.0, "failsafe"),
    ]
    assert marks_of([]) == []


def test_of_too_many_the_first_ranks_stay_in_the_order_of_time() -> None:
    events = [(float(n), event("mode")) for n in range(2 * MAX_MARKS)]
    events[350] = (350.0, event("failsafe"))
    events[599] = (599.0, event("statustext", level=2))
    marks = marks_of(events)
    assert len(marks) == MAX_MARKS
    assert [mark["at_s"] for mark in marks] == sorted(mark["at_s"] for mark in marks)
    assert {350.0, 599.0} <= {mark["at_s"] for mark in marks}
