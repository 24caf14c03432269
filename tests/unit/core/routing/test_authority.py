"""The gate of vehicles that several sites could command: what passes while a vehicle is held, and while it is not."""

from __future__ import annotations

import pytest

from skygcs.core.routing.authority import MAX_VALID_S, NO_TARGET, AuthorityGate, target_of
from support.routed import DIALECT
from support.table import each

ALPHA, BRAVO, OWN = 7, 8, 9
AIR = 1
"""The channel on which all of them are heard."""


def gate() -> AuthorityGate:
    made = AuthorityGate("north", {"alpha": ALPHA, "bravo": BRAVO})
    for sysid in (ALPHA, BRAVO):
        assert made.hear(AIR, sysid)
        assert not made.hear(AIR, sysid)
    return made


def test_a_vehicle_is_closed_until_it_is_granted_and_again_when_the_time_is_over() -> None:
    g = gate()
    assert not g.passes(AIR, ALPHA, (), 10.0)
    assert g.grant("alpha", 12.5, 10.0, token=1) == "granted"
    assert g.passes(AIR, ALPHA, (), 12.499)
    assert not g.passes(AIR, ALPHA, (), 12.5)
    assert not g.passes(AIR, BRAVO, (), 11.0)
    assert g.passes(AIR, OWN, (), 11.0)


@each(
    ("held", "target", "others", "passes"),
    [
        ((), 0, (OWN,), False),
        (("alpha",), 0, (OWN,), False),
        (("alpha", "bravo"), 0, (OWN,), True),
        ((), NO_TARGET, (), False),
        ((), NO_TARGET, (ALPHA, BRAVO), False),
        ((), NO_TARGET, (ALPHA, BRAVO, OWN), True),
        (("alpha",), NO_TARGET, (ALPHA, BRAVO), True),
    ],
)
def test_frames_for_everybody_follow_who_else_is_heard(
    held: tuple[str, ...], target: int, others: tuple[int, ...], passes: bool
) -> None:
    g = gate()
    for name in held:
        g.grant(name, 12.0, 10.0, token=1)
    assert g.passes(AIR, target, others, 11.0) is passes
    assert g.passes(AIR + 1, target, others, 11.0), "no gated vehicle is heard there"


def test_a_silent_vehicle_still_counts_until_its_channel_is_closed() -> None:
    g = gate()
    assert g.leads_to_gated(AIR)
    assert not g.passes(AIR, NO_TARGET, (), 1e6)
    g.forget_channel(AIR)
    assert g.passes(AIR, NO_TARGET, (), 1e6)
    assert not g.passes(AIR, ALPHA, (), 1e6), "its own frames are closed wherever they go"


def test_older_tokens_and_revoked_ones_are_fenced_off_until_another_hub_counts() -> None:
    g = gate()
    assert g.grant("alpha", 12.0, 10.0, token=5, hub="a") == "granted"
    assert g.grant("alpha", 12.0, 10.0, token=4, hub="a") == "fenced"
    g.revoke("alpha", token=5, hub="a", commander="south")
    assert g.grant("alpha", 12.0, 10.0, token=5, hub="a") == "fenced"
    assert g.is_closed(ALPHA, 10.0)
    assert g.grant("alpha", 12.0, 10.0, token=6, hub="a") == "granted"
    g.revoke("alpha", token=6, hub="a")
    assert g.grant("alpha", 12.0, 10.0, token=1, hub="b") == "granted"


def test_a_grant_that_was_under_way_too_long_grants_nothing_and_keeps_what_is_in_force() -> None:
    g = gate()
    g.grant("alpha", 12.0, 10.0, token=1)
    assert g.grant("alpha", 10.5, 10.5, token=2) == "late"
    assert not g.is_closed(ALPHA, 11.9)


@each("until", [10.0 + MAX_VALID_S + 0.2, float("inf"), float("nan")])
def test_no_grant_outlives_a_lease(until: float) -> None:
    with pytest.raises(ValueError, match="one clock"):
        gate().grant("alpha", until, 10.0, token=1)


def test_a_refusal_names_the_commander_and_what_to_do() -> None:
    g = gate()
    assert g.refusal(OWN, 10.0) is None
    assert g.refusal(ALPHA, 10.0) == "alpha is not commanded by north now; `skygcs-cli federation take alpha`"
    g.revoke("alpha", token=3, commander="south")
    assert g.refusal(ALPHA, 10.0) == "alpha is commanded by south; `skygcs-cli federation take alpha`"
    g.grant("alpha", 12.0, 10.0, token=4)
    assert g.refusal(ALPHA, 11.0) is None
    assert g.refusal(ALPHA, 12.0) == "alpha is not commanded by north now; `skygcs-cli federation take alpha`"


def test_a_lapse_is_reported_once_also_if_it_was_held_only_between_two_looks() -> None:
    g = gate()
    assert g.lapses(10.0) == []
    g.grant("alpha", 10.2, 10.0, token=1)
    assert [lapse.name for lapse in g.lapses(10.3)] == ["alpha"]
    assert g.lapses(10.4) == []
    g.grant("alpha", 12.0, 10.4, token=2)
    g.revoke("alpha", token=2, commander="south")
    assert [lapse.text for lapse in g.lapses(10.5)] == [
        "alpha is commanded by south; `skygcs-cli federation take alpha`"
    ]


def test_a_gain_is_reported_once_until_it_has_lapsed() -> None:
    g = gate()
    assert g.gains(10.0) == []
    g.grant("alpha", 12.0, 10.0, token=1)
    assert g.gains(10.1) == [("alpha", ALPHA)]
    g.grant("alpha", 13.0, 11.0, token=2)
    assert g.gains(11.0) == []
    assert g.gains(14.0) == [] and len(g.lapses(14.0)) == 1
    g.grant("alpha", 16.0, 14.0, token=3)
    assert g.gains(14.1) == [("alpha", ALPHA)]


def test_state_shows_authority_and_what_was_blocked() -> None:
    g = gate()
    assert g.status_of(OWN, 10.0) is None
    g.passes(AIR, ALPHA, (), 10.0)
    g.grant("alpha", 12.0, 10.0, token=1, hub="h")
    state = g.status_of(ALPHA, 11.0)
    assert state == {
        "held": True,
        "commander": "north",
        "remaining_s": 1.0,
        "token": 1,
        "hub": "h",
        "blocked_frames": 1,
    }
    lapsed = g.status_of(ALPHA, 12.0)
    assert lapsed is not None
    assert (lapsed["held"], lapsed["commander"]) == (False, None)


@each(
    ("name", "fields", "target"),
    [
        ("COMMAND_LONG", {"target_system": 7}, 7),
        ("SET_MODE", {"target_system": 0}, 0),
        ("MANUAL_CONTROL", {"target": 7}, 7),
        ("HEARTBEAT", {}, NO_TARGET),
        ("GPS_RTCM_DATA", {}, NO_TARGET),
    ],
)
def test_the_target_of_a_message(name: str, fields: dict[str, int], target: int) -> None:
    info = DIALECT.find(name)
    assert target_of(info, info.pack(fields)) == target
    assert target_of(info, b"") == min(target, 0)


def test_a_message_that_is_not_known_may_be_for_anybody() -> None:
    assert target_of(None, b"\7") == 0
