"""Tokens are good once and for a while; cookies keep their role."""

from __future__ import annotations

import itertools
import json

from skygcs.web.sign_in import COOKIE_LIFE_S, MAX_COOKIES, MAX_TOKENS, OPENED_LIFE_S, TOKEN_LIFE_S, SignIn, token_of
from support.table import each


def sign_in() -> SignIn:
    numbers = itertools.count()
    return SignIn(lambda: f"secret-{next(numbers)}")


def exchanged(store: SignIn, token: str, now: float) -> str | None:
    """By somebody who may be anybody."""
    return store.exchange(token, now, lambda: False)


def test_a_token_gives_a_cookie_of_its_role_once() -> None:
    store = sign_in()
    token = store.issue("view", 0.0)
    cookie = exchanged(store, token, 1.0)
    assert cookie is not None and cookie != token
    assert store.role_of(cookie, 2.0) == "view"
    assert exchanged(store, token, 1.0) is None


def test_a_token_of_an_opened_address_is_of_no_use_to_other_users_and_not_used_up_by_them() -> None:
    store = sign_in()
    token, late = (store.issue("command", 0.0, own_user=True) for _ in range(2))
    assert exchanged(store, token, 1.0) is None
    assert store.exchange(token, 1.0, lambda: True) is not None
    assert store.exchange(token, 1.0, lambda: True) is None
    assert store.exchange(late, OPENED_LIFE_S + 1, lambda: True) is None


def test_an_unknown_token_or_cookie_is_nothing() -> None:
    store = sign_in()
    store.issue("command", 0.0)
    for wrong in ("", "x", "secret-1", "s" * 1_000_000, "\ud800", "\0"):
        assert exchanged(store, wrong, 0.0) is None
        assert store.role_of(wrong, 0.0) is None


def test_a_token_is_too_old_after_its_life() -> None:
    store = sign_in()
    first, second = store.issue("command", 0.0), store.issue("command", 0.0)
    assert exchanged(store, first, TOKEN_LIFE_S) is not None
    assert exchanged(store, second, TOKEN_LIFE_S + 1) is None


def test_a_cookie_lives_from_its_last_use() -> None:
    store = sign_in()
    cookie = exchanged(store, store.issue("command", 0.0), 0.0)
    assert cookie is not None
    assert store.role_of(cookie, COOKIE_LIFE_S) == "command"
    assert store.role_of(cookie, 2 * COOKIE_LIFE_S) == "command"
    assert store.role_of(cookie, 3 * COOKIE_LIFE_S + 1) is None
    assert store.role_of(cookie, 0.0) is None


def test_both_tables_are_bounded_and_the_oldest_goes() -> None:
    store = sign_in()
    tokens = [store.issue("view", 0.0) for _ in range(MAX_TOKENS + 1)]
    assert exchanged(store, tokens[0], 0.0) is None
    assert exchanged(store, tokens[1], 0.0) is not None
    cookies = []
    for at in range(MAX_COOKIES + 1):
        cookies.append(exchanged(store, store.issue("view", at), at) or "")
    assert store.role_of(cookies[0], at) is None
    assert store.role_of(cookies[-1], at) == "view"


def test_what_is_saved_holds_no_secret_and_is_taken_over() -> None:
    store = sign_in()
    cookie = exchanged(store, store.issue("command", 5.0), 5.0)
    assert cookie is not None
    saved = json.loads(json.dumps(store.saved(8.0)))
    assert cookie not in json.dumps(saved)
    other = sign_in()
    wrong = {"short": ["command", 1], "x" * 64: ["admin", 1], "y" * 64: 3, "z" * 64: ["view"]}
    never = {"v" * 64: ["view", float("nan")], "w" * 64: ["view", float("-inf")]}
    other.restore(saved | wrong | never, 1e6)
    assert list(other.saved(1e6).values()) == [["command", 3.0]]
    assert other.role_of(cookie, 1e6 + COOKIE_LIFE_S - 4.0) == "command"


@each(("away_s", "role"), [(-1e9, "view"), (0.0, "view"), (60.0, "view"), (COOKIE_LIFE_S, None)])
def test_the_time_between_two_processes_counts_and_a_clock_that_was_set_back_does_not(
    away_s: float, role: str | None
) -> None:
    store, other = sign_in(), sign_in()
    cookie = exchanged(store, store.issue("view", 0.0), 0.0)
    assert cookie is not None
    other.restore(store.saved(10.0), 1e6, away_s)
    assert other.role_of(cookie, 1e6) == role


@each(
    ("text", "token"),
    [
        ("http://192.168.1.7:8080/?token=abc-_1", "abc-_1"),
        ("  https://[::1]:8080/?token=abc-_1\n", "abc-_1"),
        ("http://gcs.local:8080/?x=1&token=abc#events", "abc"),
        ("gcs.local:8080/?token=abc", "abc"),
        ("?token=abc", "abc"),
        ("token=abc", "abc"),
        (" abc-_1 ", "abc-_1"),
        ("", ""),
        ("http://[bad/?token=abc", ""),
        ("http://host/?" + "a=1&" * 100 + "token=abc", ""),
        ("http://host/?token=", ""),
    ],
)
def test_the_token_of_what_a_person_pastes(text: str, token: str) -> None:
    assert token_of(text) == token
