"""The events of a recording that are marked on its bar: what a person looks for first. Pure.

rank   events
----   -------------------------------------------------------------------
0      a failsafe, a vehicle lost and back, a reboot
1      texts of a vehicle from warning on
2      armed and disarmed, landed and taken off, changes of the mode
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

MAX_MARKS = 300
"""A bar of some hundred pixels shows no more; those of the first ranks stay."""

WARNING_LEVEL = 4
"""MAV_SEVERITY_WARNING."""

FIRST = frozenset({"failsafe", "vehicle_lost", "vehicle_back", "reboot", "duplicate"})
LAST = frozenset({"armed", "disarmed", "landed", "mode"})


def marks_of(events: Iterable[tuple[float, dict[str, Any]]]) -> list[dict[str, Any]]:
    """The marks of events with their times in the recording, in the order of time. A time is rounded up, so that a jump
    to it has the event behind it."""
    ranked = [(rank, at_s, event) for at_s, event in events if (rank := _rank(event)) is not None]
    if len(ranked) > MAX_MARKS:
        ranked = sorted(sorted(ranked, key=lambda r: r[0])[:MAX_MARKS], key=lambda r: r[1])
    return [{"at_s": math.ceil(at_s * 1000.0) / 1000.0, "event": event} for _, at_s, event in ranked]


def _rank(event: dict[str, Any]) -> int | None:
    kind, level = event["kind"], (event["data"] or {}).get("level")
    if kind in FIRST:
        return 0
    if kind == "statustext":
        return 1 if isinstance(level, int) and level <= WARNING_LEVEL else None
    return 2 if kind in LAST else None
