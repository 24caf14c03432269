"""`skygcs web` as a process: who gets in, who does not, and what it does when the daemon or a page misbehaves."""

from __future__ import annotations

import asyncio
import contextlib
import re
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import aiohttp
import pytest
import yarl

from skygcs.web.browser_connections import MAX_CONNECTIONS
from skygcs.web.http_server import MAX_SOCKETS_EACH, MAX_VIEW_SOCKETS
from support.hanging import HANG_S
from support.process import wait_until
from support.web_page import page_of, raw, status
from support.web_station import WebStation, command

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebStation]:
    station = WebStation(tmp_path_factory.mktemp("web"), (1, 1))
    try:
        yield station.start()
    finally:
        station.close()


def most_memory_kb(station: WebStation) -> int:
    assert station.web_process is not None
    found = re.search(r"VmHWM:\s+(\d+)", Path(f"/proc/{station.web_process.pid}/status").read_text())
    assert found is not None
    return int(found[1])


def descriptors(station: WebStation) -> int:
    assert station.web_process is not None
    return len(list(Path(f"/proc/{station.web_process.pid}/fd").iterdir()))


def mode_of_cookies(station: WebStation) -> int:
    return Path(f"{station.socket_path}.web-{station.port}.cookies").stat().st_mode


# -- who gets in


@pytest.mark.parametrize(
    "host", ["127.evil.com", "127.evil.com:{port}", "evil.com", "127.0.0.1", "127.0.0.1:1", "[::ffff:127.0.0.1]:{port}"]
)
@pytest.mark.parametrize("path", ["/", "/?token={token}", "/ws", "/assets/app.js", "/nothing"])
def test_a_wrong_host_is_refused_everywhere_and_uses_up_no_token(station: WebStation, host: str, path: str) -> None:
    token = station.address().partition("=")[2]
    host, path = host.format(port=station.port), path.format(token=token)
    answer = raw(station, f"GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n")
    assert status(answer) == 403 and "Set-Cookie" not in answer
    good = raw(station, f"GET /?token={token} HTTP/1.1\r\nHost: 127.0.0.1:{station.port}\r\n\r\n")
    assert status(good) == 303


def test_no_host_and_two_hosts_are_refused(station: WebStation) -> None:
    own = f"Host: 127.0.0.1:{station.port}\r\n"
    assert status(raw(station, "GET / HTTP/1.1\r\n\r\n")) in (400, 403)
    assert status(raw(station, f"GET / HTTP/1.1\r\n{own}Host: evil.com\r\n\r\n")) in (400, 403)


def test_without_a_token_nothing_is_served(station: WebStation) -> None:
    own = f"Host: 127.0.0.1:{station.port}\r\nOrigin: {station.base}\r\n"
    for path in ("/", "/ws", "/assets/app.js", "/map", "/?token=", "/?token=x", "/?token=" + "x" * 5000):
        answer = raw(station, f"GET {path} HTTP/1.1\r\n{own}\r\n")
        assert status(answer) == 403, path
        assert "Set-Cookie" not in answer


def test_a_token_works_once(station: WebStation) -> None:
    address = station.address()
    request = f"GET {address.removeprefix(station.base)} HTTP/1.1\r\nHost: 127.0.0.1:{station.port}\r\n\r\n"
    first = raw(station, request)
    assert status(first) == 303 and "HttpOnly" in first and "SameSite=Strict" in first
    assert status(raw(station, request)) == 403


async def test_a_foreign_origin_gets_no_websocket_even_with_the_cookie(station: WebStation) -> None:
    async with page_of(station, ws=False) as page:
        for origin in (
            "http://evil.com",
            f"http://127.evil.com:{station.port}",
            "null",
            f"https://127.0.0.1:{station.port}",
        ):
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                await page.session.ws_connect(f"{station.base}/ws", origin=origin)
            assert refused.value.status == 403
        with pytest.raises(aiohttp.WSServerHandshakeError):
            await page.session.ws_connect(f"{station.base}/ws")  # no Origin at all
        for path in ("/", "/assets/app.js"):
            async with page.session.get(station.base + path, headers={"Origin": "http://evil.com"}) as answer:
                assert answer.status == 403
                assert "Access-Control-Allow-Origin" not in answer.headers


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "PATCH", "HEAD", "TRACE"])
async def test_only_get_is_served_and_no_get_has_an_effect(station: WebStation, method: str) -> None:
    async with page_of(station, ws=False) as page:
        async with page.session.request(method, f"{station.base}/") as answer:
            assert answer.status == 405
        before = station.call("events.recent", limit=10000)
        for path in (
            "/vehicles.arm",
            "/rpc?method=vehicles.arm&targets=all",
            "/ws?method=vehicles.arm",
            "/?method=vehicles.arm",
        ):
            async with page.session.get(station.base + path) as answer:
                assert answer.status in (200, 403, 404, 503)
        orders = [e for e in station.call("events.recent", limit=10000)[len(before) :] if e["kind"] == "command"]
        assert orders == []


async def test_every_answer_has_the_headers_that_protect_the_page(station: WebStation) -> None:
    async with page_of(station, ws=False) as page, page.session.get(f"{station.base}/") as answer:
        policy = answer.headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy and "script-src 'self';" in policy and "unsafe" not in policy
        assert "frame-ancestors 'none'" in policy and f"connect-src 'self' ws://127.0.0.1:{station.port};" in policy
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.headers["Referrer-Policy"] == "no-referrer"
        assert "aiohttp" not in answer.headers["Server"]


@pytest.mark.parametrize(
    "path",
    ["/assets/../../web_process.py", "/assets/..%2f..%2fweb_process.py", "/assets/%00", "/web_process.py", "/assets/"],
)
async def test_only_files_of_the_built_page_are_served(station: WebStation, path: str) -> None:
    wanted = yarl.URL(station.base + path, encoded=True)
    async with page_of(station, ws=False) as page, page.session.get(wanted) as answer:
        assert answer.status in (400, 404)


# -- floods


async def test_a_message_of_100_mb_ends_its_socket_only(station: WebStation) -> None:
    async with page_of(station) as page, page_of(station) as other:
        assert page.ws is not None
        with pytest.raises((ConnectionError, AssertionError, aiohttp.ClientError)):
            await page.ws.send_str("x" * 100_000_000)
            await page.next()
        assert "result" in await other.call("vehicles.list")
    assert most_memory_kb(station) < 250_000


async def test_a_thousand_connections_keep_nobody_out_who_is_signed_in(station: WebStation) -> None:
    async with page_of(station) as page:
        opened = []
        try:
            for _ in range(1000):
                sock = socket.socket()
                sock.setblocking(False)
                sock.connect_ex(("127.0.0.1", station.port))
                opened.append(sock)
            assert "result" in await page.call("vehicles.list")
            async with page.session.get(f"{station.base}/assets/none.js") as answer:  # a new connection
                assert answer.status == 404, "signed in, whether the page is built or not"
            async with page_of(station) as another:
                assert "result" in await another.call("web.hello")
            assert descriptors(station) < MAX_CONNECTIONS + 60
        finally:
            for sock in opened:
                sock.close()


def test_a_connection_that_says_nothing_is_closed(station: WebStation) -> None:
    with socket.create_connection(("127.0.0.1", station.port), timeout=HANG_S) as sock:
        sock.sendall(b"GET / HT")
        assert sock.recv(100) == b""


async def test_a_browser_has_few_websockets(station: WebStation) -> None:
    async with page_of(station) as page:
        more = [await page.connect() for _ in range(MAX_SOCKETS_EACH - 1)]
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await page.connect()
        assert refused.value.status == 429
        await more[0].close()
        async with asyncio.timeout(HANG_S):
            while True:
                try:
                    more.append(await page.connect())
                    break
                except aiohttp.WSServerHandshakeError:
                    await asyncio.sleep(0.1)
        for ws in more:
            await ws.close()


async def test_onlookers_keep_nobody_out_who_may_order(tmp_path: Path) -> None:
    station = WebStation(tmp_path, None).start()
    try:
        async with contextlib.AsyncExitStack() as stack:
            viewers = [await stack.enter_async_context(page_of(station, "view", ws=False)) for _ in range(4)]
            opened, refused = [], 0
            for viewer in viewers:
                for _ in range(MAX_SOCKETS_EACH):
                    try:
                        opened.append(await viewer.connect())
                    except aiohttp.WSServerHandshakeError as error:
                        assert error.status == 429
                        refused += 1
            assert (len(opened), refused) == (MAX_VIEW_SOCKETS, 4 * MAX_SOCKETS_EACH - MAX_VIEW_SOCKETS)
            commander = await stack.enter_async_context(page_of(station))
            assert (await commander.call("web.hello"))["result"]["role"] == "command"
    finally:
        station.close()


# -- what a page does


async def test_a_page_sees_the_fleet_and_orders_it(station: WebStation) -> None:
    async with page_of(station) as page, page_of(station, "view") as viewer:
        hello = (await page.call("web.hello"))["result"]
        assert hello["role"] == "command" and hello["replay"] is False and hello["daemon"]["connected"] is True
        await page.call("web.subscribe", rate_hz=10)
        await viewer.call("web.subscribe", rate_hz=2)
        batch = await page.states(lambda p: len(p["vehicles"]) == 2)
        assert {v["name"] for v in batch["vehicles"]} == {"v1", "v2"}
        assert {"position", "battery", "links", "control"} <= batch["vehicles"][0].keys()
        answer = await page.order("vehicles.arm", targets="1", wait_s=30)
        assert answer["result"]["outcomes"]["v1"]["ok"]
        await viewer.states(lambda p: any(v["name"] == "v1" and v["armed"] for v in p["vehicles"]))
        assert (await viewer.call("vehicles.disarm", 1e9, targets="1"))["error"]["code"] == -32011
        assert (await page.order("vehicles.disarm", targets="1"))["result"]["outcomes"]["v1"]["ok"]
        armed = [n for n in page.notices if n.get("method") == "event" and n["params"]["event"]["kind"] == "armed"]
        assert len(armed) == 1


async def test_the_daemon_has_one_subscription_of_telemetry_for_all_pages(station: WebStation) -> None:
    """And none while no page is open: what the socket sends says so."""
    async with page_of(station) as first, page_of(station) as second:
        for page in (first, second):
            await page.call("web.subscribe", rate_hz=10)
            await page.states(lambda p: len(p["vehicles"]) == 2)
        # (pid, path) of the daemon's clients: four connections of the web process, whatever the number of pages
        assert station.call("daemon.info")["clients"]["sessions"] == 5


async def test_dropped_files_are_checked(station: WebStation) -> None:
    async with page_of(station, "view") as page:
        answer = await page.call("web.mission.check", name="x.plan", text="not a plan")
        assert "result" in answer or answer["error"]["code"] == -32602


async def test_pages_are_shown_everything_anew_after_the_daemon_was_gone(tmp_path: Path) -> None:
    station = WebStation(tmp_path, (1, 0)).start()
    try:
        async with page_of(station) as page:
            await page.call("web.subscribe", rate_hz=10)
            await page.states(lambda p: p["vehicles"])
            station.stop_daemon(signal.SIGKILL)
            while not any(n.get("method") == "web.daemon" for n in page.notices):
                page.notices.append(await page.next())
            refused = await page.order("vehicles.stop", targets="all")
            assert refused["error"]["code"] == -32010
            station.start_daemon()
            again = await page.states(lambda p: p["full"] and p["seq"] > 1)
            again = again if again["vehicles"] else await page.states(lambda p: p["vehicles"])
            assert again["vehicles"][0]["name"] == "v1"
            orders = [e for e in station.call("events.recent") if e["kind"] == "command"]
            assert orders == []
    finally:
        station.close()


async def test_a_restarted_process_knows_its_browsers(tmp_path: Path) -> None:
    station = WebStation(tmp_path, None).start()
    try:
        async with page_of(station, "view", ws=False) as page:
            station.stop_web(signal.SIGKILL)
            station.start_web()
            await page.open()
            for _ in range(600):
                hello = (await page.call("web.hello"))["result"]
                if hello["daemon"]["text"] != "not connected yet":
                    break
                await asyncio.sleep(0.1)
            assert hello["role"] == "view" and hello["daemon"]["connected"] is False
            assert "no skygcs daemon" in hello["daemon"]["text"]
        assert mode_of_cookies(station) & 0o077 == 0
    finally:
        station.close()


@pytest.mark.parametrize(("options", "role"), [((), "command"), (("--view",), "view")])
async def test_the_command_prints_a_further_address_of_a_role(
    station: WebStation, options: tuple[str, ...], role: str
) -> None:
    where = ("--socket", str(station.socket_path), "--port", str(station.port))
    line = command("web", "link", *where, *options)
    done = await asyncio.to_thread(subprocess.run, line, capture_output=True, text=True, timeout=HANG_S)
    assert done.returncode == 0, done.stderr
    async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as browser:
        async with browser.get(done.stdout.strip(), allow_redirects=False) as answer:
            assert answer.status == 303
        async with browser.ws_connect(f"{station.base}/ws", origin=station.base) as ws:
            await ws.send_json({"jsonrpc": "2.0", "id": 1, "method": "web.hello"})
            while (reply := await ws.receive_json(timeout=HANG_S)).get("id") != 1:
                pass
        assert reply["result"]["role"] == role


async def test_after_a_sign_out_no_browser_gets_in_with_what_it_has(tmp_path: Path) -> None:
    station = WebStation(tmp_path, None).start()
    try:
        async with page_of(station) as page:
            unused = station.address()
            line = command("web", "sign-out", "--socket", str(station.socket_path), "--port", str(station.port))
            done = await asyncio.to_thread(subprocess.run, line, capture_output=True, text=True, timeout=HANG_S)
            assert done.returncode == 0 and done.stdout.startswith("1 browser signed out"), done.stderr
            assert page.ws is not None
            assert (await page.ws.receive(timeout=HANG_S)).type in (aiohttp.WSMsgType.CLOSED, aiohttp.WSMsgType.CLOSE)
            for address in (station.base, unused):
                async with page.session.get(address) as answer:
                    assert answer.status == 403
            with pytest.raises(aiohttp.WSServerHandshakeError):
                await page.open()
            station.stop_web(signal.SIGKILL)
            station.start_web()
            with pytest.raises(aiohttp.WSServerHandshakeError):
                await page.open()
            async with page.session.get(station.address(), allow_redirects=False) as answer:
                assert answer.status == 303
    finally:
        station.close()


def test_of_a_page_that_is_not_there_no_address_is_printed(station: WebStation) -> None:
    where = ("--socket", str(station.socket_path), "--port", "1")
    done = subprocess.run(command("web", "link", *where), capture_output=True, text=True, timeout=HANG_S)
    assert done.returncode == 1 and done.stdout == "" and "Traceback" not in done.stderr


# -- starting and ending


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.10", "::"])
def test_another_address_without_tls_does_not_start(tmp_path: Path, host: str) -> None:
    done = subprocess.run(
        command("web", "--no-open", "--port", "0", "--host", host, "--socket", str(tmp_path / "x.sock")),
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )
    assert done.returncode == 1 and "needs TLS" in done.stderr and "Traceback" not in done.stderr
    assert done.stdout == ""


def test_a_port_that_is_taken_is_named(station: WebStation, tmp_path: Path) -> None:
    done = subprocess.run(
        command("web", "--no-open", "--port", str(station.port), "--socket", str(tmp_path / "x.sock")),
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )
    assert done.returncode == 1 and str(station.port) in done.stderr and "--port" in done.stderr


def supervised(folder: Path) -> WebStation:
    from support.process import free_port

    port = free_port(socket.SOCK_STREAM)
    station = WebStation(folder, (1, 0), more=f"[web]\nport = {port}\n")
    station.start_daemon()
    station.port = port
    wait_until(lambda: station.call("daemon.info")["web"]["running"], "the web process runs")
    return station


def test_the_daemon_starts_restarts_and_ends_its_page(tmp_path: Path) -> None:
    station = supervised(tmp_path)
    try:
        wait_until(lambda: _address(station), "the page answers")
        first = station.call("daemon.info")["web"]["pid"]
        subprocess.run(["kill", "-9", str(first)], check=True)
        wait_until(lambda: station.call("daemon.info")["web"]["restarts"] == 1, "it is started again")
        wait_until(lambda: _address(station), "the page answers again")
        second = station.call("daemon.info")["web"]["pid"]
        assert second != first
        texts = [e["text"] for e in station.call("events.recent") if e["kind"] == "warning"]
        assert any("process of the web page has ended (SIGKILL)" in text for text in texts)
        station.stop_daemon()
        assert not Path(f"/proc/{second}").exists()  # the page ends before the daemon
        assert "?token=" not in station.logs()
    finally:
        station.close()


def test_the_page_of_a_killed_daemon_ends(tmp_path: Path) -> None:
    station = supervised(tmp_path)
    try:
        wait_until(lambda: _address(station), "the page answers")
        child = station.call("daemon.info")["web"]["pid"]
        station.stop_daemon(signal.SIGKILL)
        wait_until(lambda: not Path(f"/proc/{child}").exists(), "the page ends")
    finally:
        station.close()


def test_sigterm_ends_the_process_with_a_page_that_takes_nothing(tmp_path: Path) -> None:
    station = WebStation(tmp_path, None).start()
    try:
        with socket.create_connection(("127.0.0.1", station.port)):
            process = station.web_process
            assert process is not None
            began = time.monotonic()
            station.stop_web()
            assert process.returncode == 0, station.logs()
            assert time.monotonic() - began < 25
        assert not Path(f"{station.socket_path}.web-{station.port}").exists()
    finally:
        station.close()


def _address(station: WebStation) -> str | None:
    try:
        return station.address()
    except Exception:
        return None
