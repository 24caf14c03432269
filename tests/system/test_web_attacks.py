"""`skygcs web` against hostile and broken browsers, and what becomes of orders when one of the processes ends."""

from __future__ import annotations

import asyncio
import base64
import os
import shutil
import signal
import socket
import ssl
import subprocess
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from skygcs.errors import SkygcsError
from skygcs.web.browser_connections import MAX_CONNECTIONS
from skygcs.web.control_socket import ask_for_link, find_control
from support.hanging import HANG_S
from support.hub import until
from support.needed import needs
from support.process import free_port, wait_until
from support.web_page import WebPage, page_of, raw, status
from support.web_station import WebStation, command

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebStation]:
    station = WebStation(tmp_path_factory.mktemp("web"), (1, 1))
    try:
        yield station.start()
    finally:
        station.close()


def cookie_of(station: WebStation, role: Any = "command") -> str:
    """NAME=VALUE as a browser sends it."""
    path = station.address(role).removeprefix(station.base)
    answer = raw(station, f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{station.port}\r\n\r\n")
    return next(line for line in answer.splitlines() if line.startswith("Set-Cookie")).split(": ")[1].split(";")[0]


def opened(station: WebStation, cookie: str) -> socket.socket:
    """A WebSocket whose bytes the test writes itself."""
    key = base64.b64encode(os.urandom(16)).decode()
    sock = socket.create_connection(("127.0.0.1", station.port), timeout=HANG_S)
    lines = [
        "GET /ws HTTP/1.1",
        f"Host: 127.0.0.1:{station.port}",
        f"Origin: {station.base}",
        f"Cookie: {cookie}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        f"Sec-WebSocket-Key: {key}",
        "Sec-WebSocket-Version: 13",
    ]
    sock.sendall("\r\n".join([*lines, "", ""]).encode())
    assert b" 101 " in sock.recv(4096).split(b"\r\n")[0]
    return sock


def frame(payload: bytes, opcode: int, *, final: bool = True) -> bytes:
    """One masked frame; the mask is zero."""
    head = bytes([opcode | (0x80 if final else 0)])
    size = bytes([0x80 | len(payload)]) if len(payload) < 126 else bytes([0x80 | 126]) + len(payload).to_bytes(2, "big")
    return head + size + bytes(4) + payload


def ended(sock: socket.socket) -> bool:
    """True when the other side has closed it."""
    try:
        while sock.recv(65536):
            pass
    except ConnectionError:
        pass
    return True


# -- what is no message


@pytest.mark.parametrize(
    "data",
    [
        frame(b'{"jsonrpc":"2.0","id":1,"method":"web.ping\xff\xfe"}', 1),
        frame(b"\xc3", 1),
        frame(b"x" * 125, 0),
        frame(b"x", 3),
        bytes([0xF1, 0x80, 0, 0, 0, 0]),
        frame(b"a", 1, final=False) + frame(b"b", 1),
        bytes([0x81, 0xFF]) + (1 << 62).to_bytes(8, "big") + bytes(4),
    ],
    ids=["utf-8", "cut-utf-8", "continuation", "opcode", "reserved-bits", "interleaved", "4-exabytes"],
)
async def test_bytes_that_are_no_message_end_their_socket_and_nothing_else(station: WebStation, data: bytes) -> None:
    async with page_of(station) as page:
        sock = await asyncio.to_thread(opened, station, cookie_of(station))
        with sock:
            sock.sendall(data)
            assert await asyncio.to_thread(ended, sock)
        # the first test may come before the process has connected to the daemon
        for _ in range(300):
            if "result" in await page.call("vehicles.list"):
                break
            await asyncio.sleep(0.1)
        else:
            pytest.fail("the others are served no more")


async def test_a_page_that_reads_nothing_delays_no_other(station: WebStation) -> None:
    async with page_of(station) as page:
        with await asyncio.to_thread(opened, station, cookie_of(station)) as slow:
            slow.sendall(frame(b'{"jsonrpc":"2.0","id":1,"method":"web.subscribe","params":{"rate_hz":20}}', 1))
            for _ in range(60):
                slow.sendall(frame(b'{"jsonrpc":"2.0","id":2,"method":"vehicles.list"}', 1))
            answer = await page.order("vehicles.stop", targets="all")
            assert set(answer["result"]["outcomes"]) == {"v1", "v2"}


# -- who gets in


async def test_of_many_requests_with_one_token_one_gets_in(station: WebStation) -> None:
    path = station.address().removeprefix(station.base)
    request = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{station.port}\r\n\r\n"
    answers = await asyncio.gather(*(asyncio.to_thread(raw, station, request) for _ in range(12)))
    assert sorted(map(status, answers)) == [303, *[403] * 11]


@pytest.mark.parametrize("path", ["/ws?token={}", "/assets/app.js?token={}", "/map?token={}"])
def test_a_token_opens_the_page_and_nothing_else(station: WebStation, path: str) -> None:
    token = station.address().partition("=")[2]
    own = f"Host: 127.0.0.1:{station.port}\r\nOrigin: {station.base}\r\n"
    answer = raw(station, f"GET {path.format(token)} HTTP/1.1\r\n{own}\r\n")
    assert status(answer) == 403 and "Set-Cookie" not in answer
    assert status(raw(station, f"GET /?token={token} HTTP/1.1\r\n{own}\r\n")) == 303, "it was not used up"


async def test_a_cookie_of_another_process_or_a_wrong_one_opens_nothing(station: WebStation, tmp_path: Path) -> None:
    other = WebStation(tmp_path, None).start()
    try:
        value = cookie_of(other).partition("=")[2]
    finally:
        other.close()
    for name, secret in ((f"skygcs_{station.port}", value), (f"skygcs_{station.port}", ""), ("skygcs", value)):
        own = f"Host: 127.0.0.1:{station.port}\r\nOrigin: {station.base}\r\nCookie: {name}={secret}\r\n"
        for path in ("/", "/ws", "/assets/app.js"):
            assert status(raw(station, f"GET {path} HTTP/1.1\r\n{own}\r\n")) == 403


async def test_a_view_stays_a_view_with_a_second_token_of_its_kind(station: WebStation) -> None:
    async with page_of(station, "view") as page:
        async with page.session.get(station.address("view"), allow_redirects=False) as answer:
            assert answer.status == 303
        refused = await page.order("vehicles.arm", targets="all")
        assert refused["error"]["code"] == -32011


# -- orders and ends


async def test_an_order_of_a_page_that_leaves_at_once_is_given_once(station: WebStation) -> None:
    async with page_of(station) as page:
        now_s = (await page.call("web.ping"))["result"]["now_s"]
        before = len(commands(station))
        assert page.ws is not None
        request = {"jsonrpc": "2.0", "id": "x", "method": "vehicles.disarm", "params": {"targets": "v1"}}
        await page.ws.send_json({**request, "deadline_s": now_s + 3})
        await page.ws.close()
        await page.open()
        await page.call("web.subscribe", rate_hz=10)
        await page.states(lambda p: len(p["vehicles"]) == 2)
        await page.order("vehicles.hold", targets="v2")
        texts = [event["text"] for event in commands(station)[before:] if event["vehicle"] == "v1"]
        assert len(texts) <= 1, texts


async def test_an_order_in_progress_is_not_given_again_to_a_daemon_that_comes_back(tmp_path: Path) -> None:
    station = WebStation(tmp_path, (1, 0)).start()
    try:
        async with page_of(station) as page:
            now_s = (await page.call("web.ping"))["result"]["now_s"]
            waiting = asyncio.create_task(page.call("vehicles.takeoff", now_s + 30, targets="v1", wait_s=60))
            await asyncio.sleep(0.2)
            station.stop_daemon(signal.SIGKILL)
            answer = await waiting
            assert answer.get("error", {}).get("code") == -32010 or "result" in answer
            await asyncio.to_thread(station.start_daemon)
            await page.open()  # it answered no ping meanwhile
            await page.call("web.subscribe", rate_hz=10)
            await page.states(lambda p: p["vehicles"])
            assert commands(station) == []
            assert station.call("vehicles.get", target="v1")["armed"] is False
    finally:
        station.close()


def commands(station: WebStation) -> list[dict[str, Any]]:
    return [event for event in station.call("events.recent", limit=10000) if event["kind"] == "command"]


async def test_only_a_person_at_a_page_counts_for_the_operators_timeout(tmp_path: Path) -> None:
    """A page that asks all the time is not an operator; what its person does is reported by operator.active."""
    station = WebStation(tmp_path, (1, 0), daemon='operator_timeout_s = 8.0\noperator_lost = "hold"').start()
    try:
        async with page_of(station) as page:
            await page.call("web.subscribe", rate_hz=10)
            await page.states(lambda p: p["vehicles"])
            await page.order("vehicles.takeoff", targets="v1", height_m=8, wait_s=60)
            await page.states(hovers)  # until then the autopilot itself leaves AUTO.TAKEOFF, and with it our control
            entered = await page.order("control.set", targets="v1", mode="position")
            assert entered["result"]["outcomes"]["v1"]["ok"], entered
            for _ in range(40):
                assert page.ws is not None
                await page.ws.send_json({"jsonrpc": "2.0", "method": "operator.active"})
                await page.call("vehicles.list")
                await asyncio.sleep(0.5)
            assert lost(page) == []
            for _ in range(600):
                await page.call("vehicles.list")
                await page.call("web.ping")
                if lost(page):
                    break
                await asyncio.sleep(0.1)
            assert len(lost(page)) == 1, station.call("events.recent", limit=30)
    finally:
        station.close()


def hovers(params: dict[str, Any]) -> bool:
    return any(
        v["mode"] == "AUTO.LOITER" and v["position"] is not None and (v["position"]["alt_rel_m"] or 0.0) > 7
        for v in params["vehicles"]
    )


def lost(page: WebPage) -> list[str]:
    events = [n["params"]["event"] for n in page.notices if n.get("method") == "event"]
    return [e["text"] for e in events if e["kind"] == "warning" and "no operator or client" in e["text"]]


# -- TLS


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A self-signed certificate and its key, for 127.0.0.2 and gcs.test."""
    openssl = needs("test-system", "openssl")
    folder = tmp_path_factory.mktemp("tls")
    cert, key = folder / "cert.pem", folder / "key.pem"
    line = (
        "req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=gcs.test -addext subjectAltName=IP:127.0.0.2,DNS:gcs.test"
    )
    subprocess.run([openssl, *line.split(), "-out", cert, "-keyout", key], check=True, capture_output=True)
    return cert, key


class TlsWeb:
    """`skygcs web` on 127.0.0.2, which is another address than that of this machine's own browser."""

    def __init__(self, folder: Path, certificate: tuple[Path, Path]) -> None:
        self.port = free_port(socket.SOCK_STREAM)
        self.base = f"https://127.0.0.2:{self.port}"
        self.cert, key = certificate
        self.socket_path = str(folder / "gcs.sock")
        options = ["--host", "127.0.0.2", "--port", str(self.port), "--socket", self.socket_path]
        tls = ["--tls-cert", str(self.cert), "--tls-key", str(key)]
        self.log = (folder / "web.log").open("wb")
        self.process = subprocess.Popen(
            command("web", "--no-open", *options, *tls), stdout=self.log, stderr=self.log, cwd=folder
        )

    def address(self) -> str:
        return ask_for_link(find_control(self.socket_path, self.port), "command")

    def answers(self) -> bool:
        assert self.process.poll() is None
        try:
            return bool(self.address())
        except SkygcsError:
            return False

    def descriptors(self) -> int:
        return len(list(Path(f"/proc/{self.process.pid}/fd").iterdir()))

    def context(self) -> ssl.SSLContext:
        return ssl.create_default_context(cafile=str(self.cert))

    def close(self) -> None:
        self.process.terminate()
        self.process.wait(timeout=HANG_S)
        self.log.close()


@pytest.fixture(scope="module")
def tls_web(tmp_path_factory: pytest.TempPathFactory, certificate: tuple[Path, Path]) -> Iterator[TlsWeb]:
    web = TlsWeb(tmp_path_factory.mktemp("web-tls"), certificate)
    try:
        wait_until(web.answers, "the page over TLS")
        yield web
    finally:
        web.close()


@asynccontextmanager
async def client() -> AsyncIterator[aiohttp.ClientSession]:
    """A browser's session. At its end all its connections are closed: aiohttp does not wait for the server's end of
    TLS, and a loop that ends before leaves sockets open."""
    before = len(os.listdir("/proc/self/fd"))
    async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
        yield session
    await until(lambda: len(os.listdir("/proc/self/fd")) <= before, "its connections are closed")


async def test_over_tls_a_page_signs_in_with_a_secure_cookie_and_has_a_websocket(tls_web: TlsWeb) -> None:
    async with client() as session:
        context = tls_web.context()
        async with session.get(tls_web.base, ssl=context) as answer:
            assert answer.status == 403
        address = tls_web.address()
        assert address.startswith(f"{tls_web.base}/?token=")
        async with session.get(address, ssl=context, allow_redirects=False) as answer:
            assert answer.status == 303
            cookie = answer.headers["Set-Cookie"]
            assert cookie.startswith(f"__Host-skygcs_{tls_web.port}=") and "Path=/" in cookie
            assert "Domain" not in cookie
            assert {"Secure", "HttpOnly", "SameSite=Strict"} <= {part.strip() for part in cookie.split(";")}
            assert "max-age" in answer.headers["Strict-Transport-Security"]
            assert f"wss://127.0.0.2:{tls_web.port}" in answer.headers["Content-Security-Policy"]
        async with aiohttp.ClientSession() as other, other.get(address, ssl=context) as answer:
            assert answer.status == 403, "a token works once"
        async with session.get(address, ssl=context) as answer:
            assert answer.status in (200, 503), "the browser that has its cookie is let in by it"
        async with session.ws_connect(f"{tls_web.base}/ws", ssl=context, origin=tls_web.base) as ws:
            await ws.send_json({"jsonrpc": "2.0", "id": 1, "method": "web.hello"})
            hello = await ws.receive_json(timeout=HANG_S)
            assert hello["result"]["role"] == "command"
        for origin in (f"http://127.0.0.2:{tls_web.port}", f"https://localhost:{tls_web.port}"):
            with pytest.raises(aiohttp.WSServerHandshakeError):
                await session.ws_connect(f"{tls_web.base}/ws", ssl=context, origin=origin)
        for host in (f"localhost:{tls_web.port}", f"127.0.0.1:{tls_web.port}", f"gcs.test:{tls_web.port}"):
            async with session.get(tls_web.base, ssl=context, headers={"Host": host}) as answer:
                assert answer.status == 403


def test_without_tls_or_with_an_old_one_nothing_is_served(tls_web: TlsWeb) -> None:
    place = ("127.0.0.2", tls_web.port)
    with socket.create_connection(place, timeout=HANG_S) as sock:
        sock.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.2:{tls_web.port}\r\n\r\n".encode())
        received = b""
        while data := sock.recv(4096):
            received += data
        assert b"HTTP" not in received
    with socket.create_connection(place, timeout=HANG_S) as sock:  # a handshake that never begins
        assert sock.recv(10) == b""
    old = tls_web.context()
    old.maximum_version = ssl.TLSVersion.TLSv1_2
    old.set_ciphers("DEFAULT")
    with (
        socket.create_connection(place, timeout=HANG_S) as sock,
        old.wrap_socket(sock, server_hostname="127.0.0.2") as tls,
    ):
        assert tls.version() == "TLSv1.2", "the oldest that is served"


async def test_connections_that_never_begin_their_handshake_are_bounded_and_keep_nobody_out(tls_web: TlsWeb) -> None:
    """They hold a descriptor each, and come to no code of HTTP that could count them."""
    context, opened = tls_web.context(), []
    async with client() as session:
        async with session.get(tls_web.address(), ssl=context, allow_redirects=False) as answer:
            assert answer.status == 303
        ws = await session.ws_connect(f"{tls_web.base}/ws", ssl=context, origin=tls_web.base)
        try:
            for number in range(900):
                sock = socket.socket()
                sock.setblocking(False)
                sock.connect_ex(("127.0.0.2", tls_web.port))
                opened.append(sock)
                if number % 100 == 99:
                    await asyncio.sleep(0.1)  # it accepts them meanwhile
            assert tls_web.descriptors() < MAX_CONNECTIONS + 60
            await ws.send_json({"jsonrpc": "2.0", "id": 1, "method": "web.ping"})
            while (await ws.receive_json(timeout=HANG_S)).get("id") != 1:
                pass
            async with session.get(tls_web.base, ssl=context, headers={"Connection": "close"}) as answer:
                assert answer.status in (200, 503)
        finally:
            for sock in opened:
                sock.close()
            await ws.close()


@pytest.mark.parametrize("what", ["missing", "no certificate", "another key"])
def test_a_certificate_that_does_not_work_is_named_and_nothing_starts(
    tmp_path: Path, certificate: tuple[Path, Path], what: str
) -> None:
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    if what == "no certificate":
        cert.write_text("hello")
        key.write_text("hello")
    elif what == "another key":
        shutil.copy(certificate[0], cert)
        subprocess.run(["openssl", "genrsa", "-out", key, "2048"], check=True, capture_output=True)
    place = ["--port", "0", "--host", "127.0.0.2", "--socket", str(tmp_path / "x.sock")]
    done = subprocess.run(
        command("web", "--no-open", *place, "--tls-cert", str(cert), "--tls-key", str(key)),
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )
    assert done.returncode == 1 and done.stdout == ""
    assert str(cert) in done.stderr and "Traceback" not in done.stderr
