"""Authority over shared vehicles: what a grant opens, what ends it, and what is fenced off."""

from __future__ import annotations

import pytest

from skygcs.ext.federation.authority import MAX_VALID_S, Authority
from support.table import each

ALPHA, BRAVO, OWN = 7, 8, 9


def shared() -> Authority:
    return Authority("north", {"alpha": ALPHA, "bravo": BRAVO})


def is_closed(authority: Authority, now: float) -> bool:
    return authority.refusal(ALPHA, now) is not None


def test_a_vehicle_is_closed_until_it_is_granted_and_again_when_the_time_is_over() -> None:
    a = shared()
    assert set(a.sysids) == {ALPHA, BRAVO}
    assert is_closed(a, 10.0)
    assert a.grant("alpha", 12.5, 10.0, token=1) == "granted"
    assert not is_closed(a, 12.499)
    assert is_closed(a, 12.5)
    assert a.refusal(BRAVO, 11.0) is not None


def test_older_tokens_and_revoked_ones_are_fenced_off_until_another_hub_counts() -> None:
    a = shared()
    assert a.grant("alpha", 12.0, 10.0, token=5, hub="a") == "granted"
    assert a.grant("alpha", 12.0, 10.0, token=4, hub="a") == "fenced"
    a.revoke("alpha", token=5, hub="a", commander="south")
    assert a.grant("alpha", 12.0, 10.0, token=5, hub="a") == "fenced"
    assert is_closed(a, 10.0)
    assert a.grant("alpha", 12.0, 10.0, token=6, hub="a") == "granted"
    a.revoke("alpha", token=6, hub="a")
    assert a.grant("alpha", 12.0, 10.0, token=1, hub="b") == "granted"


def test_a_grant_that_was_under_way_too_long_grants_nothing_and_keeps_what_is_in_force() -> None:
    a = shared()
    a.grant("alpha", 12.0, 10.0, token=1)
    assert a.grant("alpha", 10.5, 10.5, token=2) == "late"
    assert not is_closed(a, 11.9)


@each("until", [10.0 + MAX_VALID_S + 0.2, float("inf"), float("nan")])
def test_no_grant_outlives_a_lease(until: float) -> None:
    with pytest.raises(ValueError, match="one clock"):
        shared().grant("alpha", until, 10.0, token=1)


def test_a_refusal_names_the_commander_and_what_to_do() -> None:
    a = shared()
    assert a.refusal(ALPHA, 10.0) == "alpha is not commanded by north now; `skygcs-cli federation take alpha`"
    a.revoke("alpha", token=3, commander="south")
    assert a.refusal(ALPHA, 10.0) == "alpha is commanded by south; `skygcs-cli federation take alpha`"
    a.grant("alpha", 12.0, 10.0, token=4)
    assert a.refusal(ALPHA, 11.0) is None
    assert a.refusal(ALPHA, 12.0) == "alpha is not commanded by north now; `skygcs-cli federation take alpha`"


def test_state_shows_authority() -> None:
    a = shared()
    assert a.status_of(OWN, 10.0) is None
    a.grant("alpha", 12.0, 10.0, token=1, hub="h")
    state = a.status_of(ALPHA, 11.0)
    assert state == {"held": True, "commander": "north", "remaining_s": 1.0, "token": 1, "hub": "h"}
    lapsed = a.status_of(ALPHA, 12.0)
    assert lapsed is not None
    assert (lapsed["held"], lapsed["commander"]) == (False, None)
