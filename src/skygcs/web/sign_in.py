"""Sign-in to the web page: one-time tokens of printed addresses, exchanged for cookies that have a role. Pure.

    issue(role)        -> token, for an address that `skygcs web` prints; good once, for TOKEN_LIFE_S; or for an address
                          that it opens in a browser: good for OPENED_LIFE_S and for the same user's programs
    exchange(token)    -> cookie of that role; a second time None
    role_of(cookie)    -> the role, until it was not used for COOKIE_LIFE_S
    token_of(text)     the token in an address that was typed or pasted
    sign_out()         nothing that was given out is good any more: a phone was lost

``now`` is a clock that is never set and goes on while the computer sleeps: a computer without a battery for its clock
gets the time after it has printed its address, and by that step would sign everybody out. Times across a restart are
saved as time since the last use.

Only digests are kept, so that neither a lookup's time nor the saved file gives a secret away.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal
from urllib.parse import parse_qs, urlsplit

from skygcs.spelling import is_number

Role = Literal["view", "command"]

ROLES: tuple[Role, ...] = ("view", "command")

TOKEN_LIFE_S = 3600.0
"""Somebody starts the process, walks to the field and opens the address there."""

OPENED_LIFE_S = 120.0
"""A slow computer starts its browser."""

COOKIE_LIFE_S = 7 * 86400.0
"""A flight camp. Each use starts it anew."""

MAX_TOKENS = 64
"""Addresses printed and not used; the oldest goes for a new one."""

MAX_COOKIES = 64
"""Browsers signed in; the one unused for longest goes for a new one."""

MAX_SECRET_CHARS = 128
"""Longer ones are wrong without being looked at."""


@dataclass(frozen=True, slots=True)
class _Token:
    role: Role
    until: float
    own_user: bool


@dataclass(slots=True)
class _Granted:
    role: Role
    at: float


class SignIn:
    """Tokens and cookies. ``new_secret`` returns a new unguessable text (`secrets.token_urlsafe`). ``session_cookie``:
    the name of a cookie that ends with the browser, for a page that has another port each time."""

    def __init__(self, new_secret: Callable[[], str], session_cookie: str | None = None) -> None:
        self.session_cookie = session_cookie
        self._new_secret = new_secret
        self._tokens: dict[str, _Token] = {}
        self._cookies: dict[str, _Granted] = {}

    def issue(self, role: Role, now: float, *, own_user: bool = False) -> str:
        """A token for one browser. ``own_user``: which other users may see; it is of no use to them."""
        token = self._new_secret()
        while len(self._tokens) >= MAX_TOKENS:
            del self._tokens[next(iter(self._tokens))]
        until = now + (OPENED_LIFE_S if own_user else TOKEN_LIFE_S)
        self._tokens[_digest(token)] = _Token(role, until, own_user)
        return token

    def exchange(self, token: str, now: float, is_own_user: Callable[[], bool]) -> str | None:
        """The cookie for a token; None for one that is unknown, used, too old or not for who sent it."""
        key = _digest(token)
        granted = self._tokens.get(key)
        if granted is None or (granted.own_user and not is_own_user()):
            return None
        del self._tokens[key]
        if now > granted.until:
            return None
        cookie = self._new_secret()
        if len(self._cookies) >= MAX_COOKIES:
            del self._cookies[min(self._cookies, key=lambda key: self._cookies[key].at)]
        self._cookies[_digest(cookie)] = _Granted(granted.role, now)
        return cookie

    def role_of(self, cookie: str, now: float) -> Role | None:
        """The role of a cookie; None for one that is unknown or was unused for too long."""
        key = _digest(cookie)
        granted = self._cookies.get(key)
        if granted is None:
            return None
        if now - granted.at > COOKIE_LIFE_S:
            del self._cookies[key]
            return None
        granted.at = now
        return granted.role

    def identity(self, cookie: str) -> str:
        """Return what distinguishes browsers without being a secret."""
        return _digest(cookie)

    def sign_out(self) -> int:
        """Forget every token and cookie; how many browsers were signed in."""
        count = len(self._cookies)
        self._tokens.clear()
        self._cookies.clear()
        return count

    def saved(self, now: float) -> dict[str, Any]:
        """The cookies as digests, each with its role and the seconds since its last use, for a process that takes over
        from this one; JSON-able."""
        return {key: [granted.role, round(now - granted.at, 1)] for key, granted in self._cookies.items()}

    def restore(self, saved: Mapping[str, Any], now: float, away_s: float = 0.0) -> None:
        """Take over what `saved` returned ``away_s`` ago; anything else in it is left out."""
        for key, entry in list(saved.items())[:MAX_COOKIES]:
            match entry:
                case ["view" | "command" as role, unused_s] if isinstance(key, str) and len(key) == 64:
                    if is_number(unused_s):
                        self._cookies[key] = _Granted(role, now - max(unused_s, 0.0) - max(away_s, 0.0))


def token_of(text: str) -> str:
    """The token of a whole address, as it is printed and pasted; anything else is taken for the token itself."""
    text = text.strip()
    if "token=" not in text:
        return text
    try:
        query = urlsplit(text).query or text
        return parse_qs(query, max_num_fields=8).get("token", [""])[0].strip()
    except ValueError:  # brackets that are no address, too many fields
        return ""


def _digest(secret: str) -> str:
    if len(secret) > MAX_SECRET_CHARS:
        return ""
    return hashlib.sha256(secret.encode("utf-8", "replace")).hexdigest()
