"""Tokens are good once and for a while; cookies keep their role."""

from __future__ import annotations

import itertools
import json
import math
import os
import socket
from pathlib import Path
from typing import Any

import pytest

from skygcs.ext.federation.bridge.station_methods import DESCRIBED
from skygcs.web import peer_user
from skygcs.web.peer_user import is_own_user
from skygcs.web.request_limits import (
    DEADLINE_MAX_S,
    MAX_ENDING_WAITING,
    MAX_MESSAGE_BYTES,
    MAX_REFUSED,
    MAX_WAITING,
    READ_AHEAD_S,
    READ_MESSAGES_PER_S,
    REQUEST_BURST,
    PageLimits,
    deadline_problem,
)
from skygcs.web.roles import ENDS_FLIGHT, NOT_PASSED_ON, ORDERS, READ, STATION_ORDERS, access, may
from skygcs.web.sign_in import COOKIE_LIFE_S, MAX_COOKIES, MAX_TOKENS, OPENED_LIFE_S, TOKEN_LIFE_S, SignIn, token_of
from support.extension_parts import ALL_METHODS
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


# -- Every method of the daemon is sorted in; the role view reads and nothing else.


def test_every_method_of_the_daemon_stands_in_one_list() -> None:
    lists = (READ, ENDS_FLIGHT, ORDERS, NOT_PASSED_ON)
    assert set().union(*lists) - {"auth"} == set(ALL_METHODS)
    assert sum(map(len, lists)) == len(set().union(*lists))


def test_orders_that_the_daemon_always_takes_have_the_connection_of_their_own() -> None:
    """What ends a flight is answered when all places are taken: those orders, and what shows what flies."""
    always = {name for name, method in ALL_METHODS.items() if method.always}
    assert always - READ - NOT_PASSED_ON <= ENDS_FLIGHT


def test_the_role_view_may_read_only() -> None:
    names = [*ALL_METHODS, "no.such", "", "vehicles.list ", "VEHICLES.LIST", "web.hello"]
    assert {name for name in names if may("view", name)} == READ
    assert {name for name in names if may("command", name)} == READ | ENDS_FLIGHT | ORDERS
    assert access("no.such") == "refused"


def test_of_the_station_only_the_outcome_of_an_order_may_be_asked_for_and_not_by_who_only_looks() -> None:
    assert set(DESCRIBED) >= STATION_ORDERS == {"federation.outcome"}
    assert {name for name in DESCRIBED if may("command", name)} == STATION_ORDERS
    assert not any(may("view", name) for name in DESCRIBED)


# -- The allowance of one page, and the deadline of an order.


def test_a_flood_is_refused_and_stop_is_not_behind_it() -> None:
    limits = PageLimits(0.0)
    granted = 0
    for _ in range(10_000):
        if limits.begin(0.0, ends_flight=False) is None:
            granted += 1
            limits.end(ends_flight=False)
    assert granted == REQUEST_BURST
    assert limits.exceeded and limits.refused >= MAX_REFUSED
    assert limits.begin(0.0, ends_flight=True) is None


def test_only_so_many_may_wait_for_their_answer() -> None:
    limits = PageLimits(0.0)
    for _ in range(MAX_WAITING):
        assert limits.begin(0.0, ends_flight=False) is None
    assert limits.begin(0.0, ends_flight=False) is not None
    for _ in range(MAX_ENDING_WAITING):
        assert limits.begin(0.0, ends_flight=True) is None
    assert limits.begin(0.0, ends_flight=True) is not None
    limits.end(ends_flight=False)
    assert limits.begin(0.0, ends_flight=False) is None


@each("deadline", [100.0, 100, 103.5, 100.0 + DEADLINE_MAX_S])
def test_an_order_in_time_is_carried_out(deadline: float) -> None:
    assert deadline_problem(deadline, 100.0) is None


@each(
    "deadline",
    [
        None,
        True,
        "103",
        [],
        99.99,
        -1e300,
        0,
        100.0 + DEADLINE_MAX_S + 0.01,
        1e300,
        math.inf,
        math.nan,
        10**400,
        -(10**400),
    ],
)
def test_an_order_without_a_deadline_or_after_it_is_not(deadline: object) -> None:
    assert deadline_problem(deadline, 100.0) is not None


def test_a_page_is_read_from_at_a_pace_that_a_person_never_reaches() -> None:
    limits = PageLimits(0.0)
    assert not any(limits.pause_s(200, at / 50) for at in range(10_000)), "fifty messages a second for minutes"
    flood = PageLimits(0.0)
    now, read = 0.0, 0
    while now < 10.0:
        read += 1
        now += flood.pause_s(40, now)
    assert read <= READ_MESSAGES_PER_S * (10.0 + READ_AHEAD_S) + 1
    large = PageLimits(0.0)
    assert [large.pause_s(MAX_MESSAGE_BYTES, 0.0) > 0 for _ in range(4)] == [False, False, True, True]
    assert large.pause_s(0, 60.0) == 0.0


# -- Whose program is at the other end of a connection, by the kernel's own tables.


class Transport:
    """One end of a connection, as asyncio's transports show it."""

    def __init__(self, sock: socket.socket) -> None:
        self._names = {"sockname": sock.getsockname(), "peername": sock.getpeername()}

    def get_extra_info(self, name: str) -> Any:
        return self._names[name]


@each("host", ["127.0.0.1", "::1"])
def test_a_program_of_this_user_is_known_and_one_of_another_is_not(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, 0), family=family)
    except OSError:
        pytest.skip(f"this machine has no {host}")
    with listener, socket.create_connection(listener.getsockname()[:2]) as ours:
        accepted, _ = listener.accept()
        with accepted:
            assert is_own_user(Transport(accepted))
            own = os.geteuid()
            monkeypatch.setattr(os, "geteuid", lambda: own + 1)
            assert not is_own_user(Transport(accepted))
            assert ours.getsockname()[:2] == accepted.getpeername()[:2]


def test_a_connection_from_another_machine_is_nobodys(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.create_connection(listener.getsockname()) as ours:
        accepted, _ = listener.accept()
        with accepted:
            there = Transport(accepted)
            there._names["peername"] = ("192.0.2.7", ours.getsockname()[1])
            assert not is_own_user(there)
            monkeypatch.setattr(peer_user, "TABLES", (str(tmp_path / "none"),))
            assert not is_own_user(Transport(accepted))
