"""The transmit queue: strict classes, bounds, latest wins, first in first out within a class."""

from __future__ import annotations

import itertools
from collections.abc import Hashable

from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.radio_link.transmit_queue import BOUND, DROPS_OLDEST, Priority, TxQueue
from support.table import each


def drained(queue: TxQueue[object]) -> list[object]:
    return [entry for entry, _ in iter(lambda: queue.pop(0.0), None)]


@each("priority", list(Priority))
def test_a_full_class_drops_its_oldest_or_refuses_and_counts_it(priority: Priority) -> None:
    queue: TxQueue[object] = TxQueue()
    bound, drops = BOUND[priority], priority in DROPS_OLDEST
    taken = [queue.offer(n, priority, 0.0) for n in range(bound + 3)]
    assert taken == [True] * bound + [drops] * 3
    assert drained(queue) == list(range(3 * drops, bound + 3 * drops))
    counters = queue.counters[priority]
    assert (counters.dropped, counters.refused, counters.sent) == (3 * drops, 3 * (not drops), bound)


def test_a_full_class_takes_a_newer_value_of_a_waiting_key() -> None:
    queue: TxQueue[object] = TxQueue()
    for n in range(BOUND[Priority.SETPOINT]):
        assert queue.offer(n, Priority.SETPOINT, 0.0, n)
    assert not queue.offer("new", Priority.SETPOINT, 0.0, "new")
    assert queue.offer("newer", Priority.SETPOINT, 0.0, 0)
    assert queue.counters[Priority.SETPOINT].replaced == 1
    assert queue.pop(0.0) == ("newer", Priority.SETPOINT)


def test_no_flood_keeps_a_heartbeat_waiting_for_longer_than_a_second() -> None:
    queue: TxQueue[object] = TxQueue()
    sent_at: list[float] = []
    for step in range(1000):
        now = step * 0.01
        queue.offer(step, Priority.COMMAND, now)
        if step % 100 == 0:
            queue.offer("heartbeat", Priority.HEARTBEAT, now, "heartbeat")
        entry = queue.pop(now)
        if entry == ("heartbeat", Priority.HEARTBEAT):
            sent_at.append(now)
    gaps = [b - a for a, b in itertools.pairwise([0.0, *sent_at])]
    assert len(sent_at) >= 5
    assert max(gaps) <= 2.0, "it waits a second, and the next one is queued within a second"


def test_an_overdue_heartbeat_still_waits_for_an_emergency() -> None:
    queue: TxQueue[object] = TxQueue()
    queue.offer("heartbeat", Priority.HEARTBEAT, 0.0, "heartbeat")
    queue.offer("newer heartbeat", Priority.HEARTBEAT, 0.9, "heartbeat")
    queue.offer("order", Priority.COMMAND, 0.9)
    queue.offer("stop", Priority.EMERGENCY, 0.9)
    assert queue.pop(1.1) == ("stop", Priority.EMERGENCY)
    assert queue.pop(1.1) == ("newer heartbeat", Priority.HEARTBEAT)
    assert queue.pop(9.9) == ("order", Priority.COMMAND)


def test_a_cleared_heartbeat_lends_its_waiting_to_no_other() -> None:
    queue: TxQueue[object] = TxQueue()
    queue.offer("old", Priority.HEARTBEAT, 0.0)
    queue.clear()
    queue.offer("new", Priority.HEARTBEAT, 5.0)
    queue.offer("order", Priority.COMMAND, 5.0)
    assert queue.pop(5.1) == ("order", Priority.COMMAND)


def test_clear_forgets_everything_and_counts_it_as_dropped() -> None:
    queue: TxQueue[object] = TxQueue()
    queue.offer(1, Priority.COMMAND, 0.0)
    queue.offer(2, Priority.SETPOINT, 0.0, "k")
    assert queue.clear() == 2
    assert len(queue) == 0 and queue.pop(0.0) is None
    assert queue.counters[Priority.COMMAND].dropped == queue.counters[Priority.SETPOINT].dropped == 1


OFFERS = st.tuples(st.sampled_from(list(Priority)), st.none() | st.integers(0, 5))


@given(st.lists(OFFERS | st.none(), max_size=400))
def test_the_queue_behaves_as_lists_would(steps: list[tuple[Priority, int | None] | None]) -> None:
    queue: TxQueue[int] = TxQueue()
    model: dict[Priority, list[tuple[Hashable, int]]] = {p: [] for p in Priority}
    for number, step in enumerate(steps):
        if step is None:
            expected = next(((m.pop(0)[1], p) for p, m in model.items() if m), None)
            assert queue.pop(0.0) == expected
            continue
        priority, key = step
        entries = model[priority]
        at = next((i for i, (k, _) in enumerate(entries) if key is not None and k == key), None)
        taken = True
        if at is not None:
            entries[at] = (key, number)
        elif len(entries) < BOUND[priority] or priority in DROPS_OLDEST:
            if len(entries) >= BOUND[priority]:
                entries.pop(0)
            entries.append((key, number))
        else:
            taken = False
        assert queue.offer(number, priority, 0.0, key) is taken
        assert len(queue) == sum(map(len, model.values()))
