"""The daemon's events: which are kept when many come."""

from __future__ import annotations

from typing import Any

import structlog

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


def test_what_raises_an_alarm_is_logged_as_a_warning_and_its_end_is_not() -> None:
    """A lost vehicle was logged at level info."""
    began_and_ended: list[tuple[str, dict[str, Any], str, dict[str, Any]]] = [
        ("vehicle_lost", {"age_s": 3.0}, "vehicle_back", {}),
        ("vehicle_lost", {"age_s": 3.0}, "vehicle_lost", {"forgotten": True}),
        ("failsafe", {"failsafe": True}, "failsafe", {"failsafe": False}),
        ("fence", {"outside": True}, "fence", {"outside": False}),
        ("control", {"state": "held"}, "control", {"state": "flying"}),
        ("plan", {"state": "stopped"}, "plan", {"state": "flying"}),
        ("command", {"order": "stop", "ok": False}, "command", {"order": "stop", "ok": True}),
        ("separation", {"level": "warning", "with": "b"}, "separation", {"level": None, "with": "b"}),
        ("duplicate", {"change": "duplicate"}, "duplicate", {"change": "duplicate_over"}),
        ("uplink_lost", {}, "uplink_back", {}),
        ("fault", {}, "mode", {}),
    ]
    for kind, data, other, over in began_and_ended:
        with structlog.testing.capture_logs() as logged:
            events = EventLog(Clock())
            events.publish(Event(kind, "a", 1, "begins", data))
            events.publish(Event(other, "a", 1, "is over", over))
            events.flush()
        levels = {entry["event"]: entry["log_level"] for entry in logged}
        assert levels["begins"] == "warning" and levels.get("is over") != "warning", (kind, levels)
