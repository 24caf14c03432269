"""The guard: row by row of its table, and what it never does whatever the facts are."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control.cascade import Estimate
from skygcs.core.control.guard import (
    CONTROL_MODES,
    FALLBACKS,
    ControlMode,
    Guard,
    GuardConfig,
    GuardFacts,
    Verdict,
    all_well,
)
from skygcs.errors import ConfigError
from support.table import each

NAN = math.nan
HERE = Estimate((1.0, 2.0, 3.0), (0.1, 0.0, 0.0))
WELL = GuardFacts(
    **dict.fromkeys(("connected", "armed", "following", "finite", "fix_ok", "airborne"), True),
    **dict.fromkeys(("inside_fence", "reference_inside_fence"), True),
    **{"state_age_s": 0.02, "rtt_p95_s": 0.03, "delay_p95_s": 0.05, "estimate": HERE, "battery_percent": 80.0},
    **{"rate_hz": 50.0, "rate_min_hz": 20.0, "refusing": None},
)
CONFIG = GuardConfig()
RETURNING = GuardConfig(return_after_s=5.0)


def but(**changes: Any) -> GuardFacts:
    return replace(WELL, **changes)


def checked(facts: GuardFacts, wanted: ControlMode = ControlMode.ATTITUDE, config: GuardConfig = CONFIG) -> Verdict:
    return Guard(config, wanted).check(facts, 0.0)


def test_sends_what_is_wanted_while_all_is_well_and_has_nothing_to_tell() -> None:
    for wanted in ControlMode:
        guard = Guard(CONFIG, wanted)
        for n in range(3):
            assert guard.check(WELL, n * 0.02) == Verdict("send", wanted, (), changed=False)
        assert guard.why_not(WELL) == ()


RELEASES = [
    ({"connected": False}, "lost", "no heartbeat"),
    ({"rebooted": True}, "rebooted", "lost all earlier orders"),
    ({"armed": False}, "not_armed", "not armed"),
    ({"airborne": False}, "on_ground", "take off first"),
    ({"following": False}, "mode", "took over"),
]
HOLDS = [
    ({"state_age_s": None}, "no_state", "no position has come"),
    ({"state_age_s": 2.01}, "silent", "state is 2.01 s old (limit for any setpoint 2 s)"),
    ({"state_age_s": NAN}, "silent", "state is nan s old"),
    ({"state_age_s": -0.2}, "silent", "state is -0.20 s old"),
    ({"finite": False}, "not_finite", "NaN"),
    ({"fix_ok": False}, "no_fix", "no usable position fix"),
    ({"estimate": None}, "no_position", "not known"),
    ({"estimate": Estimate((NAN, 0, 0), (0, 0, 0))}, "estimate", "(nan, 0, 0, 0, 0, 0)"),
    ({"estimate": Estimate((0, 0, 0), (0, 0, math.inf))}, "estimate", "inf"),
    ({"estimate": Estimate((0, 2e6, 0), (0, 0, 0))}, "estimate", "2e+06"),
    ({"inside_fence": False}, "fence", "the vehicle is outside the control fence"),
    ({"inside_fence": False, "position_breach": "the vehicle is at x 51.2 m"}, "fence", "x 51.2 m"),
    ({"reference_inside_fence": False}, "fence_reference", "the reference is outside"),
    ({"reference_inside_fence": False, "reference_breach": "is at x 99 m"}, "fence_reference", "x 99 m"),
    ({"battery_percent": 19.0}, "battery", "the battery is at 19 % (limit 20 %)"),
    ({"battery_percent": NAN}, "battery", "nan %"),
    ({"refusing": "mode change denied"}, "refusing", "the autopilot refuses: mode change denied"),
    ({"refusing": ""}, "refusing", "it does not say why"),
    ({"armed": False, "flies_disarmed": "it is 20 m above its home"}, "disarmed_in_air", "it is 20 m above its home"),
    ({"two_senders": True}, "two_senders", "two vehicles send with its ids"),
]


def test_ends_control_where_no_mode_is_safe() -> None:
    """Release what is not ours, hold what is not safe, and order no hold to a vehicle that does not follow yet."""
    for changes, kind, words in RELEASES + HOLDS:
        action = "release" if (changes, kind, words) in RELEASES else "hold"
        for wanted in ControlMode:
            verdict = checked(but(**changes), wanted)
            ended = verdict.action, verdict.control_mode, verdict.changed, verdict.kinds
            assert ended == (action, None, True, (kind,)), changes
            assert words in verdict.reasons[0] and len(verdict.reasons) == 1, changes
        if action == "hold":
            verdict = checked(but(**changes, following=False, engaging=True))
            assert (verdict.action, verdict.kinds) == ("release", (kind,)), changes


def test_while_engaging_it_may_send_and_the_way_follows_the_facts_up_again() -> None:
    guard = Guard(CONFIG, ControlMode.ATTITUDE)
    unmeasured = but(following=False, engaging=True, rtt_p95_s=None, delay_p95_s=None)
    assert guard.check(unmeasured, 0.0).control_mode is ControlMode.VELOCITY
    assert guard.check(but(following=False, engaging=True), 0.5).control_mode is ControlMode.ATTITUDE
    assert guard.check(WELL, 1.0) == Verdict("send", ControlMode.ATTITUDE, (), changed=False)
    assert guard.check(but(following=False), 2.0).action == "release"


def test_fights_nobody_however_unsafe_it_is() -> None:
    verdict = checked(but(following=False, inside_fence=False, battery_percent=1.0, finite=False))
    assert (verdict.action, verdict.kinds) == ("release", ("mode",))


def test_tells_every_reason_of_a_hold_and_the_cause_of_a_release() -> None:
    assert checked(but(fix_ok=False, estimate=None, battery_percent=3.0)).kinds == ("no_fix", "no_position", "battery")
    assert checked(but(rebooted=True, armed=False, following=False, airborne=False)).kinds == ("rebooted",)


LEAVES = "the link leaves {} setpoints per second (attitude needs {})"
HELD = LEAVES + ": each is held until the next, on average {} s of additional delay, instead of {} s"
STALE = "state is 0.51 s old (limit for attitude and velocity 0.5 s)"
IN_TICKS = "is 0.101 s in 95 of 100 ticks (limit for attitude 0.1 s)"
BY_PINGS = "is at least 0.360 s, by pings that are not answered (limit for attitude 0.1 s)"
NO_TRIP = "round trip is not measured yet"
CLIMB = "thrust means climb rate"
UNFIT = [
    ({"state_age_s": 0.51}, ControlMode.POSITION, "stale", STALE),
    ({"delay_p95_s": 0.101}, ControlMode.VELOCITY, "attitude_delay", IN_TICKS),
    ({"delay_p95_s": 0.36, "pings_overdue": True}, ControlMode.VELOCITY, "attitude_delay", BY_PINGS),
    ({"delay_p95_s": 0.501}, ControlMode.POSITION, "velocity_delay", "limit for velocity 0.5 s"),
    ({"delay_p95_s": math.inf}, ControlMode.POSITION, "velocity_delay", "inf s"),
    ({"delay_p95_s": NAN}, ControlMode.POSITION, "velocity_delay", "nan s"),
    ({"rtt_p95_s": NAN}, ControlMode.VELOCITY, "attitude_delay", "limit for attitude"),
    ({"rtt_p95_s": None, "delay_p95_s": None}, ControlMode.VELOCITY, "unmeasured", NO_TRIP),
    ({"rtt_p95_s": None}, ControlMode.VELOCITY, "unmeasured", NO_TRIP),
    ({"rate_hz": 8.0}, ControlMode.VELOCITY, "attitude_rate", HELD.format(8, 20, "0.062", "0.025")),
    ({"rate_hz": 1.9}, ControlMode.POSITION, "velocity_rate", "1.9 setpoints per second (velocity needs 2"),
    (
        {"rate_hz": 0.5, "rate_min_hz": 0.8},
        *(ControlMode.POSITION, "attitude_rate", HELD.format(0.5, 0.8, "1.000", 0.625)),
    ),
    ({"rate_hz": 0.0}, ControlMode.POSITION, "attitude_rate", LEAVES.format(0, 20)),
    ({"rate_hz": NAN}, ControlMode.POSITION, "attitude_rate", "nan"),
    ({"attitude_refused": CLIMB}, ControlMode.VELOCITY, "attitude_refused", CLIMB),
]


def test_falls_at_once_to_the_highest_mode_that_bears_it() -> None:
    for changes, control_mode, kind, words in UNFIT:
        verdict = checked(but(**changes))
        assert (verdict.action, verdict.control_mode, verdict.changed) == ("send", control_mode, True), changes
        assert words in verdict.reasons[verdict.kinds.index(kind)], changes
        position = Verdict("send", ControlMode.POSITION, (), changed=False)
        assert checked(but(**changes), ControlMode.POSITION) == position, changes


@each("wanted", [ControlMode.ATTITUDE, ControlMode.VELOCITY])
def test_with_prediction_velocity_bears_what_its_margin_says(wanted: ControlMode) -> None:
    slow = {"delay_p95_s": 0.95}
    assert checked(but(**slow), wanted).control_mode is ControlMode.POSITION
    assert checked(but(**slow, predicted=True), wanted).control_mode is ControlMode.VELOCITY
    guard = Guard(CONFIG, ControlMode.VELOCITY)
    assert guard.check(but(**slow, predicted=True), 0.0) == Verdict("send", ControlMode.VELOCITY, (), changed=False)
    assert guard.check(but(**slow), 0.1).control_mode is ControlMode.POSITION
    assert checked(but(state_age_s=0.51, predicted=True), wanted).control_mode is ControlMode.POSITION


def test_velocity_needs_no_round_trip() -> None:
    assert checked(but(rtt_p95_s=None, delay_p95_s=None, rate_hz=5.0), ControlMode.VELOCITY).reasons == ()


def test_an_end_is_final_and_told_once_with_its_first_reason() -> None:
    guard = Guard(RETURNING, ControlMode.ATTITUDE)
    first = guard.check(but(battery_percent=10.0), 0.0)
    for n, facts in enumerate([WELL, but(armed=False), but(battery_percent=5.0), WELL] * 50):
        assert guard.check(facts, float(n)) == replace(first, changed=False)
        assert guard.control_mode is None
    guard.reset(ControlMode.VELOCITY)
    assert guard.control_mode is ControlMode.VELOCITY
    assert guard.check(WELL, 1000.0) == Verdict("send", ControlMode.VELOCITY, (), changed=False)


def test_stays_down_by_itself_and_says_what_to_do() -> None:
    guard = Guard(CONFIG, ControlMode.ATTITUDE)
    assert guard.check(but(delay_p95_s=0.2), 0.0).changed
    verdicts = [guard.check(WELL, n * 0.02) for n in range(1, 5000)]
    assert {(v.action, v.control_mode, v.changed) for v in verdicts} == {("send", ControlMode.VELOCITY, False)}
    assert verdicts[-1].kinds == ("attitude_delay",)
    assert verdicts[-1].reasons[-1] == (
        "attitude has been possible again for 100.0 s; it does not return by itself, order attitude again"
    )


def test_returns_after_all_was_well_for_so_long_without_a_break() -> None:
    guard = Guard(RETURNING, ControlMode.ATTITUDE)
    guard.check(but(delay_p95_s=0.2), 0.0)
    assert guard.check(WELL, 1.0).reasons[-1] == ("attitude has been possible again for 0.0 s; it returns after 5 s")
    assert guard.check(but(rate_hz=10.0), 5.9).control_mode is ControlMode.VELOCITY
    assert guard.check(WELL, 6.0).control_mode is ControlMode.VELOCITY
    assert guard.check(WELL, 10.9).control_mode is ControlMode.VELOCITY
    assert guard.check(WELL, 11.0) == Verdict("send", ControlMode.ATTITUDE, (), changed=True)
    assert not guard.check(WELL, 11.02).changed


def test_climbs_as_far_as_it_may() -> None:
    guard = Guard(RETURNING, ControlMode.ATTITUDE)
    guard.check(but(state_age_s=0.6), 0.0)
    assert guard.control_mode is ControlMode.POSITION
    slow = but(delay_p95_s=0.2)
    assert guard.check(slow, 1.0).control_mode is ControlMode.POSITION
    climbed = guard.check(slow, 6.0)
    assert (climbed.control_mode, climbed.changed, climbed.kinds) == (ControlMode.VELOCITY, True, ("attitude_delay",))


def test_time_that_runs_backwards_proves_no_recovery() -> None:
    guard = Guard(RETURNING, ControlMode.ATTITUDE)
    guard.check(but(delay_p95_s=0.2), 1000.0)
    guard.check(WELL, 1000.0)
    assert guard.check(WELL, 10.0).control_mode is ControlMode.VELOCITY
    assert guard.check(WELL, 14.9).control_mode is ControlMode.VELOCITY
    assert guard.check(WELL, 15.0).control_mode is ControlMode.ATTITUDE


def test_a_new_kind_of_reason_is_told_once_and_flicker_is_not() -> None:
    guard = Guard(CONFIG, ControlMode.ATTITUDE)
    guard.check(but(delay_p95_s=0.2), 0.0)
    assert not guard.check(but(delay_p95_s=0.3), 0.1).changed
    assert guard.check(but(delay_p95_s=0.3, rate_hz=10.0), 0.2).changed
    for n in range(100):
        assert not guard.check(WELL if n % 2 else but(rate_hz=10.0), 0.3 + n).changed


def test_what_was_told_before_a_return_is_told_again_after_the_next_fall() -> None:
    guard = Guard(RETURNING, ControlMode.ATTITUDE)
    slow, thin = but(delay_p95_s=0.2), but(delay_p95_s=0.2, rate_hz=10.0)
    assert [guard.check(facts, 0.0).changed for facts in (slow, thin, slow, thin)] == [True, True, False, False]
    assert [guard.check(WELL, at).control_mode for at in (1.0, 6.0)] == [ControlMode.VELOCITY, ControlMode.ATTITUDE]
    assert [guard.check(facts, 7.0).changed for facts in (slow, thin, slow, thin)] == [True, True, False, False]


def test_why_not_tells_everything_and_changes_nothing() -> None:
    guard = Guard(CONFIG, ControlMode.ATTITUDE)
    found = guard.why_not(but(armed=False, fix_ok=False, rtt_p95_s=None))
    assert [text.split(",")[0] for text in found] == [
        "the vehicle is not armed",
        "the vehicle has no usable position fix",
        "the round trip is not measured yet",
    ]
    assert guard.check(WELL, 0.0) == Verdict("send", ControlMode.ATTITUDE, (), changed=False)


def test_refuses_limits_that_make_no_sense() -> None:
    for name, value in (
        *(("attitude_delay_s", value) for value in (NAN, 0.0, 0.6)),
        *(("velocity_delay_s", value) for value in (NAN, 0.0, 0.09, 5.1)),
        *(("stale_s", value) for value in (0.009, 3.0)),
        *(("position_stale_s", value) for value in (0.4, 61.0)),
        *(("battery_min_percent", value) for value in (-1.0, 101.0)),
        *(("return_after_s", value) for value in (0.5, 3601.0)),
    ):
        with pytest.raises(ConfigError) as error:
            GuardConfig(**{name: value})
        assert name in error.value.problems[0], value
    at_limits = GuardConfig(1.0, 1.0, 5.0, 5.0, 100.0, 3600.0), GuardConfig(0.001, 0.001, 0.01, 0.01, 0.0, 1.0)
    assert GuardConfig(velocity_delay_s=5.0, position_stale_s=60.0) not in at_limits


def test_battery_may_be_left_to_the_autopilot() -> None:
    assert checked(but(battery_percent=1.0), config=GuardConfig(battery_min_percent=None)).action == "send"


# The oracle: what each mode bears, said positively so that NaN fails each condition.


def bears(facts: GuardFacts, mode: ControlMode, floor: float | None = 20.0) -> bool:
    estimate = facts.estimate
    anything = (
        facts.connected
        and facts.armed
        and (facts.following or facts.engaging)
        and not facts.rebooted
        and not facts.two_senders
        and facts.airborne is not False
        and facts.finite
        and facts.fix_ok
        and facts.inside_fence
        and facts.reference_inside_fence
        and facts.refusing is None
        and estimate is not None
        and all(-1e6 <= value <= 1e6 for value in (*estimate.pos_enu_m, *estimate.vel_enu_mps))
        and facts.state_age_s is not None
        and -0.1 <= facts.state_age_s <= 2.0
        and (floor is None or facts.battery_percent is None or facts.battery_percent >= floor)
    )
    if mode is ControlMode.POSITION or not anything:
        return anything
    assert facts.state_age_s is not None
    if not facts.state_age_s <= 0.5:
        return False
    if mode is ControlMode.VELOCITY:
        return facts.rate_hz >= 2.0 and (facts.delay_p95_s is None or facts.delay_p95_s <= 0.5 or facts.predicted)
    return (
        facts.attitude_refused is None
        and facts.rtt_p95_s is not None
        and facts.rtt_p95_s >= 0
        and facts.delay_p95_s is not None
        and facts.delay_p95_s <= 0.1
        and facts.rate_hz >= facts.rate_min_hz
        and not (mode is ControlMode.RAW and facts.raw_refused is not None)
    )


VALUES: dict[str, tuple[Any, ...]] = {
    "state_age_s": (None, NAN, -0.1, -0.11, 0.5, 0.51, 2.0, 2.01),
    "rtt_p95_s": (None, NAN, -0.01, 0.0),
    "delay_p95_s": (None, NAN, 0.1, 0.11, 0.5, 0.51),
    "battery_percent": (None, NAN, 20.0, 19.9),
    "rate_hz": (NAN, 1.9, 2.0, 19.9, 20.0),
    "rate_min_hz": (NAN, 0.0, 60.0),
    "estimate": (None, Estimate((NAN, 0.0, 0.0), (0.0, 0.0, 0.0)), Estimate((0.0, 0.0, 0.0), (0.0, 0.0, -1.1e6))),
    "airborne": (None, False),
    "refusing": ("", "no"),
    "attitude_refused": ("", "no"),
    "raw_refused": ("", "no"),
    "flies_disarmed": ("it is 20 m above its home",),
    **{name: (False,) for name in ("connected", "armed", "following", "finite", "fix_ok", "inside_fence")},
    **{name: (True,) for name in ("rebooted", "two_senders", "engaging", "predicted", "pings_overdue")},
    "reference_inside_fence": (False,),
}
SINGLE = [{name: value} for name, values in VALUES.items() for value in values]


def test_the_mode_is_the_highest_that_bears_every_value_alone_and_with_each_other() -> None:
    for first in [{}, *SINGLE]:
        for second in SINGLE:
            facts = but(**{**first, **second})
            for wanted in ControlMode:
                modes = FALLBACKS[wanted]
                verdict = checked(facts, wanted)
                expected = next((mode for mode in modes if bears(facts, mode)), None)
                assert verdict.control_mode is expected, (wanted, first, second)
                well = all(bears(facts, mode) for mode in modes)
                if wanted is not ControlMode.RAW or facts.rate_hz >= 2.0:  # below it the whole table decides
                    assert all_well(CONFIG, facts, wanted) is well, (wanted, first, second)
    assert all_well(GuardConfig(battery_min_percent=None), but(battery_percent=1.0), ControlMode.ATTITUDE)


def test_a_check_without_a_reason_is_short_only_while_nothing_changes() -> None:
    """The short check hides nothing: it ends with the first reason."""
    guard = Guard(RETURNING, ControlMode.ATTITUDE)
    slow = but(delay_p95_s=0.2)
    assert [guard.check(WELL, at).changed for at in (0.0, 1.0, 1.0)] == [False] * 3
    assert guard.check(slow, 2.0).control_mode is ControlMode.VELOCITY
    assert guard.check(WELL, 3.0).control_mode is ControlMode.VELOCITY
    assert guard.check(WELL, 8.0).control_mode is ControlMode.ATTITUDE
    assert guard.check(slow, 8.1).reasons == (
        "state age plus setpoint transport is 0.200 s in 95 of 100 ticks (limit for attitude 0.1 s)",
    )
    assert guard.check(but(armed=False), 8.2).action == "release"
    assert guard.check(WELL, 8.3).action == "release"


# For any facts in any order. Each fact is well most of the time, so that the sequences get somewhere.

number = st.one_of(st.none(), st.floats(), st.floats(0.0, 3.0))


def mostly(well: Any, other: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.integers(0, 7).flatmap(lambda n: other if n == 0 else st.just(well))


vectors = st.tuples(*[st.floats(-2e6, 2e6) | st.floats()] * 3)
OTHER: dict[str, st.SearchStrategy[Any]] = {
    **dict.fromkeys(("state_age_s", "rtt_p95_s", "delay_p95_s", "battery_percent"), number),
    **dict.fromkeys(("rate_hz", "rate_min_hz"), st.floats() | st.floats(0.0, 60.0)),
    "estimate": st.none() | st.builds(Estimate, vectors, vectors),
    "airborne": st.sampled_from([None, False]),
    **dict.fromkeys(("refusing", "attitude_refused", "position_breach", "reference_breach"), st.text(max_size=5)),
}
any_facts = st.builds(
    GuardFacts, **{f.name: mostly(getattr(WELL, f.name), OTHER.get(f.name, st.booleans())) for f in fields(GuardFacts)}
)
fit_facts = st.builds(
    but,
    state_age_s=mostly(0.02, st.floats(0.0, 1.9)),
    delay_p95_s=mostly(0.05, number),
    rtt_p95_s=mostly(0.03, number),
    rate_hz=mostly(50.0, st.floats(0.0, 60.0)),
)
sequences = st.lists(st.tuples(st.one_of(any_facts, fit_facts, st.just(WELL)), st.floats(0.0, 4.0)), max_size=40)
configs = st.sampled_from([CONFIG, RETURNING])
ways = st.sampled_from(CONTROL_MODES)


def run(
    config: GuardConfig, wanted: ControlMode, sequence: list[tuple[GuardFacts, float]]
) -> list[tuple[GuardFacts, Verdict]]:
    guard, now, found = Guard(config, wanted), 0.0, []
    for facts, pause in sequence:
        now += pause
        found.append((facts, guard.check(facts, now)))
    return found


@given(configs, ways, sequences)
def test_whatever_comes_it_keeps_its_rules(config, wanted, sequence) -> None:
    """Never above the wanted mode; up only after the set time; an end is final; each change is reported once."""
    guard, now = Guard(config, wanted), 0.0
    before, reported, lower_since = ("send", wanted), set[str](), 0.0
    ended: Verdict | None = None
    for facts, pause in sequence:
        now += pause
        verdict = guard.check(facts, now)
        if ended is not None:
            assert verdict == replace(ended, changed=False)
            continue
        mode, last = verdict.control_mode, before[1]
        assert (mode is None) is (verdict.action != "send")
        assert bool(verdict.reasons) is (mode is not wanted)
        assert len(set(verdict.kinds)) == len(verdict.kinds)

        what = (verdict.action, mode)
        if what != before:
            reported = set()
        assert verdict.changed is (what != before or not reported.issuperset(verdict.kinds))
        reported.update(verdict.kinds)

        if mode is None:
            assert verdict.changed
            ended = verdict
        else:
            assert bears(facts, mode)
            place, place_before = CONTROL_MODES.index(mode), CONTROL_MODES.index(last)
            assert place >= CONTROL_MODES.index(wanted)
            if place < place_before and not facts.engaging:
                assert config.return_after_s is not None and now - lower_since >= config.return_after_s - 1e-9
            if place > place_before:
                lower_since = now
            before = ("send", mode)


@given(
    st.sampled_from([CONFIG, RETURNING, GuardConfig(battery_min_percent=None, return_after_s=1.0)]),
    ways,
    st.lists(st.tuples(st.sampled_from([WELL, *map(lambda c: but(**c), SINGLE)]), st.floats(-1.0, 4.0)), max_size=40),
)
def test_says_the_same_whether_or_not_it_goes_by_the_whole_table(config, wanted, sequence) -> None:
    quick = run(config, wanted, sequence)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("skygcs.core.control.guard.all_well", lambda config, facts, wanted: False)
        assert run(config, wanted, sequence) == quick
