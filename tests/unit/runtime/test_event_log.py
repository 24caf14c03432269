"""The daemon's events: which are kept when many come."""

from __future__ import annotations

from skygcs.events import Event
from skygcs.runtime.event_log import MAX_EVENTS, EventLog


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_a_flood_of_one_kind_displaces_no_other() -> None:
    clock = Clock()
    events = EventLog(clock)
    events.publish(Event("warning", None, None, "the channel is crowded", {}))
    for n in range(3 * MAX_EVENTS):
        clock.now += 10.0  # slowly enough for the limiter
        kind = "vehicle_lost" if n % 3 else "vehicle_discovered"
        events.publish(Event(kind, f"v{n}", n, f"event {n}", {}))
    kept = events.recent
    assert len(kept) == MAX_EVENTS
    assert kept[0]["kind"] == "warning" and kept[-1]["text"] == f"event {3 * MAX_EVENTS - 1}"
    numbers = [e["sysid"] for e in kept[1:]]
    assert numbers == sorted(numbers)


def test_the_oldest_of_one_kind_make_room() -> None:
    clock = Clock()
    events = EventLog(clock)
    for n in range(MAX_EVENTS + 5):
        clock.now += 10.0
        events.publish(Event("mode", "alpha", 1, f"event {n}", {}))
    assert [e["text"] for e in events.recent] == [f"event {n}" for n in range(5, MAX_EVENTS + 5)]
