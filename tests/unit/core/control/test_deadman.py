"""The fleet's dead-man: once per silence, never before it, and also where nobody ever came."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control.deadman import DeadMan
from skygcs.errors import ConfigError
from support.table import each


def test_is_off_by_default_and_does_not_fire_over_a_fleet_nobody_looks_at_and_nobody_controls() -> None:
    off = DeadMan()
    off.alive("client 1", 0.0)
    assert off.check(1e9) is None
    assert DeadMan(10.0).check(1e9) is None


def test_fires_once_when_the_last_of_all_falls_silent() -> None:
    dead_man = DeadMan(10.0, "land")
    dead_man.alive("ground station 255", 0.0)
    dead_man.alive("client 1", 4.0)
    assert dead_man.check(13.9) is None
    fired = dead_man.check(14.0)
    assert fired is not None
    assert fired.action == "land"
    assert fired.reason == "no operator or client (last: client 1) for 10.0 s (limit 10 s)"
    assert dead_man.check(15.0) is None
    assert dead_man.check(1000.0) is None


def test_counts_from_where_control_began_if_nobody_ever_came() -> None:
    dead_man = DeadMan(10.0, "rtl")
    dead_man.begin(5.0)
    assert dead_man.check(14.9) is None
    fired = dead_man.check(15.0)
    assert fired is not None
    assert fired.last is None
    assert fired.reason == "no operator or client, ever, for 10.0 s (limit 10 s)"


@each(("timeout_s", "action"), [(1.9, "hold"), (3601.0, "hold"), (float("nan"), "hold"), (10.0, "kill")])
def test_refuses_what_would_fire_by_accident_or_is_no_action(timeout_s: float, action: str) -> None:
    with pytest.raises(ConfigError):
        DeadMan(timeout_s, action)  # type: ignore[arg-type]


@given(st.lists(st.tuples(st.sampled_from(["alive", "begin", "check"]), st.floats(0.0, 8.0)), max_size=60))
def test_fires_exactly_once_per_silence_also_after_somebody_came_back_or_control_began(steps) -> None:
    dead_man, now, since, fired = DeadMan(5.0), 0.0, None, False
    for what, pause in steps:
        now += pause
        if what == "check":
            due = since is not None and now - since >= 5.0 and not fired
            assert (dead_man.check(now) is not None) == due
            fired = fired or due
        else:
            dead_man.alive("client", now) if what == "alive" else dead_man.begin(now)
            since, fired = now, False
