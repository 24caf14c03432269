"""Cookies of the web page: which name they have, how long they are kept, and what an address does a second time."""

from __future__ import annotations

import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from http.cookies import Morsel, SimpleCookie
from pathlib import Path
from unittest import mock

import aiohttp
import pytest

from skygcs.config.allow_list import allow_list
from skygcs.web.http_server import COOKIE_KEPT_S, HttpServer
from skygcs.web.page_clients import PageClients
from skygcs.web.sign_in import SignIn
from skygcs.web.web_process import REPLAY_COOKIE, WebOptions, WebProcess

pytestmark = [
    pytest.mark.system,
    pytest.mark.filterwarnings("ignore::aiohttp.web_exceptions.NotAppKeyWarning"),  # of an aiohttp newer than the key
]


def secrets() -> Callable[[], str]:
    numbers = iter(range(1_000_000))
    return lambda: f"secret-{next(numbers)}"


@asynccontextmanager
async def page(static: Path, session_cookie: str | None) -> AsyncIterator[tuple[str, SignIn]]:
    """The address of a served page without a daemon, and its sign-in."""
    (static / "index.html").write_text("the page")
    sign_in = SignIn(secrets(), session_cookie)
    sock = socket.create_server(("127.0.0.1", 0))
    sock.setblocking(False)
    port = sock.getsockname()[1]
    server = HttpServer(
        mock.Mock(spec=PageClients, clients={}),
        sign_in,
        allow_list("127.0.0.1", port, (), tls=False),
        clock=lambda: 1e9,
        on_sign_in=lambda: None,
        static=static,
    )
    await server.start(sock, None)
    try:
        yield f"http://127.0.0.1:{port}", sign_in
    finally:
        await server.close()
        sock.close()


async def opened(jar: SimpleCookie, address: str) -> tuple[int, str]:
    """Status and text of an address in a browser with this jar, redirections followed."""
    async with aiohttp.ClientSession(cookie_jar=aiohttp.DummyCookieJar()) as session:
        for _ in range(3):
            sent = {name: morsel.value for name, morsel in jar.items()}
            async with session.get(address, cookies=sent, allow_redirects=False) as answer:
                for name, morsel in answer.cookies.items():
                    jar[name] = morsel
                if answer.status != 303:
                    return answer.status, await answer.text()
                address = "/".join(address.split("/")[:3]) + answer.headers["Location"]
    raise AssertionError("redirected without an end")


def the_one(jar: SimpleCookie) -> tuple[str, Morsel[str]]:
    (found,) = jar.items()
    return found


async def test_replays_on_many_ports_leave_one_cookie_that_ends_with_the_browser(tmp_path: Path) -> None:
    jar: SimpleCookie = SimpleCookie()
    for _ in range(5):
        async with page(tmp_path, REPLAY_COOKIE) as (base, sign_in):
            address = f"{base}/?token={sign_in.issue('command', 1e9)}"
            assert await opened(jar, address) == (200, "the page")
    name, cookie = the_one(jar)
    assert name == "skygcs_replay" and cookie["max-age"] == "" and cookie["httponly"]


async def test_a_stations_cookie_is_kept_under_the_name_of_its_port(tmp_path: Path) -> None:
    jar: SimpleCookie = SimpleCookie()
    async with page(tmp_path, None) as (base, sign_in):
        assert (await opened(jar, f"{base}/?token={sign_in.issue('view', 1e9)}"))[0] == 200
        name, cookie = the_one(jar)
        assert name == f"skygcs_{base.rpartition(':')[2]}" and cookie["max-age"] == str(COOKIE_KEPT_S)


async def test_an_address_opened_again_shows_the_page_to_who_is_signed_in_and_to_nobody_else(tmp_path: Path) -> None:
    jar: SimpleCookie = SimpleCookie()
    async with page(tmp_path, REPLAY_COOKIE) as (base, sign_in):
        address = f"{base}/?token={sign_in.issue('command', 1e9)}"
        assert await opened(jar, address) == (200, "the page")
        assert await opened(jar, address) == (200, "the page")
        assert (await opened(SimpleCookie(), address))[0] == 403
        sign_in.sign_out()
        assert (await opened(jar, address))[0] == 403


@pytest.mark.parametrize(("supervised", "name"), [(True, REPLAY_COOKIE), (False, None)])
async def test_the_replays_of_a_daemon_share_their_cookie(tmp_path: Path, supervised: bool, name: str | None) -> None:
    options = WebOptions(str(tmp_path / "s"), port=0, replay=tmp_path / "flight.tlog", supervised=supervised)
    with mock.patch("skygcs.web.replay_source.Recording"):
        assert WebProcess(options).sign_in.session_cookie == name
