"""The HTTP side of `skygcs web`: sign-in, the built page, the map and the WebSocket, for known hosts and origins only.

    GET /?token=T     a token once: a cookie and 303 to /; later the same without a cookie for who has it
    GET /             the page; without a cookie 403 and a field for an address
    GET /assets/NAME  its files
    GET /map          the image beneath the fleet view
    GET /tiles/V/Z/X/Y  a tile of the map beneath it; 204 where there is none, 503 for
                      one to be asked for again, 422 for one that is not drawn
    GET /ws           the WebSocket (`page_clients`)

Anything else is 404, another verb 405. Connections: `browser_connections`.
"""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import hashlib
import os
import socket
import ssl
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

import structlog
from aiohttp import WSMsgType, web
from aiohttp.web_protocol import RequestHandler

from skygcs.config.allow_list import AllowList
from skygcs.config.files import open_regular
from skygcs.web.browser_connections import BACKLOG, BrowserConnections
from skygcs.web.built_page import NOT_BUILT, STATIC
from skygcs.web.map_image import MapImage
from skygcs.web.map_tiles import RETRY_S, MapTiles, TilesBusyError
from skygcs.web.paced_handler import Lane, PacedHandler, pause_after_s
from skygcs.web.page_clients import PageClient, PageClients
from skygcs.web.peer_user import is_own_user
from skygcs.web.request_limits import MAX_MESSAGE_BYTES
from skygcs.web.sign_in import Role, SignIn, token_of
from skygcs.web.sign_in_page import STYLE_SOURCE, sign_in_page
from skygcs.web.tile_set import TileRefusedError

MAX_SOCKETS, MAX_VIEW_SOCKETS, MAX_SOCKETS_EACH = 16, 12, 4
"""WebSockets in all, of browsers that may only look, and of one browser: onlookers keep nobody out who may order."""

SWEEP_S = 1.0

COOKIE_KEPT_S = 7 * 86400

KEEP_ALIVE_S = 30.0

PING_S = 20.0
"""A phone that has left the network is noticed within one and a half of these."""

MAX_HEADER_BYTES = 8190
MAX_ASSET_BYTES = 8 << 20

TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
    ".webmanifest": "application/manifest+json",
    ".woff2": "font/woff2",
}
"""Media types of the files that the built page may have, by suffix; anything else is not served."""

COMPRESSED = {".css", ".html", ".js", ".json", ".svg", ".txt", ".webmanifest"}

_IS_SIGN_IN = web.ResponseKey("skygcs.sign_in", bool)
"""Marks the only response with a form and with a style of its own."""

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class _Asset:
    version: tuple[int, int, int]
    """Device, inode and time of change of the file."""
    content_type: str
    body: bytes
    compressed: bytes | None
    etag: str


class Assets:
    """Files of the built page, kept in memory; a file that has changed is read again.

    Links are followed, of files and of the folder of assets: installers put links to their cache there (uv with
    --link-mode=symlink). Nobody but the installer writes to the folder; who else could might change the program itself.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._kept: dict[str, _Asset] = {}

    def find(self, name: str) -> _Asset | None:
        """A file directly in the folder or in its assets; None for anything else."""
        parts = name.split("/")
        if len(parts) > 2 or (len(parts) == 2 and parts[0] != "assets") or any(p in ("", ".", "..") for p in parts):
            return None
        suffix = Path(parts[-1]).suffix
        if suffix not in TYPES or "\0" in name or "\\" in name:
            return None
        try:
            with open_regular(self._folder / name) as file:
                found = os.fstat(file.fileno())
                version = (found.st_dev, found.st_ino, found.st_mtime_ns)
                kept = self._kept.get(name)
                if kept is not None and kept.version == version:
                    return kept
                body = file.read(MAX_ASSET_BYTES + 1)
        except OSError:
            return None
        if len(body) > MAX_ASSET_BYTES:
            return None
        compressed = gzip.compress(body, 9, mtime=0) if suffix in COMPRESSED else None
        etag = f'"{hashlib.sha256(body).hexdigest()[:32]}"'
        asset = self._kept[name] = _Asset(version, TYPES[suffix], body, compressed, etag)
        return asset


class _PageSocket:
    """An aiohttp WebSocket as a page's tasks see it."""

    def __init__(self, ws: web.WebSocketResponse, request: web.Request) -> None:
        self._ws = ws
        self._request = request

    async def send_frame(self, data: bytes) -> None:
        await self._ws.send_frame(data, WSMsgType.TEXT)

    def abort(self) -> None:
        if self._request.transport is not None:
            self._request.transport.abort()


class HttpServer:
    """Serves `pages` at one listening socket. `start`, then `close`. ``clock``: of the sign-in."""

    def __init__(
        self,
        pages: PageClients,
        sign_in: SignIn,
        allowed: AllowList,
        *,
        clock: Callable[[], float],
        on_sign_in: Callable[[], None],
        map_image: MapImage | None = None,
        map_tiles: MapTiles | None = None,
        static: Path = STATIC,
    ) -> None:
        self.connections = BrowserConnections(self._new_handler)
        self.port = 0
        self._pages = pages
        self._sign_in = sign_in
        self._allowed = allowed
        self._clock = clock
        self._on_sign_in = on_sign_in
        self._map = map_image
        self._tiles = map_tiles
        self._assets = Assets(static)
        self._loop = asyncio.get_running_loop()
        self._unknown, self._onlookers = Lane(self._loop.time()), Lane(self._loop.time())
        self._tasks: list[asyncio.Task[None]] = []
        self._secure = False
        application = web.Application(middlewares=[self._guard], client_max_size=1024)
        application.router.add_get("/", self._index, allow_head=False)
        application.router.add_get("/assets/{name}", self._asset, allow_head=False)
        application.router.add_get("/map", self._map_image, allow_head=False)
        tile = r"/tiles/{version:[0-9a-f]{1,16}}/{zoom:[0-9]{1,2}}/{x:[0-9]{1,8}}/{y:[0-9]{1,8}}"
        application.router.add_get(tile, self._map_tile, allow_head=False)
        application.router.add_get("/ws", self._websocket, allow_head=False)
        application.on_response_prepare.append(self._on_prepare)
        self._runner = web.AppRunner(
            application,
            access_log=None,  # an address with its token must stand in no log
            keepalive_timeout=KEEP_ALIVE_S,
            lingering_time=0.0,  # no request has a body here: one that has is not read, its connection is closed
            max_line_size=MAX_HEADER_BYTES,
            max_field_size=MAX_HEADER_BYTES,
            shutdown_timeout=1.0,
            handle_signals=False,
        )

    async def start(self, sock: socket.socket, tls: ssl.SSLContext | None) -> None:
        """Serve on a bound socket."""
        await self._runner.setup()
        self._secure = tls is not None
        self.port = sock.getsockname()[1]
        sock.listen(BACKLOG)
        self._tasks = [
            self._loop.create_task(self.connections.run(sock, tls), name="connections of browsers"),
            self._loop.create_task(self._sweep(), name="sweep of connections"),
        ]

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._runner.cleanup()

    @property
    def cookie_name(self) -> str:
        """Browsers keep one jar for all ports of a host. Over TLS the prefix has them take it from this host only."""
        return f"{'__Host-' if self._secure else ''}{self._sign_in.session_cookie or f'skygcs_{self.port}'}"

    def _new_handler(self) -> RequestHandler:
        server = self._runner.server
        assert server is not None
        return PacedHandler(server, self._unknown, on_no_http=self.connections.report_no_http)

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(SWEEP_S)
            self.connections.sweep(self._loop.time())
            self._pages.wake_all()  # which finds pages that take nothing

    # -- every request

    @web.middleware
    async def _guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        headers = request.headers
        hosts, origins = headers.getall("Host", []), headers.getall("Origin", [])
        websocket = request.path == "/ws"
        refusal = (
            "one Host and one Origin, please"
            if len(hosts) > 1 or len(origins) > 1
            else self._allowed.refusal(
                hosts[0] if hosts else None,
                origins[0] if origins else None,
                websocket=websocket,
                site=headers.get("Sec-Fetch-Site"),
            )
        )
        if refusal is not None:
            return _plain(403, refusal)
        if request.method != "GET":
            return _plain(405, "only GET is served here", Allow="GET")
        began = time.thread_time()
        try:
            response = await handler(request)
        except web.HTTPException as error:
            response = _plain(error.status, error.reason)
        lane = _connection(request).lane
        # a tile is read beside the loop, whose cost meanwhile is of others; `map_tiles` bounds how many are
        onlooks = lane is self._onlookers and not websocket and not request.path.startswith("/tiles/")
        if lane is self._unknown or onlooks:
            lane.busy += 1
            try:
                await asyncio.sleep(lane.pause_after_s(time.thread_time() - began))
            finally:
                lane.busy -= 1
        return response

    async def _on_prepare(self, request: web.Request, response: web.StreamResponse) -> None:
        own = request.headers.get("Host", "")
        scheme = "wss" if self._secure else "ws"
        websocket = f"{scheme}://{own}" if own in self._allowed.hosts else ""
        headers = response.headers
        form, style = ("'self'", STYLE_SOURCE) if response.get(_IS_SIGN_IN) else ("'none'", "'self'")
        headers["Content-Security-Policy"] = (
            f"default-src 'none'; script-src 'self'; style-src {style}; img-src 'self' blob:; font-src 'self'; "
            f"connect-src 'self' {websocket}; manifest-src 'self'; media-src 'self'; worker-src 'none'; "
            f"base-uri 'none'; form-action {form}; frame-ancestors 'none'"
        )
        headers["X-Content-Type-Options"] = "nosniff"
        headers["X-Frame-Options"] = "DENY"
        headers["Referrer-Policy"] = "no-referrer"
        headers["Cross-Origin-Opener-Policy"] = "same-origin"
        headers["Cross-Origin-Resource-Policy"] = "same-origin"
        headers["Permissions-Policy"] = "camera=(), microphone=(), geolocation=(), payment=(), usb=()"
        headers.setdefault("Cache-Control", "no-store")
        headers["Server"] = "skygcs"
        if self._secure:
            headers["Strict-Transport-Security"] = "max-age=86400"

    def _cookie(self, request: web.Request) -> tuple[str, Role] | None:
        """(identity, role) of a signed-in browser."""
        cookie = cookie_value(request.headers.get("Cookie", ""), self.cookie_name)
        role = self._sign_in.role_of(cookie, self._clock()) if cookie else None
        if role is None:
            return None
        identity = self._sign_in.identity(cookie)
        if self.connections.know(request.protocol, identity, may_order=role == "command"):
            _connection(request).join(Lane(self._loop.time()) if role == "command" else self._onlookers)
        return identity, role

    # -- what is served

    async def _index(self, request: web.Request) -> web.StreamResponse:
        if "token" in request.query:
            return self._exchange(request)
        if self._cookie(request) is None:
            return _sign_in(refused=False)
        return self._file(request, "index.html") or _plain(503, NOT_BUILT)

    def _exchange(self, request: web.Request) -> web.StreamResponse:
        cookie = self._sign_in.exchange(
            token_of(request.query["token"]), self._clock(), lambda: is_own_user(request.transport)
        )
        response = web.Response(status=303, headers={"Location": "/"})
        if cookie is None:  # an address is opened a second time by who is signed in
            return _sign_in(refused=True) if self._cookie(request) is None else response
        self._on_sign_in()
        kept_s = COOKIE_KEPT_S if self._sign_in.session_cookie is None else None
        response.set_cookie(
            self.cookie_name, cookie, path="/", httponly=True, samesite="Strict", secure=self._secure, max_age=kept_s
        )
        return response

    async def _asset(self, request: web.Request) -> web.StreamResponse:
        if self._cookie(request) is None:
            return _plain(403, "not signed in")
        return self._file(request, f"assets/{request.match_info['name']}") or _plain(404, "no such file")

    async def _map_image(self, request: web.Request) -> web.StreamResponse:
        if self._cookie(request) is None:
            return _plain(403, "not signed in")
        if self._map is None:
            return _plain(404, "no map")
        headers = {"Cache-Control": "private, max-age=3600"}
        return web.Response(body=self._map.body, content_type=self._map.content_type, headers=headers)

    async def _map_tile(self, request: web.Request) -> web.StreamResponse:
        if self._cookie(request) is None:
            return _plain(403, "not signed in")
        if self._tiles is None:
            return _plain(404, "no tiles")
        zoom, x, y = (int(request.match_info[name]) for name in ("zoom", "x", "y"))
        return await tile_response(self._tiles, zoom, x, y)

    def _file(self, request: web.Request, name: str) -> web.Response | None:
        asset = self._assets.find(name)
        if asset is None:
            return None
        headers = {"ETag": asset.etag, "Cache-Control": "no-cache", "Vary": "Accept-Encoding"}
        if request.headers.get("If-None-Match") == asset.etag:
            return web.Response(status=304, headers=headers)
        headers["Content-Type"] = asset.content_type
        if asset.compressed is not None and "gzip" in request.headers.get("Accept-Encoding", ""):
            headers["Content-Encoding"] = "gzip"
            return web.Response(body=asset.compressed, headers=headers)
        return web.Response(body=asset.body, headers=headers)

    async def _websocket(self, request: web.Request) -> web.StreamResponse:
        known = self._cookie(request)
        if known is None:
            return _plain(403, "not signed in")
        identity, role = known
        clients = self._pages.clients
        if (
            len(clients) >= MAX_SOCKETS
            or sum(c.identity == identity for c in clients) >= MAX_SOCKETS_EACH
            or (role == "view" and sum(c.role == "view" for c in clients) >= MAX_VIEW_SOCKETS)
        ):
            return _plain(429, "too many pages are open; close some")
        ws = web.WebSocketResponse(
            max_msg_size=MAX_MESSAGE_BYTES, heartbeat=PING_S, compress=False, timeout=1.0, autoping=False
        )
        if not ws.can_prepare(request).ok:
            return _plain(426, "this is a WebSocket")
        client = PageClient(self._pages, _PageSocket(ws, request), role, identity)
        clients[client] = None  # before the first await: the places are counted
        self.connections.hold_websocket(request.protocol)
        try:
            await ws.prepare(request)
            sending = self._loop.create_task(_sending(client), name="page sending")
            try:
                await _read(ws, request, client)
            finally:
                sending.cancel()
        finally:
            client.close()
        return ws


def _connection(request: web.Request) -> PacedHandler:
    assert isinstance(request.protocol, PacedHandler)
    return request.protocol


def cookie_value(header: str, name: str) -> str:
    """The last cookie of this name, which has the shortest path; "" without one. aiohttp's parser takes 50 ms for a
    header of many cookies."""
    found = [value for part in header.split(";") for key, _, value in (part.strip().partition("="),) if key == name]
    return found[-1] if found else ""


async def tile_response(tiles: MapTiles, zoom: int, x: int, y: int) -> web.Response:
    """A tile, or the answer that there is none (204), that it may be asked for again (503), or is not drawn (422)."""
    try:
        found = await tiles.read(zoom, x, y)
    except TilesBusyError:
        return _plain(503, "too many tiles are asked for", **{"Retry-After": str(RETRY_S)})
    except TileRefusedError as error:
        return _plain(422, f"this tile is not drawn: {error}")
    if found is None:
        return web.Response(status=204)
    content_type, body = found
    headers = {"Cache-Control": "private, max-age=86400"}  # another file has another address
    return web.Response(body=body, content_type=content_type, headers=headers)


async def _read(ws: web.WebSocketResponse, request: web.Request, client: PageClient) -> None:
    """Hand a page's messages on until its socket ends, or it is closed here. Each has its pause, a ping as well: an
    answer costs more than a refusal. Of a page that has left, what is beyond its allowance is given up: a browser's
    last order comes with its end, but megabytes of a flood would stay as long as they are read at the usual pace."""
    async for message in ws:
        if client.closed:
            break
        cost_s = 0.0
        if message.type is WSMsgType.TEXT:
            began = time.thread_time()
            client.on_message(message.data)
            cost_s = time.thread_time() - began  # a message of many small parts costs ten times a text
        elif message.type is WSMsgType.PING:
            with contextlib.suppress(ConnectionError):
                await ws.pong(message.data)
        elif message.type is not WSMsgType.PONG:
            await ws.close(code=1003, message=b"text only")
            break
        pause_s = client.pause_s(len(message.data))
        if pause_s > 0.0 and request.transport is None:
            break
        await asyncio.sleep(max(pause_s, pause_after_s(cost_s)))


async def _sending(client: PageClient) -> None:
    """The sending side of one page; its failure ends the page only."""
    try:
        await client.send()
    except (ConnectionError, RuntimeError):  # aiohttp: the socket has closed, and what it sent before is read yet
        pass
    except Exception as error:
        _log.error("page cannot be sent to", exc_info=error)
        client.close()


def _sign_in(*, refused: bool) -> web.Response:
    response = web.Response(status=403, text=sign_in_page(refused=refused), content_type="text/html")
    response[_IS_SIGN_IN] = True
    return response


def _plain(status: int, text: str, **headers: str) -> web.Response:
    return web.Response(status=status, text=text + "\n", headers=headers)
