"""How many events pass, and that the last one always does."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.vehicle.event_limiter import MAX_SOURCES, STATE, TEXT, EventLimiter
from skygcs.events import Event


def event(kind: str = "mode", vehicle: str | None = "v1", text: str = "x", **data: object) -> Event:
    return Event(kind, vehicle, 1, text, data)


@pytest.fixture
def limiter() -> EventLimiter:
    return EventLimiter()


def test_a_few_events_pass_as_they_are_and_at_once(limiter: EventLimiter) -> None:
    given = [event(text=str(i)) for i in range(STATE.burst)]
    assert [limiter.offer(e, 0.01 * i) for i, e in enumerate(given)] == [(e,) for e in given]
    assert limiter.withheld == 0


def test_further_ones_are_summed_up_and_the_newest_passes_at_the_end_of_the_period(limiter: EventLimiter) -> None:
    for i in range(STATE.burst + 40):
        limiter.offer(event(text=f"mode {i}", mode=i), 1.0)
    assert limiter.tick(1.0 + STATE.period_s - 0.01) == ()
    (summary,) = limiter.tick(1.0 + STATE.period_s)
    assert summary.text == f"mode {STATE.burst + 39} (39 more of this kind in the last 1.0 s)"
    assert summary.data == {"mode": STATE.burst + 39, "withheld": 39, "withheld_s": 1.0}
    assert limiter.withheld == 39 and limiter.tick(100.0) == ()


def test_one_that_was_alone_withheld_passes_unchanged(limiter: EventLimiter) -> None:
    for i in range(STATE.burst + 1):
        limiter.offer(event(text=str(i)), 0.0)
    assert limiter.tick(1.0) == (event(text=str(STATE.burst)),)


def test_after_a_quiet_while_the_whole_burst_is_there_again(limiter: EventLimiter) -> None:
    for _ in range(STATE.burst + 1):
        limiter.offer(event(), 0.0)
    limiter.tick(1.0)
    limiter.tick(1.0 + STATE.burst * STATE.period_s)
    now = 2.0 + STATE.burst * STATE.period_s
    assert sum(len(limiter.offer(event(), now)) for _ in range(STATE.burst)) == STATE.burst


def test_vehicles_and_kinds_do_not_use_up_each_others_share(limiter: EventLimiter) -> None:
    for _ in range(1000):
        limiter.offer(event("statustext", level=6), 0.0)
    other = [event("statustext", vehicle="v2", level=6), event("failsafe"), event("statustext", level=2, text="Crash")]
    assert [limiter.offer(e, 0.0) for e in other] == [(e,) for e in other]


def test_what_undoes_each_other_is_summed_up_together(limiter: EventLimiter) -> None:
    for i in range(101):
        limiter.offer(event("disarmed" if i % 2 else "armed"), 0.0)
    (summary,) = limiter.tick(1.0)
    assert summary.kind == "armed"


def test_at_the_end_nothing_is_kept_back(limiter: EventLimiter) -> None:
    for i in range(TEXT.burst + 5):
        limiter.offer(event("statustext", text=str(i)), 0.0)
    (last,) = limiter.flush(0.5)
    assert last.text == f"{TEXT.burst + 4} (4 more of this kind in the last 0.5 s)"
    assert limiter.flush(0.6) == ()


def test_a_flood_of_sources_does_not_grow_the_table(limiter: EventLimiter) -> None:
    for i in range(20 * MAX_SOURCES):
        limiter.offer(event(vehicle=f"v{i}"), 0.0)
    assert len(limiter._buckets) <= MAX_SOURCES + 1
    limiter.tick(10_000.0)
    limiter.tick(20_000.0)
    assert not limiter._buckets


KINDS = st.sampled_from(["armed", "disarmed", "mode", "failsafe", "statustext", "vehicle_lost", "vehicle_back"])
STEPS = st.lists(st.tuples(KINDS, st.sampled_from([0.0, 0.02, 0.5, 3.0])), max_size=400)


@given(STEPS)
@pytest.mark.parametrize("ticks", [True, False])
def test_what_passed_last_is_what_happened_last(ticks: bool, steps: list[tuple[str, float]]) -> None:
    groups = {"disarmed": "armed", "vehicle_back": "vehicle_lost"}
    limiter, now = EventLimiter(), 0.0
    happened: dict[str, Event] = {}
    passed: dict[str, Event] = {}
    reported = 0
    for i, (kind, pause_s) in enumerate(steps):
        now += pause_s
        new = event(kind, text=kind, number=i)
        happened[groups.get(kind, kind)] = new
        out = [*(limiter.tick(now) if ticks else ()), *limiter.offer(new, now)]
        for e in out:
            reported += 1 + int(str(e.data.get("withheld", 0)))
            passed[groups.get(e.kind, e.kind)] = e
    for e in limiter.tick(now + 10.0):
        reported += 1 + int(str(e.data.get("withheld", 0)))
        passed[groups.get(e.kind, e.kind)] = e
    assert {k: e.data["number"] for k, e in passed.items()} == {k: e.data["number"] for k, e in happened.items()}
    assert reported == len(steps)
