"""The fleet's dead-man: once per silence, never before it, and also where nobody ever came."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control.deadman import DeadMan
from skygcs.errors import ConfigError
from support.table import each


def test_is_off_by_default() -> None:
    dead_man = DeadMan()
    dead_man.alive("client 1", 0.0)
    assert dead_man.check(1e9) is None


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


@each("somebody", [lambda d, now: d.alive(f"client of {now}", now), lambda d, now: d.begin(now)])
def test_fires_again_after_somebody_came_back_and_left_or_control_began(
    somebody: Callable[[DeadMan, float], None],
) -> None:
    dead_man = DeadMan(10.0)
    somebody(dead_man, 0.0)
    assert dead_man.check(10.0)
    somebody(dead_man, 20.0)
    assert dead_man.check(29.9) is None
    assert dead_man.check(30.0)


def test_does_not_fire_over_a_fleet_nobody_looks_at_and_nobody_controls() -> None:
    assert DeadMan(10.0).check(1e9) is None


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
def test_fires_exactly_once_per_silence(steps: list[tuple[str, float]]) -> None:
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
