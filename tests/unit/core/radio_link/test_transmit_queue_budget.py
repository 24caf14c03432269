"""The budget of bytes: never overdrawn, spent on what is urgent first and on vehicles alike, and nothing starves."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.radio_link.transmit_queue import (
    HEARTBEAT_WAITS_S,
    RESERVED_SHARE,
    WAITS_KEPT,
    Priority,
    TxQueue,
    Waits,
)
from skygcs.core.token_bucket import TokenBucket
from support.examples import examples
from support.table import each

Offer = tuple[float, Priority, int, int]
"""Seconds since the one before, class, bytes, vehicle."""

ANY_CLASS = st.sampled_from(list(Priority))
OFFERS = st.lists(st.tuples(st.floats(0, 2), ANY_CLASS, st.integers(12, 280), st.integers(1, 5)), max_size=60)


def run(queue: TxQueue[int], offers: list[Offer], until: float = 1e9) -> list[tuple[float, Priority, int, int, float]]:
    """Offer and send as a sender would: (sent at, class, bytes, vehicle, offered at) of everything that went."""
    reported: dict[int, tuple[Priority, int, int, float]] = {}
    sent = []
    now = 0.0

    def send_until(limit: float) -> None:
        nonlocal now
        while (at := queue.next_send_time(now)) is not None and at <= limit:
            assert at >= now
            now = at
            entry = queue.pop(now)
            assert entry is not None, "next_send_time is a promise"
            sent.append((now, *reported[entry[0]]))
        now = max(now, limit)

    at = 0.0
    for number, (pause_s, priority, size, vehicle) in enumerate(offers):
        at += pause_s
        send_until(at)
        reported[number] = (priority, size, vehicle, at)
        queue.offer(number, priority, at, size=size, flow=vehicle)
    send_until(until)
    return sent


def popped(queue: TxQueue[Any], now: float = 0.0) -> list[Any]:
    """What goes now."""
    return [entry for entry, _ in iter(lambda: queue.pop(now), None)]


"""Seconds since the one before, class, bytes, vehicle."""


@given(OFFERS, st.floats(20, 6000), st.floats(60, 1000))
@settings(max_examples=examples(50), deadline=None)
def test_over_no_time_more_is_sent_than_the_budget_and_one_burst(offers, bytes_per_s, burst) -> None:
    sent = run(TxQueue(TokenBucket(bytes_per_s, burst)), offers)
    for first in range(len(sent)):
        total = 0
        for at, _, size, _, _ in sent[first:]:
            total += size
            assert total <= bytes_per_s * (at - sent[first][0]) + max(burst, size + burst * (size > burst)) + 1


@given(OFFERS, st.floats(20, 6000), st.floats(600, 1000))
@settings(max_examples=examples(50), deadline=None)
def test_nothing_that_is_less_urgent_goes_while_something_urgent_waits(offers, bytes_per_s, burst) -> None:
    sent = run(TxQueue(TokenBucket(bytes_per_s, burst)), offers)
    for at, priority, _, _, _ in sent:
        for later, other, _, _, offered in sent:
            if other < priority and offered < at < later and priority is not Priority.HEARTBEAT:
                pytest.fail(f"{priority.name} went at {at} before {other.name}, offered at {offered}")


@given(OFFERS, st.floats(100, 6000))
@settings(max_examples=examples(40), deadline=None)
def test_everything_that_was_taken_goes_in_the_end(offers: list[Offer], bytes_per_s: float) -> None:
    queue: TxQueue[int] = TxQueue(TokenBucket(bytes_per_s, 300.0))
    sent = run(queue, offers)
    lost = sum(c.dropped + c.refused for c in queue.counters.values())
    assert len(sent) + lost == len(offers)
    assert sum(c.sent_bytes for c in queue.counters.values()) == sum(size for _, _, size, _, _ in sent)


def test_an_order_leaves_at_once_from_a_link_that_telemetry_saturates() -> None:
    queue: TxQueue[str] = TxQueue(TokenBucket(500.0, 500.0))
    for step in range(2000):
        now = step * 0.01
        queue.offer("forwarded", Priority.FORWARDED, now, size=100)
        if step % 100 == 50:
            queue.offer("order", Priority.COMMAND, now, size=45, flow=step)
        popped(queue, now)
    assert queue.counters[Priority.COMMAND].waits.percentile(1.0) == 0.0, "the reserve was there whenever one came"
    assert queue.counters[Priority.FORWARDED].dropped > 0


def test_a_stop_for_each_of_ten_vehicles_leaves_within_the_burst_and_the_rest_within_the_rate() -> None:
    queue: TxQueue[int] = TxQueue(TokenBucket(500.0, 500.0))
    now = 0.0
    for n in range(200):
        queue.offer(-1, Priority.FORWARDED, now, size=100)
        popped(queue, now)
        now = n * 0.01
    for vehicle in range(10):
        queue.offer(vehicle, Priority.EMERGENCY, now, size=45, flow=vehicle)
    start, gone = now, []
    while (at := queue.next_send_time(now)) is not None and len(gone) < 10:
        now = at
        gone += popped(queue, now)
    assert gone == list(range(10))
    assert now - start <= (450 - RESERVED_SHARE * 500) / 500 + 0.01


@each("flood", [Priority.COMMAND, Priority.SETPOINT, Priority.PROTOCOL])
def test_heartbeats_go_under_any_flood_and_any_budget(flood: Priority) -> None:
    queue: TxQueue[str] = TxQueue(TokenBucket(60.0, 120.0))
    sent = []
    for step in range(6000):
        now = step * 0.01
        queue.offer("flood", flood, now, size=45, flow=step % 7)
        if step % 100 == 0:
            queue.offer("heartbeat", Priority.HEARTBEAT, now, "heartbeat", size=21)
        sent += [now] * popped(queue, now).count("heartbeat")
    gaps = [b - a for a, b in zip([0.0, *sent], sent, strict=False)]
    assert max(gaps) <= 2 * HEARTBEAT_WAITS_S + 45 / 60 + 0.1


def test_vehicles_get_alike_many_bytes_however_many_frames_wait_for_each() -> None:
    queue: TxQueue[int] = TxQueue(TokenBucket(1000.0, 200.0))
    size_of = {1: 200, 2: 40, 3: 40, 4: 20}
    for vehicle, size in size_of.items():
        for _ in range(110 if vehicle == 2 else 40):
            queue.offer(vehicle, Priority.COMMAND, 0.0, size=size, flow=vehicle)
    bytes_of: Counter[int] = Counter()
    now = 0.0
    while bytes_of[4] < 700:  # nobody has run out of frames yet
        now = queue.next_send_time(now) or now
        entry = queue.pop(now)
        assert entry is not None
        bytes_of[entry[0]] += size_of[entry[0]]
    assert len(bytes_of) == 4
    assert max(bytes_of.values()) - min(bytes_of.values()) <= 200


def test_one_that_comes_again_after_each_of_its_frames_has_no_advantage() -> None:
    queue: TxQueue[str] = TxQueue()
    for _ in range(50):
        queue.offer("many", Priority.COMMAND, 0.0, size=50, flow=1)
    order: list[str] = []
    for _ in range(40):
        if "again" not in order[-1:]:
            queue.offer("again", Priority.COMMAND, 0.0, size=50, flow=2)
        order += [entry[0] for entry in [queue.pop(0.0)] if entry is not None]
    assert abs(order.count("many") - order.count("again")) <= 1


def test_who_was_silent_has_saved_nothing_up() -> None:
    queue: TxQueue[str] = TxQueue()
    queue.offer("busy", Priority.COMMAND, 0.0, size=10, flow="busy")
    for _ in range(100):
        queue.offer("busy", Priority.COMMAND, 0.0, size=10, flow="busy")
        queue.pop(0.0)
    for _ in range(10):
        for name in ("new", "busy"):
            queue.offer(name, Priority.COMMAND, 0.0, size=10, flow=name)
    assert 4 <= popped(queue)[:10].count("busy") <= 6


def test_a_flood_for_one_vehicle_drops_its_own_frames() -> None:
    queue: TxQueue[str] = TxQueue()
    queue.offer("other", Priority.FORWARDED, 0.0, flow=2)
    for _ in range(1000):
        queue.offer("flood", Priority.FORWARDED, 0.0, flow=1)
    assert "other" in popped(queue)


def test_a_setpoint_that_was_replaced_waits_from_the_newest_on_and_takes_its_size() -> None:
    queue: TxQueue[str] = TxQueue(TokenBucket(100.0, 100.0))
    queue.offer("first", Priority.SETPOINT, 0.0, size=50, flow=1)
    assert queue.pop(0.0) == ("first", Priority.SETPOINT)
    queue.offer("old", Priority.SETPOINT, 0.1, "k", size=50, flow=1)
    queue.offer("new", Priority.SETPOINT, 0.3, "k", size=40, flow=1)
    assert queue.next_send_time(0.3) == pytest.approx(0.4)
    assert queue.pop(0.4) == ("new", Priority.SETPOINT)
    assert queue.counters[Priority.SETPOINT].waits.percentile(1.0) == pytest.approx(0.1)


def test_a_frame_larger_than_the_burst_goes_when_all_is_saved_and_is_paid_for() -> None:
    queue: TxQueue[str] = TxQueue(TokenBucket(100.0, 100.0))
    for _ in range(2):
        queue.offer("large", Priority.FORWARDED, 0.0, size=280)
    assert queue.pop(0.0) is not None
    assert queue.next_send_time(0.0) == pytest.approx(2.8)


def test_a_clock_that_runs_for_months_makes_no_promise_it_does_not_keep() -> None:
    now = 3e7
    queue: TxQueue[str] = TxQueue(TokenBucket(547.3, 300.0, now))
    for _ in range(100):
        queue.offer("x", Priority.FORWARDED, now, size=77)
    for _ in range(100):
        at = queue.next_send_time(now)
        assert at is not None
        now = at
        assert queue.pop(now) is not None


def test_percentiles_are_of_the_last_waits_only() -> None:
    waits = Waits()
    assert waits.percentile(0.5) is None
    for _ in range(WAITS_KEPT):
        waits.add(100.0)
    for n in range(WAITS_KEPT):
        waits.add(float(n))
    assert waits.percentile(0.5) == WAITS_KEPT // 2
    assert waits.percentile(1.0) == WAITS_KEPT - 1


def test_the_status_names_every_class() -> None:
    queue: TxQueue[str] = TxQueue()
    queue.offer("x", Priority.COMMAND, 0.0, size=45)
    status = queue.status()
    assert list(status) == [p.name.lower() for p in Priority]
    assert status["command"]["waiting"] == 1
    queue.pop(0.25)
    none = dict.fromkeys(("waiting", "replaced", "dropped", "refused"), 0)
    sent = {"sent": 1, "sent_bytes": 45, "wait_p50_s": 0.25, "wait_p95_s": 0.25}
    assert queue.status()["command"] == {**none, **sent}


def test_the_last_class_keeps_to_its_part_and_holds_up_nobody() -> None:
    queue: TxQueue[int] = TxQueue(TokenBucket(1000.0, 400.0))
    queue.forwarded = TokenBucket(100.0, 100.0)
    for number in range(10):
        queue.offer(number, Priority.FORWARDED, 0.0, size=100)
    assert queue.pop(0.0) == (0, Priority.FORWARDED)
    assert queue.pop(0.0) is None
    assert queue.next_send_time(0.0) == 1.0
    queue.offer(99, Priority.PROTOCOL, 0.5, size=100)
    assert queue.next_send_time(0.5) == 0.5
    assert queue.pop(0.5) == (99, Priority.PROTOCOL)
    assert queue.pop(0.99) is None
    assert queue.pop(1.0) == (1, Priority.FORWARDED)


def test_it_tells_what_would_be_replaced() -> None:
    queue: TxQueue[int] = TxQueue()
    queue.offer(1, Priority.COMMAND, 0.0, "key", flow=3)
    where = (Priority.COMMAND, 3), (Priority.COMMAND, 4), (Priority.FORWARDED, 3)
    assert [queue.holds(priority, flow, "key") for priority, flow in where] == [True, False, False]
    queue.pop(0.0)
    assert not queue.holds(Priority.COMMAND, 3, "key")


def test_what_is_no_longer_wanted_is_taken_out_of_its_class() -> None:
    queue: TxQueue[int] = TxQueue()
    for number in range(6):
        queue.offer(number, Priority.COMMAND, 0.0, size=10, flow=number % 3)
    queue.offer(3, Priority.FORWARDED, 0.0)
    assert queue.drop(Priority.COMMAND, lambda entry: entry % 3 == 0 or entry == 5) == 3
    assert (len(queue), queue.counters[Priority.COMMAND].dropped) == (4, 3)
    assert popped(queue) == [1, 2, 4, 3]
    queue.offer(1, Priority.HEARTBEAT, 0.0, "beat")
    assert queue.drop(Priority.HEARTBEAT, lambda entry: True) == 1
    assert queue.next_send_time(5.0) is None
